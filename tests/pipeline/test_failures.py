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
    from oppload_cli.video.source import Video


class Failing:
    """A watcher that raises an error after some frames, as a user's own detector may."""

    def __init__(self, error: BaseException, after: int) -> None:
        self._error, self._left = error, after

    def opened(self, _video: Video) -> None:
        """Do nothing."""

    def frame(self, _record: FrameRecord) -> None:
        """Raise the error after the given number of frames."""
        self._left -= 1
        if self._left == 0:
            raise self._error


class Reader:
    """A watcher that reads the file of the table at each frame, as another program may."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self.seen: list[str] = []

    def opened(self, _video: Video) -> None:
        """Do nothing."""

    def frame(self, _record: FrameRecord) -> None:
        """Keep the cell `frame` of the last complete row."""
        self.seen.append(self._path.read_text().rpartition("\n")[0].split("\n")[-1].split(",")[0])


@pytest.mark.parametrize("piped", [False, True])
def test_another_program_sees_each_row_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, piped: bool
) -> None:
    """A robot waits for the row of a frame, also if no other frame follows."""
    video = write_video(tmp_path / "a.avi", grey_frames(5, width=64, height=48))
    settings = resolve(models=["opplod"], measure_rmo=False, height="24")
    outputs = None if piped else Outputs.of(tmp_path, "a", settings.models)
    reader = Reader(tmp_path / ("stdout" if piped else "a.frames.csv.part"))
    with (tmp_path / "stdout").open("w", newline="") as stream:
        monkeypatch.setattr(sys, "stdout", stream)
        run_task(Task(str(video), settings, outputs), reader)
    assert reader.seen == ["0", "1", "2", "3", "4"]


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
    with pytest.raises(raised) as found:
        run_task(task, Failing(error, 5))
    left = sorted(path.name for path in outputs.csv.parent.iterdir())
    assert left == (["a.detections.jsonl.part", "a.frames.csv.part"] if kept else [])
    named = f"the first 5 rows are in {outputs.csv}.part"
    assert (named in str(found.value)) == kept
    if kept:
        with pytest.raises(OpploadError, match="exists already"):
            run_task(task)
    else:
        assert run_task(task).frames == 12


class Removing(Failing):
    """A watcher that removes a folder, as somebody might during a run."""

    def __init__(self, folder: Path, error: BaseException, after: int) -> None:
        super().__init__(error, after)
        self._folder = folder

    def frame(self, record: FrameRecord) -> None:
        """Remove the folder, and raise the error after the given number of frames."""
        shutil.rmtree(self._folder, ignore_errors=True)
        super().frame(record)


@pytest.mark.skipif(sys.platform == "win32", reason="an open file keeps its folder there")
@pytest.mark.parametrize(
    ("after", "raised", "said"),
    [(99, OutputError, "cannot be written (no such file"), (5, Interrupted, "")],
)
def test_a_folder_that_vanishes_during_a_run_gives_an_error(
    tmp_path: Path, after: int, raised: type[BaseException], said: str
) -> None:
    video = write_video(tmp_path / "a.avi", grey_frames(12, width=64, height=48))
    settings = resolve(models=["opplod"], measure_rmo=False, height="24")
    folder = tmp_path / "out"
    task = Task(str(video), settings, Outputs.of(folder, "a", settings.models))
    with pytest.raises(raised) as found:
        run_task(task, Removing(folder, KeyboardInterrupt(), after))
    assert said in str(found.value)
    assert "rows are in" not in str(found.value)
