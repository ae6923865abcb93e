"""The files of a run at each frame, those that an error leaves, and the message about them."""

from __future__ import annotations

import shutil
import sys
from contextlib import nullcontext
from fractions import Fraction
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest

from oppload_cli.errors import (
    DetectorError,
    OpploadError,
    OutputError,
    ParameterError,
    ShortageError,
)
from oppload_cli.frame_times import FrameTimes, ticks
from oppload_cli.pipeline.execute import _threads, analyse_source, run_task
from oppload_cli.pipeline.settings import resolve
from oppload_cli.pipeline.sources import open_source
from oppload_cli.pipeline.task import Interrupted, Outputs, Task
from oppload_cli.video.frames import DecodeFacts, Frame, InputFacts, WorkingSize
from oppload_cli.video.span import Position, Span
from tests.media import grey_frames, write_video

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from oppload_cli.results.record import FrameRecord


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
        (DetectorError("its units failed"), DetectorError, False),
        (MemoryError(), ShortageError, True),
        (RuntimeError("can't start new thread"), ShortageError, True),
        (OSError(28, "no space left"), OutputError, True),
        (KeyboardInterrupt(), Interrupted, True),
    ],
)
@pytest.mark.parametrize("rows", ["the first 5 rows are", "one row is"])
def test_a_bug_removes_the_rows_and_other_errors_name_them(
    tmp_path: Path,
    error: BaseException,
    raised: type[BaseException],
    kept: bool,
    rows: str,
) -> None:
    video = write_video(tmp_path / "a.avi", grey_frames(12, width=64, height=48))
    settings = resolve(models=["opplod"], measure_rmo=False, height="24")
    outputs = Outputs.of(tmp_path / "out", "a", settings.models)
    task = Task(str(video), settings, outputs)

    def fail(record: FrameRecord) -> None:
        """Raise the error after five frames or one, as a user's own detector may."""
        if record.frame == 4 * ("5" in rows):
            raise error

    with pytest.raises(raised) as found:
        run_task(task, on_frame=fail)
    left = sorted(path.name for path in outputs.csv.parent.iterdir())
    assert left == (["a.detections.jsonl.part", "a.frames.csv.part"] if kept else [])
    named = f"{rows} in {outputs.csv}.part"
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


@pytest.mark.parametrize(
    ("frames", "dropped", "told"), [(60, 30, False), (60, 31, True), (600, 31, False)]
)
def test_dropped_frames_give_a_remark_if_they_are_many_and_a_share(
    frames: int, dropped: int, told: bool
) -> None:
    settings = resolve(models=["dlgmd"], measure_rmo=False, height="13", repeats="keep")
    shown = np.random.default_rng(1).integers(0, 255, (frames, 13, 13), np.uint8)
    with open_source(shown, rate=30, height=13) as source:

        def drop(_record: FrameRecord) -> None:
            source.decode.dropped = dropped

        _, sidecar = analyse_source(source, settings, drop, {"name": "hit"})
    assert sidecar["stimulus"] == {"name": "hit"}
    said = f"{dropped} of {frames + dropped} frames were dropped, because they came faster than"
    found = [each for each in sidecar["remarks"] if "dropped" in each]
    assert [each.startswith(said) for each in found] == [True] * told


@pytest.mark.parametrize("span", [Span(Position(frame=5)), Span(end=Position(frame=0))])
def test_a_part_without_a_frame_says_how_long_the_input_is(tmp_path: Path, span: Span) -> None:
    video = write_video(tmp_path / "a.avi", grey_frames(5), rate=25)
    settings = resolve(models=["dlgmd"], measure_rmo=False, height="24")
    outputs = Outputs.of(tmp_path, "a", settings.models)
    said = "a.avi: has no frame in the part .* leave; it has 0.20 s, 5 frames"
    with pytest.raises(ParameterError, match=said):
        run_task(Task(str(video), settings, outputs, span))
    assert list(tmp_path.iterdir()) == [video]


def test_opencv_has_its_number_of_threads_back_after_all_runs() -> None:
    small, large = WorkingSize(32, 24, 1.0, 1.0), WorkingSize(4000, 3000, 1.0, 1.0)
    before = cv2.getNumThreads()
    try:
        cv2.setNumThreads(2)
        with _threads(small, 0):
            assert cv2.getNumThreads() == 1
            with _threads(large, 3):
                assert cv2.getNumThreads() == 3
            assert cv2.getNumThreads() == 3  # not yet 2, as a run still goes on
        assert cv2.getNumThreads() == 2
    finally:
        cv2.setNumThreads(before)


class Stopped:
    """A source that the user stops after some frames."""

    def __init__(self, after: int, kind: str) -> None:
        self.facts = InputFacts("a", kind, 13, 13, Fraction(30), None)
        self.working = WorkingSize.of(self.facts, None)
        self.decode, self.times = DecodeFacts(), FrameTimes(30)
        self._after = after

    def __iter__(self) -> Iterator[Frame]:
        for index in range(self._after):
            yield Frame(index, ticks(index / 30), np.zeros((13, 13), np.float32))
        raise KeyboardInterrupt


@pytest.mark.parametrize(
    ("after", "kind", "frames"), [(3, "stream", 3), (0, "stream", None), (3, "container", None)]
)
def test_a_live_input_on_standard_output_ends_when_the_user_stops_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, after: int, kind: str, frames: int | None
) -> None:
    settings = resolve(models=["dlgmd"], measure_rmo=False, height="13")
    opening: Any = SimpleNamespace(result=lambda: nullcontext(Stopped(after, kind)))
    with (tmp_path / "stdout").open("w", newline="") as stream:
        monkeypatch.setattr(sys, "stdout", stream)
        with pytest.raises(KeyboardInterrupt) as caught:
            run_task(Task("a", settings), opening=opening)
    outcome = getattr(caught.value, "outcome", None)
    assert (None if outcome is None else outcome.frames) == frames
