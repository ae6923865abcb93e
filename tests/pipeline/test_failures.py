"""The files of a run at each frame, those that an error leaves, and the message about them."""

from __future__ import annotations

import shutil
import sys
from typing import TYPE_CHECKING

import pytest

from oppload_cli.errors import OpploadError, OutputError, ShortageError
from oppload_cli.pipeline.execute import run_task
from oppload_cli.pipeline.settings import resolve
from oppload_cli.pipeline.task import Interrupted, Outputs, Task
from tests.media import grey_frames, write_video

if TYPE_CHECKING:
    from pathlib import Path

    from oppload_cli.results.table import FrameRecord


@pytest.mark.parametrize("piped", [False, True])
def test_another_program_sees_each_row_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, piped: bool
) -> None:
    """A robot waits for the row of a frame, also if no other frame follows."""
    video = write_video(tmp_path / "a.avi", grey_frames(5, width=64, height=48))
    settings = resolve(models=["opplod"], measure_rmo=False, height="24")
    outputs = None if piped else Outputs.of(tmp_path, "a", settings.models)
    table = tmp_path / ("stdout" if piped else "a.frames.csv.part")
    seen = []

    def read(_record: FrameRecord) -> None:
        *_, row, rest = table.read_text().split("\n")
        assert rest == ""
        seen.append(row.partition(",")[0])

    with (tmp_path / "stdout").open("w", newline="") as stream:
        monkeypatch.setattr(sys, "stdout", stream)
        run_task(Task(str(video), settings, outputs), on_frame=read)
    assert seen == ["0", "1", "2", "3", "4"]


@pytest.mark.parametrize(
    ("error", "raised", "kept"),
    [
        (ValueError("a bug of a detector"), ValueError, False),
        (ZeroDivisionError(), ZeroDivisionError, False),
        (MemoryError(), ShortageError, True),
        (RuntimeError("can't start new thread"), ShortageError, True),
        (OSError(28, "no space left"), OutputError, True),
        (KeyboardInterrupt(), Interrupted, True),
    ],
)
def test_a_bug_removes_the_rows_and_other_errors_name_them(
    tmp_path: Path, error: BaseException, raised: type[BaseException], kept: bool
) -> None:
    video = write_video(tmp_path / "a.avi", grey_frames(12, width=64, height=48))
    settings = resolve(models=["opplod"], measure_rmo=False, height="24")
    outputs = Outputs.of(tmp_path / "out", "a", settings.models)
    task = Task(str(video), settings, outputs)

    def fail(record: FrameRecord) -> None:
        """Raise the error after five frames, as a user's own detector may."""
        if record.frame == 4:
            raise error

    with pytest.raises(raised) as found:
        run_task(task, on_frame=fail)
    left = sorted(path.name for path in outputs.csv.parent.iterdir())
    assert left == (["a.detections.jsonl.part", "a.frames.csv.part"] if kept else [])
    named = f"the first 5 rows are in {outputs.csv}.part"
    assert (named in str(found.value)) == kept
    if kept:
        with pytest.raises(OpploadError, match="exists already"):
            run_task(task)
    else:
        assert run_task(task).frames == 12


@pytest.mark.skipif(sys.platform == "win32", reason="an open file keeps its folder there")
@pytest.mark.parametrize(
    ("stopped", "raised", "said"),
    [(False, OutputError, "cannot be written (no such file"), (True, Interrupted, "")],
)
def test_a_folder_that_vanishes_during_a_run_gives_an_error(
    tmp_path: Path, stopped: bool, raised: type[BaseException], said: str
) -> None:
    video = write_video(tmp_path / "a.avi", grey_frames(12, width=64, height=48))
    settings = resolve(models=["opplod"], measure_rmo=False, height="24")
    folder = tmp_path / "out"
    task = Task(str(video), settings, Outputs.of(folder, "a", settings.models))

    def remove(record: FrameRecord) -> None:
        shutil.rmtree(folder, ignore_errors=True)
        if stopped and record.frame == 4:
            raise KeyboardInterrupt

    with pytest.raises(raised) as found:
        run_task(task, on_frame=remove)
    assert said in str(found.value)
    assert "rows are in" not in str(found.value)
