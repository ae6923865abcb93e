"""A complete annotated video, decoded again."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from typing import TYPE_CHECKING

import av
import numpy as np
import pytest

from oppload_cli.annotation.frame import Layout
from oppload_cli.annotation.video import AnnotatedVideo
from oppload_cli.errors import OutputError
from oppload_cli.pipeline.analysis import analyse
from oppload_cli.video.source import open_video
from tests.annotation.records import detection, facts, paint_of
from tests.media import grey_frames, write_video

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

MODELS = ("opplod", "dlgmd")
PAINT = paint_of("opplod")


def annotate(
    source: Path, target: Path, box: tuple[float, float, float, float], boxes: str = "all"
) -> AnnotatedVideo:
    """Annotate with a box in every frame, that alarms in every second one."""
    with open_video(source, height=48, colour=True) as video:
        annotated = AnnotatedVideo(target, video, MODELS, boxes)
        for record in analyse(annotated.frames, rmo=None):
            found = detection(box, alarm=bool(record.frame % 2))
            said = replace(record["opplod"], objects=(found,))
            annotated.write(replace(record, detectors={**record.detectors, "opplod": said}))
        annotated.finish()
        annotated.commit()
    return annotated


def decoded(path: Path) -> list[NDArray[np.uint8]]:
    with av.open(str(path)) as container:
        frames = container.decode(video=0)
        return [np.asarray(frame.to_ndarray(format="bgr24"), np.uint8) for frame in frames]


def columns_of(frame: NDArray[np.uint8], paint: tuple[int, int, int], row: int) -> list[int]:
    """Return the columns of a row that have a colour, as far as coding keeps it."""
    distance = np.abs(frame[row].astype(int) - paint).max(axis=1)
    return np.flatnonzero(distance < 45).tolist()


def test_boxes_and_strip_are_where_they_belong(tmp_path: Path) -> None:
    source = write_video(tmp_path / "a.avi", grey_frames(12, width=320, height=240))
    annotate(source, tmp_path / "a.annotated.mp4", (50, 60, 100, 80))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.annotated.mp4", "a.avi"]
    frames = decoded(tmp_path / "a.annotated.mp4")
    layout = Layout.of(facts(320, 240))
    assert len(frames) == 12
    for frame in frames:
        assert frame.shape == (layout.height, layout.width, 3)
        # In twice the size, from column 100 to 300, away from the centre's mark.
        seen = columns_of(frame, PAINT, 160)
        assert seen
        assert min(seen) == pytest.approx(100, abs=2)
        assert max(seen) == pytest.approx(299, abs=2)
        assert not [column for column in seen if 105 < column < 295]
        line = frame[layout.plot.y + round(layout.level_row(1)), layout.plot.x + 300 :]
        assert line[:200].mean() < 90
        assert frame[layout.header.y + layout.line + 2 :].mean() > 200


@pytest.mark.parametrize(("boxes", "shown"), [("all", 12), ("alarm", 6), ("none", 0)])
def test_boxes_are_chosen(tmp_path: Path, boxes: str, shown: int) -> None:
    source = write_video(tmp_path / "a.avi", grey_frames(12, width=320, height=240))
    annotate(source, tmp_path / "a.annotated.mp4", (50, 60, 100, 80), boxes)
    frames = decoded(tmp_path / "a.annotated.mp4")
    assert sum(bool(columns_of(frame, PAINT, 160)) for frame in frames) == shown


def test_the_picture_is_that_of_the_source(tmp_path: Path) -> None:
    images = grey_frames(6, width=640, height=480)
    source = write_video(tmp_path / "a.avi", images)
    annotate(source, tmp_path / "a.annotated.mp4", (-5, -5, 1, 1))
    for frame, image in zip(decoded(tmp_path / "a.annotated.mp4"), images, strict=True):
        part = frame[200:480, 0:640].astype(int) - image[200:, :, None]
        assert np.abs(part).mean() < 4


def test_frames_keep_their_times(tmp_path: Path) -> None:
    times = [0, 40, 50, 400, 410, 415, 1000, 1001]
    base = Fraction(1, 1000)
    source = write_video(tmp_path / "a.mkv", grey_frames(8), times=times, time_base=base)
    annotate(source, tmp_path / "a.annotated.mp4", (1, 1, 9, 9))
    with av.open(str(tmp_path / "a.annotated.mp4")) as container:
        seen = [float(f.time or 0) for f in container.decode(video=0)]
    assert seen == [t / 1000 for t in times]


@pytest.mark.parametrize("size", [(63, 47), (2, 2), (10, 300), (300, 10)])
def test_odd_sizes(tmp_path: Path, size: tuple[int, int]) -> None:
    source = write_video(tmp_path / "a.mkv", grey_frames(4, width=size[0], height=size[1]))
    annotate(source, tmp_path / "a.annotated.mp4", (0, 0, 5, 5))
    assert len(decoded(tmp_path / "a.annotated.mp4")) == 4


def test_no_video_is_written_without_a_frame(tmp_path: Path) -> None:
    source = write_video(tmp_path / "a.avi", grey_frames(4))
    target = tmp_path / "a.annotated.mp4"
    target.write_bytes(b"of another run")
    with open_video(source, colour=True) as video:
        annotated = AnnotatedVideo(target, video, MODELS)
        annotated.finish()
        annotated.commit()
    assert [path.name for path in tmp_path.iterdir()] == ["a.avi"]


def test_a_kept_video_plays_and_a_discarded_one_is_gone(tmp_path: Path) -> None:
    source = write_video(tmp_path / "a.avi", grey_frames(9))
    target, part = tmp_path / "a.annotated.mp4", tmp_path / "a.annotated.mp4.part"
    for keep in (True, False):
        with open_video(source, colour=True) as video:
            annotated = AnnotatedVideo(target, video, MODELS)
            for record, _ in zip(analyse(annotated.frames, rmo=None), range(8), strict=False):
                annotated.write(record)
                assert len(annotated._waiting) <= 5
            if keep:
                annotated.finish()  # as where another file could not be written after that
            (annotated.keep if keep else annotated.discard)()
        assert not target.exists()
        assert part.exists() == keep
        if keep:
            assert len(decoded(part)) == 8


def test_an_error_of_the_thread_reaches_the_caller(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = write_video(tmp_path / "a.avi", grey_frames(30))
    target = tmp_path / "a.annotated.mp4"

    def refuse(*_: object) -> None:
        raise OSError(28, "No space left on device")

    with open_video(source, colour=True) as video:
        annotated = AnnotatedVideo(target, video, MODELS)
        monkeypatch.setattr("oppload_cli.video.writers.Recording.write", refuse)

        def write_all() -> None:
            for record in analyse(annotated.frames, rmo=None):
                annotated.write(record)
            annotated.finish()

        with pytest.raises(OutputError, match=r"a\.annotated\.mp4: cannot be written \(no space"):
            write_all()
        annotated.keep()
    assert [path.name for path in tmp_path.iterdir()] == ["a.avi"]
