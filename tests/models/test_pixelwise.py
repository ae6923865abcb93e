"""OMJ of preset `paper`, and the weaknesses that docs/paper.md says it has."""

from __future__ import annotations

import numpy as np
import pytest

from oppload_cli.models.detector import Box
from oppload_cli.models.layers import Layers
from oppload_cli.models.opplod import Opplod
from oppload_cli.models.opposing_motion import PixelwiseJudgement
from oppload_cli.models.timebase import Clock
from tests import reference
from tests.media import disk, looming
from tests.presets import PAPER


def peak(frames: list[np.ndarray]) -> float:
    model = Opplod(frames[0].shape, PAPER)
    answers = [model.step(frame) for frame in frames]
    return max(answer.response for answer in answers if answer)


def test_agrees_with_the_literal_reference() -> None:
    rng = np.random.default_rng(9)
    frames = [rng.random((41, 57), dtype=np.float32) * s for s in (0, 0, 0.05, 0.1, 1)]
    params = PAPER.replaced(receptive_field=20, threshold=1e-3, gain=1.7, units="4x3")
    model = Opplod((41, 57), params)
    answer = [model.step(frame) for frame in frames][-1]
    expected = reference.paper_response(
        reference.photoreceptors(frames), field=20, grid=(4, 3), threshold=1e-3, gain=1.7
    )
    assert answer is not None
    assert answer.response == pytest.approx(expected, rel=1e-5)


def test_s_over_two_intervals_is_halved() -> None:
    """A product has two factors S, S_E is its square, and the response has four."""
    params, values = PAPER.replaced(receptive_field=20), np.random.default_rng(9)
    maps = values.random((4, 30, 40), dtype=np.float32)
    responses = []
    for rate in (30, 15):
        layers = Layers((30, 40), Clock())
        dpc = layers.dpc(params, params.both_axes)
        for t, frame in enumerate(np.resize(maps, (4, 30, 40))):
            layers.clock.time_s = t / rate
            dpc.step(frame)
        for s, each in zip(dpc.layer.sums.pathways.values(), maps, strict=True):
            s[:] = each
        responses.append(PixelwiseJudgement((30, 40), params).judge(dpc.layer).response)
    assert responses[1] == pytest.approx(responses[0] / 2**4, rel=1e-5)


def test_the_opponency_is_the_sum_of_the_products_of_the_best_unit() -> None:
    """Each product counts in both orders."""
    params = PAPER.replaced(receptive_field=20, units="1x1", threshold=0.25)
    dpc = Layers((20, 20), Clock()).dpc(params, params.both_axes).layer
    for s in dpc.sums.pathways.values():
        s[:] = 0.5
    dpc.sums.pathways[45][:] = 0.75
    judged = PixelwiseJudgement((20, 20), params).judge(dpc)
    assert (judged.opponency, judged.response) == pytest.approx((2 * 400 * 0.375, 800 * 0.375**2))
    dpc.sums.pathways[45][:] = 0.5
    judged = PixelwiseJudgement((20, 20), params).judge(dpc)
    assert (judged.opponency, judged.response, judged.box) == (0, 0, None)


def test_the_grid_covers_the_frame() -> None:
    model = Opplod((600, 800), PAPER)
    assert isinstance(model.judgement, PixelwiseJudgement)
    assert model.judgement.lefts == [0, 150, 300, 450, 600]
    assert model.judgement.tops == [0, 100, 200, 300, 400]


@pytest.mark.long
@pytest.mark.once
def test_weakness_inward_motion_is_taken_for_outward() -> None:
    outward = looming(600, 300, 300, 26)
    assert peak(outward[::-1]) >= 0.7 * peak(outward)


@pytest.mark.long
@pytest.mark.once
def test_weakness_an_object_five_px_off_a_centre_loses_most_of_the_response() -> None:
    centre = peak(looming(600, 300, 300, 26))
    assert peak(looming(600, 305, 300, 26)) <= 0.15 * centre


@pytest.mark.once
def test_the_winning_unit_is_the_nearest_one() -> None:
    model = Opplod((600, 600), PAPER)
    boxes = [
        answer.box
        for frame in looming(600, 400, 200, 12)
        if (answer := model.step(frame)) and answer.box
    ]
    assert (boxes[-1].x, boxes[-1].y, boxes[-1].width) == (300, 100, 200)


def test_a_frame_smaller_than_the_field_still_answers() -> None:
    model = Opplod((20, 30), PAPER)
    answers = [model.step(disk(30, 15, 10, 2 + t)[:20]) for t in range(6)]
    assert answers[-1] is not None
    assert answers[-1].response > 0
    assert answers[-1].box == Box(5, 0, 20, 20)  # the field, which the frame cuts
    model.reset()
    assert not model.units.responses.any()
