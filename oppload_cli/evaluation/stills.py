"""The worst misses and the worst false alarms, as pictures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import cv2
import numpy as np

from oppload_cli.detection.evaluation.alarms import condition_of
from oppload_cli.errors import SourceError
from oppload_cli.evaluation.contenders import PREFIX
from oppload_cli.video.source import open_video
from oppload_cli.video.span import Position, Span

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from oppload_cli.detection.evaluation.series import Seen
    from oppload_cli.evaluation.evaluate import Evaluation

MOST = 4  # of each kind, for each OppLoD
HEIGHT = 270  # px of the pictures
QUALITY = 82
RATE = 1.0  # false alarms per minute, at which a miss is a miss


@dataclass(frozen=True)
class Moment:
    """A frame worth a picture.

    Attributes
    ----------
    clip : int
        Position of the clip.
    frame : int
        The frame.
    contender : str
        Whose fault it was.
    threshold : float
        Of that contender at 1 false alarm per minute.
    missed : bool
        Whether it is a miss; else a false alarm, or what came nearest to one.
    """

    clip: int
    frame: int
    contender: str
    threshold: float
    missed: bool


def worst(evaluation: Evaluation) -> list[Moment]:
    """Return the worst moments of every OppLoD, misses first.

    A miss is shown at its largest response from onset to contact, the smallest of them
    first; a clip's false alarm at its largest response without an approach, the
    largest first, a clip once.

    Parameters
    ----------
    evaluation : Evaluation
        What was measured.

    Returns
    -------
    list of Moment
        At most four of each kind for each.
    """
    names = [each.name for each in evaluation.contenders if each.name.startswith(PREFIX)]
    return [moment for name in names for moment in _worst_of(evaluation, name)]


def _worst_of(evaluation: Evaluation, name: str) -> Iterator[Moment]:
    found = evaluation.measured[name]
    threshold = next(
        float(each.thresholds[0])
        for each in found.decisions
        if each.condition == condition_of(RATE)
    )
    misses = np.flatnonzero(found.approaches.detected(threshold) == 0)
    peaks = found.approaches.peaks
    for missed in sorted(map(int, misses), key=lambda at: (peaks[at], at))[:MOST]:
        seen = evaluation.clips[missed]
        frame = _peak(seen, name, *seen.approach)
        yield Moment(missed, frame, name, threshold, missed=True)
    largest = {
        index: _peak(seen, name, *seen.quiet)
        for index, seen in enumerate(evaluation.clips)
        if seen.quiet[1] > seen.quiet[0]
    }
    heights = {
        index: float(evaluation.clips[index].answers[name].response[frame])
        for index, frame in largest.items()
    }
    for index in sorted(heights, key=lambda at: (-heights[at], at))[:MOST]:
        if heights[index] > 0:
            yield Moment(index, largest[index], name, threshold, missed=False)


def _peak(seen: Seen, name: str, start: int, stop: int) -> int:
    return start + int(seen.answers[name].response[start:stop].argmax())


def pictures(evaluation: Evaluation, moments: Sequence[Moment]) -> dict[tuple[int, int], bytes]:
    """Return the frames of moments as JPEG, in grey.

    Parameters
    ----------
    evaluation : Evaluation
        Names the clips.
    moments : sequence of Moment
        From :func:`worst`.

    Returns
    -------
    dict
        By clip and frame; a frame that cannot be decoded again is left out.
    """
    made: dict[tuple[int, int], bytes] = {}
    for clip in sorted({each.clip for each in moments}):
        wanted = {each.frame for each in moments if each.clip == clip}
        for frame, jpeg in _frames(evaluation.entries[clip].path, wanted):
            made[clip, frame] = jpeg
    return made


def _frames(path: Path, wanted: set[int]) -> Iterator[tuple[int, bytes]]:
    span = Span(start=Position(frame=min(wanted)), end=Position(frame=max(wanted) + 1))
    try:
        with open_video(path, height=HEIGHT, span=span) as video:
            for frame in video:
                if frame.index in wanted:
                    grey = cv2.convertScaleAbs(frame.luma, alpha=255.0)
                    _, data = cv2.imencode(".jpg", grey, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
                    yield frame.index, data.tobytes()
    except SourceError:
        return  # it could be read a moment ago: the page stands without the picture
