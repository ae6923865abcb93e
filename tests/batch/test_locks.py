"""Two workers on one result: whatever the order, it is whole."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import pytest

from oppload_cli.errors import BusyError
from oppload_cli.files.atomic import PartFile
from oppload_cli.pipeline.execute import run_task
from oppload_cli.pipeline.settings import resolve
from oppload_cli.pipeline.task import IfExists, Outputs, Task
from tests.media import grey_frames, write_video

fcntl = pytest.importorskip("fcntl", reason="NOT TESTED: no such locks on this system")


@pytest.mark.long
def test_a_result_is_renamed_before_its_lock_is_given_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = PartFile(tmp_path / "a.csv")
    first.stream.write("one\n")
    rename = Path.replace

    def racing(path: Path, target: Path) -> Path:
        with pytest.raises(BusyError, match="another run is writing it"):
            PartFile(tmp_path / "a.csv")
        return rename(path, target)

    monkeypatch.setattr(Path, "replace", racing)
    first.commit()
    assert (tmp_path / "a.csv").read_text() == "one\n"


def test_a_result_that_is_renamed_while_a_run_opens_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    theirs = PartFile(tmp_path / "a.csv")

    def renamed_before(path: Path) -> os.stat_result:
        monkeypatch.undo()
        theirs.commit()
        return os.lstat(path)

    monkeypatch.setattr(os, "lstat", renamed_before)
    with pytest.raises(BusyError, match="another run is writing it"):
        PartFile(tmp_path / "a.csv")


def test_without_locks_each_process_has_a_file_of_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise OSError("no locks here")

    monkeypatch.setattr(fcntl, "flock", refuse)
    theirs, file = PartFile(tmp_path / "a.csv"), PartFile(tmp_path / "a.csv")
    assert theirs.part.name == "a.csv.part"
    assert file.part.name not in {"a.csv", "a.csv.part"}
    file.stream.write("mine\n")
    file.commit()
    theirs.discard()
    assert [path.read_text() for path in tmp_path.iterdir()] == ["mine\n"]


@pytest.mark.long
def test_a_result_that_another_run_writes_or_has_just_written_is_skipped(tmp_path: Path) -> None:
    clip = write_video(tmp_path / "a.avi", grey_frames(5))
    task = Task(
        str(clip),
        resolve(height="48", measure_rmo=False),
        Outputs(tmp_path / "a.frames.csv", tmp_path / "a.oppload.json"),
        if_exists=IfExists.SKIP,
    )
    sidecar = tmp_path / "theirs" / "a.oppload.json"
    run_task(replace(task, outputs=Outputs(sidecar.with_name("a.frames.csv"), sidecar)))
    other = PartFile(tmp_path / "a.frames.csv")
    assert run_task(task).skipped

    seen: list[object] = []

    def finish(_video: object) -> None:
        """Let another run finish the result while this run opens its input."""
        other.stream.write("theirs\n" * 6)  # a header and a row per frame
        other.commit()
        sidecar.rename(tmp_path / "a.oppload.json")

    assert run_task(task, on_open=finish, on_frame=seen.append).skipped
    assert seen == []  # no frame is analysed twice
    assert (tmp_path / "a.frames.csv").read_text() == "theirs\n" * 6
    assert not list(tmp_path.glob("*.part"))
