"""The worst misses and false alarms: their frames, and the drawings that the page adds."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import cv2
import numpy as np

from oppload_cli.errors import SourceError
from oppload_cli.evaluation.metrics.alarms import condition_of
from oppload_cli.stimulus.renderer import Renderer
from oppload_cli.video.source import open_video
from oppload_cli.video.span import Position, Span

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from cv2.typing import MatLike

    from oppload_cli.evaluation.evaluate import Evaluation
    from oppload_cli.evaluation.metrics.clips import Clip, Numbers
    from oppload_cli.stimulus.protocol import Protocol


MOST = 4  # of each kind, for each detector
PICTURE_HEIGHT = 270  # px
QUALITY = 82
RATE = 1.0  # false alarms per minute, at which a miss is a miss
WIDTH, HEIGHT = 300, 56  # of a strip, in units of its drawing
HIGHEST = 3.0  # times the threshold at the top of a strip


@dataclass(frozen=True)
class Moment:
    """A frame worth a picture.

    Attributes
    ----------
    clip : int
        Position of the clip.
    frame : int
        The frame.
    detector : str
        The detector that was wrong.
    threshold : float
        Of that detector at 1 false alarm per minute.
    missed : bool
        Whether it is a miss; else a false alarm, or the nearest to one.
    """

    clip: int
    frame: int
    detector: str
    threshold: float
    missed: bool


def worst(evaluation: Evaluation) -> list[Moment]:
    """Return the worst moments of every detector with units, misses first.

    A miss is shown at its largest response from onset to contact, the smallest of them
    first; a clip's false alarm at its largest response without an approach, the
    largest first, a clip once. At most four of each for each detector.
    """
    return [
        moment
        for name in evaluation.performances
        if any(clip.outputs[name].winner is not None for clip in evaluation.clips)
        for moment in _worst_of(evaluation, name)
    ]


def _worst_of(evaluation: Evaluation, name: str) -> Iterator[Moment]:
    clips, found = evaluation.clips, evaluation.performances[name]
    condition = condition_of(RATE)
    threshold = next(
        float(each.thresholds[0]) for each in found.decisions if each.condition == condition
    )
    misses = np.flatnonzero(found.thresholds.detected(threshold) == 0)
    peaks = found.thresholds.peaks
    for missed in sorted(map(int, misses), key=lambda at: (peaks[at], at))[:MOST]:
        frame, _ = _peak(clips[missed], name, *clips[missed].approach)
        yield Moment(missed, frame, name, threshold, missed=True)
    largest = {
        index: _peak(clip, name, *clip.quiet)
        for index, clip in enumerate(clips)
        if clip.quiet[1] > clip.quiet[0]
    }
    for index in sorted(largest, key=lambda at: (-largest[at][1], at))[:MOST]:
        frame, response = largest[index]
        if response > 0:
            yield Moment(index, frame, name, threshold, missed=False)


def _peak(clip: Clip, name: str, start: int, stop: int) -> tuple[int, float]:
    response = clip.outputs[name].response
    frame = start + int(response[start:stop].argmax())
    return frame, float(response[frame])


def pictures(evaluation: Evaluation, moments: Sequence[Moment]) -> dict[tuple[int, int], bytes]:
    """Return the frames of moments as JPEG in grey, by clip and frame.

    A frame that cannot be decoded again is left out.
    """
    return {
        (clip, frame): jpeg
        for clip in sorted({each.clip for each in moments})
        for frame, jpeg in _frames(
            evaluation.entries[clip].path, {each.frame for each in moments if each.clip == clip}
        )
    }


def _frames(path: Path | Protocol, wanted: set[int]) -> Iterator[tuple[int, bytes]]:
    if not isinstance(path, Path):
        drawn = Renderer(path)
        yield from ((frame, _jpeg(drawn.grey(frame))) for frame in sorted(wanted))
        return
    span = Span(start=Position(frame=min(wanted)), end=Position(frame=max(wanted) + 1))
    try:
        with open_video(path, height=PICTURE_HEIGHT, span=span) as video:
            for frame in video:
                if frame.index in wanted:
                    grey = cv2.convertScaleAbs(frame.luma, alpha=255.0)
                    yield frame.index, _jpeg(grey)
    except SourceError:
        return  # it could be read a moment ago: the page stands without the picture


def _jpeg(grey: MatLike) -> bytes:
    _, data = cv2.imencode(".jpg", grey, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    return data.tobytes()


class Strip(NamedTuple):
    """A detector's responses over a clip, as a drawing of `WIDTH` x `HEIGHT`.

    Attributes
    ----------
    approach : tuple of float, or None
        Left edge and width of the approach.
    points : list of tuple of float
        x and y of the responses.
    threshold : float or None
        y of the threshold.
    now : float
        x of the frame shown.
    """

    approach: tuple[float, float] | None
    points: list[tuple[float, float]]
    threshold: float | None
    now: float


def strip(clip: Clip, moment: Moment) -> Strip:
    """Draw the responses over a complete clip, up to three times the threshold."""
    response = np.nan_to_num(clip.outputs[moment.detector].response)
    top = float(response.max()) or 1.0
    threshold = moment.threshold
    if threshold > 0:
        top = min(max(top, 1.2 * threshold), HIGHEST * threshold)
    across = WIDTH / len(clip)
    start, stop = clip.approach

    def height(value: float) -> float:
        return HEIGHT - 2 - (HEIGHT - 6) * min(value / top, 1.0)

    return Strip(
        (start * across, (stop - start) * across) if stop > start else None,
        [((frame + 0.5) * across, height(value)) for frame, value in _thinned(response)],
        None if math.isnan(threshold) else height(threshold),
        (moment.frame + 0.5) * across,
    )


def _thinned(response: Numbers) -> list[tuple[int, float]]:
    """Return frames and responses; of very many frames, the largest of every few."""
    step = max(1, math.ceil(len(response) / (2 * WIDTH)))
    starts = range(0, len(response), step)
    at = [start + int(response[start : start + step].argmax()) for start in starts]
    return [(frame, float(response[frame])) for frame in at]


def winner_of(clip: Clip, moment: Moment) -> tuple[float, ...] | None:
    """Return left, top, width and height of the winning unit's field in source pixels."""
    winner = clip.outputs[moment.detector].winner
    if winner is None or not np.isfinite(winner[moment.frame]).all():
        return None
    return tuple(map(float, winner[moment.frame]))
