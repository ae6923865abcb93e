"""Preset `default` on complete scenes."""

from __future__ import annotations

from functools import cache
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from oppload_cli.models.opplod import Opplod
from tests.detection.scenes import looming_over
from tests.media import texture
from tests.presets import DEFAULT

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from tests.media import Luma


@cache
def flickering() -> list[Luma]:
    """A disk that approaches after a rest, under a lamp that flickers, at times by rows.

    At the end everything stands still but for a few pixels.
    """
    ground = (0.2 + 0.6 * texture(240, 240, 1)).astype(np.float32)
    film = looming_over([ground] * 20)[4:]
    rows = np.arange(240)[:, None] / 240
    for t in range(3, 12):
        film[t] *= np.float32(1 + 0.1 * np.sin(2 * np.pi * (rows * (t % 2) + t / 3)))
    still = [film[-1].copy() for _ in range(3)]
    for t, each in enumerate(still):
        each[t, :50] += np.float32(0.02)
    return [*([film[0]] * 4), *film, *still]


SCENES = {"flickering": flickering}


def of_the_package(scene: str, **changes: Any) -> NDArray[np.float64]:
    """R of each frame."""
    model = Opplod((240, 240), DEFAULT.replaced(**changes))
    answers = [model.step(frame) for frame in SCENES[scene]()]
    return np.array([answer.opponency if answer else 0.0 for answer in answers])


def test_a_scene_that_comes_to_rest_does_not_raise_the_response() -> None:
    peak, *after = of_the_package("flickering")[14:]
    assert all(earlier >= later for earlier, later in pairwise([peak, *after]))
