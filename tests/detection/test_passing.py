"""Plain objects that pass the camera, entering and leaving the frame: none is an approach."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from numpy.typing import NDArray

from oppload_cli.models.opplod import Opplod
from oppload_cli.models.opplod_parameters import OpplodParams
from tests.media import texture

HEIGHT, WIDTH = 240, 427
FLOOR = Opplod.alarm_floors["default"]
X, Y = np.arange(WIDTH) + 0.5, np.arange(HEIGHT)[:, None] + 0.5
WIDTHS, KINDS = (40, 67, 120, 160), ("post", "box", "disk")

Luma = NDArray[np.float32]


def covered(kind: str, width: float, middle: float) -> NDArray[np.float64]:
    """Return the share of each pixel that the object covers."""
    across = width / 2 - np.abs(X - middle)
    if kind == "disk":
        share = np.clip(width / 2 - np.hypot(X - middle, Y - HEIGHT / 2) + 0.5, 0, 1)
        return np.asarray(share, np.float64)
    down = width / 2 - np.abs(Y - HEIGHT / 2) if kind == "box" else np.full_like(Y, width)
    return np.asarray(np.clip(np.minimum(across, down) + 0.5, 0, 1), np.float64)


def peak(kind: str, width: float, speed: float, ground: Luma, **changes: object) -> float:
    """Return the largest response of preset default to a dark object, over the floor."""
    model = Opplod((HEIGHT, WIDTH), OpplodParams().replaced(**changes), frame_rate=30)
    largest = 0.0
    for t in range(25 + int((WIDTH + 2 * width) / speed)):
        share = covered(kind, width, speed * max(0, t - 15) - width / 2 - 5)
        answer = model.step(np.asarray(ground * (1 - share) + 0.1 * share, np.float32))
        largest = max(largest, answer.response if answer else 0.0)
    return largest / FLOOR


def plain() -> Luma:
    return np.full((HEIGHT, WIDTH), 0.7, np.float32)


@pytest.mark.long
@pytest.mark.parametrize("kind", ["post", pytest.param("box", marks=pytest.mark.slow)])
def test_an_object_that_leaves_at_10_px_per_frame_is_no_approach(kind: str) -> None:
    assert peak(kind, 160, 10, plain()) < 1
    assert peak(kind, 160, 10, plain(), passing=0) < 1
    # Its front edge is cut off then.
    assert peak(kind, 160, 10, plain(), passing=0, entering=0) > 5


@pytest.mark.long
def test_the_edge_of_a_bar_is_one_of_the_frame() -> None:
    ground = plain()
    ground[:, :60] = ground[:, -60:] = 0.1  # as dark as the object, which passes behind them
    assert peak("post", 120, 10, ground, passing=0) < 1
    assert peak("post", 120, 10, ground, passing=0, entering=0) > 2


CASES = [
    pytest.param(
        *case, marks=() if case in {("post", 67, 20.0), ("disk", 120, 33.0)} else pytest.mark.slow
    )
    for case in product(KINDS, WIDTHS, (2.0, 3.3, 5.0, 6.7, 8.0, 10.0, 13.3, 20.0, 33.0))
]


@pytest.mark.long
@pytest.mark.parametrize(("kind", "width", "speed"), CASES)
def test_an_object_that_passes_is_no_approach(kind: str, width: int, speed: float) -> None:
    for ground in (plain(), np.asarray(0.4 + 0.5 * texture(HEIGHT, WIDTH, 4), np.float32)):
        assert peak(kind, width, speed, ground) < 1


@pytest.mark.slow
def test_without_the_rule_most_objects_that_pass_fast_cause_an_alarm() -> None:
    """The edges before and behind such an object are taken for each other."""
    cases = product(KINDS, WIDTHS, (13.3, 20.0, 33.0))
    assert sum(peak(*case, plain(), passing=0) >= 1 for case in cases) >= 20
