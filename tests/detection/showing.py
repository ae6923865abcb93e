"""Objects that the tests show to the units of OppLoD."""

from __future__ import annotations

from copy import copy
from typing import TYPE_CHECKING

import numpy as np

from oppload_cli.detection.contact import PlaceParams
from oppload_cli.detection.places import Places
from oppload_cli.models.opplod import Opplod
from oppload_cli.motion.flow import DenseFlow
from tests.media import disk

if TYPE_CHECKING:
    from collections.abc import Iterable

    from oppload_cli.detection.places import Track
    from tests.media import Luma

SIZE = 240
RATE = 30
LENGTH = 12.0  # px s: radius times time to contact, an l/v of 60 ms at 200 px per radian


def remaining(t: int, contact: int) -> float:
    """Seconds to contact at frame `t` if it is at frame `contact`."""
    return (contact - t) / RATE


def approaching(x: float, y: float, contact: int, frames: int) -> list[Luma]:
    """A black disk on white that approaches at constant speed."""
    return [disk(SIZE, x, y, LENGTH / remaining(t, contact)) for t in range(frames)]


def together(*scenes: Iterable[Luma]) -> list[Luma]:
    """Black objects of several scenes in one."""
    return [np.minimum.reduce(frames) for frames in zip(*scenes, strict=True)]


def shown(
    frames: Iterable[Luma],
    params: PlaceParams | None = None,
    hidden: Iterable[int] = (),
    rate: float = RATE,
    interval_s: float = 0.0,
) -> list[list[Track]]:
    """Return the objects of every frame; in `hidden` frames no unit answers."""
    model = Opplod((SIZE, SIZE), frame_rate=rate if interval_s else None)
    places, measured = (
        Places((params or PlaceParams()).of(Opplod.least_object)),
        DenseFlow(interval_s),
    )
    found: list[list[Track]] = []
    for t, frame in enumerate(frames):
        flow = measured.step(frame, t / rate)
        model.layers.flow().give(flow)
        answer = model.step(frame)
        if answer is None:
            found.append([])
            continue
        if t in set(hidden):
            model.units.responses[:] = 0
        found.append([copy(track) for track in places.step(model.units, flow, t / rate)])
    return found
