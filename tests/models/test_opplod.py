"""OppLoD: the opponent units and the growth of the flow, multiplied at each place."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

import cv2
import numpy as np
import pytest

from oppload_cli import run
from oppload_cli.compute import loops
from oppload_cli.models.layers import Layers
from oppload_cli.models.opplod import Opplod, OpplodParams, OpplodResponse, evidence
from oppload_cli.models.opplod_reference import OpplodReference
from oppload_cli.models.timebase import Clock
from oppload_cli.motion.flow import SHORTEST_SIDE, Flow
from tests.media import texture

if TYPE_CHECKING:
    from tests.media import Luma

SIZE, X, Y = 120, 50, 66


@cache
def approach(rate: int, speed: float = 0.0) -> list[Luma]:
    """A disk with a texture, seen for 0.4 s until 0.3 s before contact; the ground moves left."""
    ground, pattern = texture(SIZE, 2 * SIZE, 1), texture(4 * SIZE, 4 * SIZE, 2)
    y, x = np.mgrid[:SIZE, :SIZE].astype(np.float32) + np.float32(0.5)
    shown = []
    for t in range(round(0.4 * rate) + 1):
        size = np.float32(0.7 / (0.7 - t / rate))
        across, down = ((offset / size + 2 * SIZE) for offset in (x - X, y - Y))
        near = cv2.remap(pattern, across, down, cv2.INTER_LINEAR)
        far = cv2.remap(ground, x + np.float32(speed * t / rate), y, cv2.INTER_LINEAR)
        inside = np.clip(14 * size - np.hypot(x - X, y - Y) + 0.5, 0, 1)
        shown.append(np.asarray(0.2 + 0.2 * far + inside * (0.6 * near - 0.2 * far), np.float32))
    return shown


def opplod() -> Opplod:
    return Opplod((SIZE, SIZE), frame_rate=30)


def answers(model: Opplod, frames: list[Luma]) -> list[OpplodResponse]:
    return [answer for answer in map(model.step, frames) if answer]


def unit_responses(shape: tuple[int, int], frames: list[Luma]) -> list[float]:
    """The responses of the units alone."""
    model = OpplodReference(shape, frame_rate=30)
    return [answer.response for answer in map(model.step, frames) if answer]


def test_the_evidence_is_a_product() -> None:
    params = OpplodParams(opponency_weight=0.5, opponency_floor=0.01)
    growth = np.array([[2, 2, 0, 0.5]], np.float32)
    opponency = np.array([[0.15, 0, 9, 0.35]], np.float32)
    expected = [[2 * 0.4, 2 * 0.1, 0, 0.5 * 0.6]]
    np.testing.assert_allclose(evidence(growth, opponency, params), expected, rtol=1e-6)


@pytest.mark.once
def test_the_place_is_that_of_the_largest_product_near_growth() -> None:
    model = opplod()
    *_, answer = answers(model, approach(30))
    assert answer.box is not None
    assert answer.box.centre == pytest.approx((X, Y), abs=6)
    growth = model._growth.growth
    row, column = np.unravel_index(model.units.responses.argmax(), growth.shape)
    centre = model.units.centres_x[column], model.units.centres_y[row]
    assert answer.box.centre == pytest.approx(centre)
    assert answer.growth is not None
    assert answer.growth == pytest.approx(growth[row, column])
    expected = answer.growth * (answer.opponency + 1e-6) ** 0.15
    assert answer.response == pytest.approx(expected, rel=1e-5)
    of_units = unit_responses((SIZE, SIZE), approach(30))
    assert 0 < answer.opponency <= of_units[-1] * (1 + 1e-6)


@pytest.mark.once
def test_growth_is_that_of_the_object() -> None:
    """The texture grows by 1 / 0.3 per second at last, and the growth is that of 0.1 s before."""
    *_, answer = answers(opplod(), approach(30))
    assert answer.growth == pytest.approx(1 / 0.4, rel=0.2)


@pytest.mark.once
def test_before_a_ground_that_moves_the_product_falls_to_a_limit() -> None:
    """The units respond to what moves apart, and the ground moves one way on all sides."""
    still, moved = (answers(opplod(), approach(30, speed))[-1] for speed in (0.0, 150.0))
    assert moved.opponency < 0.05 * still.opponency
    assert moved.growth is not None
    assert moved.growth > 1
    assert moved.response >= 0.99 * moved.growth * 1e-6**0.15


@pytest.mark.parametrize("side", [SHORTEST_SIDE - 1, SHORTEST_SIDE])
def test_a_frame_without_flow_has_no_growth_and_responds_as_the_units_do(side: int) -> None:
    top = Y - side // 2
    frames = [np.ascontiguousarray(frame[top : top + side]) for frame in approach(30)]
    found = answers(Opplod((side, SIZE), frame_rate=30), frames)
    assert [answer.growth is None for answer in found] == [side < SHORTEST_SIDE] * len(found)
    if side < SHORTEST_SIDE:
        of_units = unit_responses((side, SIZE), frames)
        expected = [0.26 * (unit + 1e-6) ** 0.15 * bool(unit) for unit in of_units]
        assert [answer.response for answer in found] == pytest.approx(expected, rel=1e-4)
        assert max(expected) > 0 == min(expected)


def test_pictures_in_between_leave_the_growth_as_it_is() -> None:
    """A pass gives them without a flow; the next flow is that since the latest frame."""
    y, x = np.mgrid[:60, :60].astype(np.float32)
    out = np.stack([x - 30, y - 30], axis=-1) * np.float32(0.2)
    flow = Flow(out, np.ones((60, 60), np.float32), 2, 1 / 15)
    frame = texture(SIZE, SIZE, 1)

    def growth_after(shown: list[tuple[float, Flow | None]]) -> list[float]:
        """Return the largest growth after each frame, given its interval and its flow."""
        clock = Clock()
        model = Opplod((SIZE, SIZE), layers=Layers((SIZE, SIZE), clock))
        found = []
        for interval, given in shown:
            clock.time_s = interval / 30
            model.layers.flow().give(given)
            model.step(frame)
            found.append(float(model._growth.growth.max()))
        return found

    _, before, between, after = growth_after([(0, None), (1, flow), (1.5, None), (3, flow)])
    # Of 3 px in 30 px, in 1/15 s, and followed for 1/30 s with a memory of 0.1 s.
    assert before == pytest.approx(1.5 * (1 - np.exp(-1 / 3)), rel=0.02)
    assert between == before
    *_, once = growth_after([(0, None), (1, flow), (2, flow), (3, flow)])
    assert after == pytest.approx(once, rel=0.02)


@pytest.mark.once
def test_reset_forgets_the_growth() -> None:
    model = opplod()
    first = answers(model, approach(30))
    model.reset()
    assert model.at_rest() == OpplodResponse(0.0, growth=0.0)
    assert not model._growth.growth.any()
    assert answers(model, approach(30)) == first


@pytest.mark.once
def test_growth_and_alarm_agree_at_30_and_60_frames_per_second() -> None:
    growths, starts = [], []
    for rate in (30, 60):
        film = (255 * np.stack(approach(rate))).round().astype(np.uint8)
        result = run(film, rate=rate, models=["opplod"], rmo=False, height=SIZE).frames
        growths.append(result["opplod_growth"].to_numpy()[:: rate // 30][7:])
        starts.append(result["time_s"][result["opplod_alarm"] == 1].min())
    assert growths[0].min() > 0.5
    np.testing.assert_allclose(growths[1], growths[0], rtol=0.15)
    assert starts[1] == pytest.approx(starts[0], rel=0.15)


@pytest.mark.once
def test_both_arithmetics_answer_alike(monkeypatch: pytest.MonkeyPatch) -> None:
    found = []
    for portable in (True, False):
        monkeypatch.setattr(loops, "portable", portable)
        found.append(answers(opplod(), approach(30)))
    one, other = ([answer.response for answer in series] for series in found)
    assert max(one) > 0.1
    assert one == pytest.approx(other, rel=1e-3)
