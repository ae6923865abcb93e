"""Of several runs at once with `--if-exists error`, one alone makes a result."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

from oppload_cli.errors import BusyError, OutputError
from oppload_cli.files import atomic
from oppload_cli.files.atomic import PartFile, PartFolder, claimed, folder_of_outputs
from tests.cli.inside import oppload
from tests.cli.process import ENTRY
from tests.media import grey_frames, write_video

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("races")
    clip = write_video(folder / "clip.avi", grey_frames(12), codec="ffv1")
    assert oppload("run", clip, "-o", folder, "--height", "24", "-q").returncode == 0
    return folder


COMMANDS = {
    "run": ("run", "{folder}/clip.avi", "-o", "{place}", "--height", "24"),
    "collect": ("collect", "{folder}", "-o", "{place}/all.csv"),
    "stimuli": ("stimuli", "generate", "controls/appearing-disk", "-o", "{place}"),
    "stimuli png": (
        *("stimuli", "generate", "controls/appearing-disk", "-o", "{place}"),
        *("--format", "png"),
    ),
    "tune": (
        *("tune", "klapoetke2017/bar-expand-10", "--over", "speed=40", "-o", "{place}"),
        *("--jobs", "1"),
    ),
}


SLOW = {"collect", "stimuli", "stimuli png", "tune"}  # they hold a name as the others do


@pytest.mark.long
@pytest.mark.parametrize(
    "command",
    [
        pytest.param(words, id=name, marks=[pytest.mark.slow] if name in SLOW else [])
        for name, words in COMMANDS.items()
    ],
)
def test_parallel_runs(command: tuple[str, ...], results: Path, tmp_path: Path) -> None:
    words = [word.format(folder=results, place=tmp_path) for word in command]
    runs = [
        subprocess.Popen(
            [sys.executable, "-c", ENTRY, *words],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )
        for _ in range(2)
    ]
    said = [run.communicate(timeout=120)[1] for run in runs]
    codes = [run.returncode for run in runs]
    assert sorted(codes) == [0, 2], said
    for code, each in zip(codes, said, strict=True):
        if code:
            assert "exists already" in each or "another run is writing it" in each
    assert not list(tmp_path.rglob("*.part"))


@pytest.mark.long
@pytest.mark.parametrize(
    "kind",
    [
        PartFile,
        pytest.param(
            PartFolder,
            marks=pytest.mark.skipif(sys.platform == "win32", reason="folders have no locks there"),
        ),
    ],
)
def test_a_result_that_appears_before_the_name_is_held(
    kind: Callable[..., PartFile | PartFolder], tmp_path: Path
) -> None:
    path = tmp_path / "a"
    first = kind(path, new=True)
    with pytest.raises(BusyError, match="another run is writing it"):
        kind(path)
    first.commit()
    with pytest.raises(OutputError, match="a: exists already; choose --if-exists overwrite"):
        kind(path, new=True)
    kind(path).discard()
    assert [each.name for each in tmp_path.iterdir()] == ["a"]


def test_a_claim_leaves_nothing(tmp_path: Path) -> None:
    with folder_of_outputs(tmp_path / "new" / "folder"):
        assert (tmp_path / "new" / "folder").is_dir()
    assert not list(tmp_path.iterdir())
    with claimed(tmp_path / "new" / "folder" / "a.csv", "error"):
        assert (tmp_path / "new" / "folder" / "a.csv.part").exists()
    assert not list(tmp_path.iterdir())
    with claimed(tmp_path / "new" / "a.csv", "error") as file:
        file.stream.write("kept")
        file.commit()
    assert (tmp_path / "new" / "a.csv").read_text() == "kept"


@pytest.mark.skipif(sys.platform == "win32", reason="an open file cannot be removed there")
def test_another_file_in_the_place_of_the_part_file(tmp_path: Path) -> None:
    (tmp_path / "mine").write_text("mine")
    moved = pytest.raises(OutputError, match=r"a\.part is another file now")
    with moved, PartFile(tmp_path / "a") as file:
        file.part.unlink()
        file.part.symlink_to(tmp_path / "mine")
    assert not os.path.lexists(tmp_path / "a")
    assert (tmp_path / "mine").read_text() == "mine"


def test_where_there_are_no_locks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(_: int) -> None:
        raise OSError

    monkeypatch.setattr(atomic, "_lock_now", refuse)
    first = PartFile(tmp_path / "a", new=True)
    with pytest.raises(OutputError, match=r"a\.part: exists already"):
        PartFile(tmp_path / "a", new=True)
    second = PartFile(tmp_path / "a")  # never writes into the file of the first
    assert second.part != first.part
    first.stream.write("first")
    first.commit()
    second.stream.write("second")
    second.commit()
    assert (tmp_path / "a").read_text() == "second"
    assert [each.name for each in tmp_path.iterdir()] == ["a"]


def test_a_part_folder_of_an_earlier_run(tmp_path: Path) -> None:
    part = tmp_path / "a.part"
    part.mkdir()
    (part / "old.png").touch()
    folder = PartFolder(tmp_path / "a")
    assert not list(part.iterdir())
    folder.discard()
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "kept").touch()
    part.symlink_to(tmp_path / "mine")
    with PartFolder(tmp_path / "a") as folder:
        (folder.part / "new.png").touch()
    assert [each.name for each in (tmp_path / "a").iterdir()] == ["new.png"]
    assert (tmp_path / "mine" / "kept").exists()
    shutil.rmtree(tmp_path / "a")
