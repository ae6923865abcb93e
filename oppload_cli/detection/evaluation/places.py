"""How near the winning unit is to the labelled object."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from oppload_cli.detection.evaluation.series import Box, Numbers, Seen

NEAR_CONTACT = 15  # frames before contact
GROWN = 1.5  # times as large as the box, about its centre
FRAME_CENTRE = "frame_centre"  # what one would get by always pointing at the middle


class Place(NamedTuple):
    """A boxed frame of a clip, and where a contender saw the object.

    Attributes
    ----------
    clip : int
        Position of the clip.
    frame : int
        The frame.
    near : bool
        Whether it is within 15 frames before contact, or at it.
    distance_px, distance_diagonals : float
        From the centre of the winning unit to that of the box, in source pixels and
        in diagonals of the box; NaN where nothing won.
    inside : bool
        Whether the unit's centre is inside the box grown by half its size.
    """

    clip: int
    frame: int
    near: bool
    distance_px: float
    distance_diagonals: float
    inside: bool


def places(clips: Sequence[Seen], contender: str) -> list[Place]:
    """Return every boxed frame that is clear of warm-up.

    Parameters
    ----------
    clips : sequence of Seen
        All clips.
    contender : str
        One that knows places, or ``frame_centre``.

    Returns
    -------
    list of Place
    """
    return [place for index, seen in enumerate(clips) for place in _of(index, seen, contender)]


def _of(index: int, seen: Seen, contender: str) -> Iterator[Place]:
    centres = _centres(seen, contender)
    for frame, box in sorted(seen.label.boxes.items()):
        if not seen.first <= frame < len(seen):
            continue
        contact = seen.label.contact
        near = contact is not None and contact - NEAR_CONTACT <= frame <= contact
        yield Place(index, frame, near, *_compared(centres[frame], box))


def _centres(seen: Seen, contender: str) -> Numbers:
    if contender == FRAME_CENTRE:
        return np.tile([seen.width / 2, seen.height / 2], (len(seen), 1))
    fields = seen.answers[contender].place
    if fields is None:
        return np.full((len(seen), 2), np.nan)
    return np.asarray(fields[:, :2] + fields[:, 2:] / 2, np.float64)


def _compared(centre: Numbers, box: Box) -> tuple[float, float, bool]:
    left, top, width, height = box
    off = np.abs(centre - (left + width / 2, top + height / 2))
    distance = float(np.hypot(*off))
    inside = bool(off[0] <= GROWN * width / 2 and off[1] <= GROWN * height / 2)
    return distance, distance / float(np.hypot(width, height)), inside
