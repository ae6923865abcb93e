"""OppLoD to the letter of the paper, and the weaknesses that docs/paper.md says it has."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from oppload_cli.errors import ParameterError
from oppload_cli.models.detector import Box
from oppload_cli.models.dpc import DpcParams, Kernels
from oppload_cli.models.layers import Layers
from oppload_cli.models.opplod_paper import (
    OpplodPaper,
    OpplodPaperParams,
    enhanced,
    layer_e,
    layer_i,
    layer_os,
    layer_s,
    mde,
    opposing_motion,
    photoreceptor,
    selected,
    zone_response,
)
from oppload_cli.models.timebase import Clock
from oppload_cli.models.units import unit_starts
from tests import reference
from tests.media import disk, looming


def peak(frames: list[np.ndarray]) -> float:
    model = OpplodPaper(frames[0].shape)
    answers = [model.step(frame) for frame in frames]
    return max(answer.response for answer in answers if answer)


def faint_then_clear(shape: tuple[int, int]) -> list[np.ndarray]:
    """Random frames; the earlier ones are faint, so that inhibition leaves some excitation."""
    rng = np.random.default_rng(9)
    return [rng.random(shape, dtype=np.float32) * scale for scale in (0, 0, 0.05, 0.1, 1)]


def test_agrees_with_the_literal_reference() -> None:
    frames = faint_then_clear((41, 57))
    params = OpplodPaperParams(receptive_field=20, threshold=1e-3, gain=1.7, units="4x3")
    model = OpplodPaper((41, 57), params)
    answer = [model.step(frame) for frame in frames][-1]
    expected = reference.paper_response(
        reference.photoreceptors(frames), field=20, grid=(4, 3), threshold=1e-3, gain=1.7
    )
    assert answer is not None
    assert answer.response == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize("axes", [45, 0])
def test_the_functions_with_the_names_of_the_paper_are_the_model(axes: int) -> None:
    """Called by hand, one after the other, they give the response to each frame."""
    params = OpplodPaperParams(receptive_field=24, gain=1.3, units="3x2", threshold=1e-4, axes=axes)
    shape = 48, 60
    thetas = params.both_axes
    odd_masks = {theta: mde(params, theta) - 0.5 for theta in thetas}  # D(t) + D(t + 180) = 1
    kernels = replace(Kernels.of(params), odd_masks=odd_masks)
    for theta in thetas:
        np.testing.assert_allclose(mde(params, theta) + mde(params, theta + 180), 1, atol=1e-12)
    frames = faint_then_clear(shape) + faint_then_clear(shape)[2:]
    changes = [photoreceptor(now, before) for before, now in pairwise(frames)]
    model, responses = OpplodPaper(shape, params), []
    for t, frame in enumerate(frames):
        answer = model.step(frame)
        if t < 3:
            assert answer is None
            continue
        p = changes[t - 1], changes[t - 2], changes[t - 3]
        e, i, s = layer_e(p, kernels), layer_i(p, kernels), layer_s(p, kernels)
        s_theta = layer_os(p, kernels)
        for symbol, values in {"P": p[0], "E": e, "I": i, "S": s}.items():
            np.testing.assert_allclose(model.maps[symbol], values, atol=1e-6)
        np.testing.assert_allclose(s, np.maximum(0, e - i), atol=1e-6)
        for theta, values in s_theta.items():
            np.testing.assert_allclose(model.maps[f"S_{theta}"], values, atol=1e-6)
        s_enhanced, s_e = np.zeros((2, 2, 3))
        for row, top in enumerate(unit_starts(48 - 24, 2)):
            for column, left in enumerate(unit_starts(60 - 24, 3)):
                zone = {
                    theta: values[top : top + 24, left : left + 24]
                    for theta, values in s_theta.items()
                }
                for theta in thetas:
                    s_e_theta = selected(opposing_motion(zone, theta), params.threshold)
                    # The other order, S_theta rotated, has the same products.
                    s_enhanced[row, column] += 2 * enhanced(s_e_theta, params.gain)
                    s_e[row, column] += 2 * s_e_theta.sum(dtype=np.float64)
        assert answer is not None
        assert answer.response == pytest.approx(s_enhanced.sum(), rel=1e-6)
        np.testing.assert_allclose(model.units.responses, s_enhanced, rtol=1e-6)
        assert answer.opponency == pytest.approx(s_e.flat[s_enhanced.argmax()], rel=1e-6)
        responses.append(answer.response)
    assert max(responses) > 1


def test_mde_passes_the_direction_and_blocks_the_opposite_one() -> None:
    """1 / (1 + exp(-(x' + y'))) with the offset along theta; rows grow down."""
    y, x = np.mgrid[6:-7:-1, -6:7]
    for theta in (0, 45, 90, 225):
        along = x * np.cos(np.radians(theta)) + y * np.sin(np.radians(theta))
        np.testing.assert_allclose(
            mde(DpcParams(), theta), 1 / (1 + np.exp(np.sqrt(2) * along)), rtol=1e-6
        )


def test_s_over_two_intervals_is_divided_by_two() -> None:
    """With ``time.interval``; a product has two factors S, S_E is its square: four in all."""
    params = OpplodPaperParams(receptive_field=20)
    frames = faint_then_clear((30, 40))
    responses = []
    for rate in (30, 15):
        layers = Layers((30, 40), Clock())
        model = OpplodPaper((30, 40), params, layers=layers)
        for t, frame in enumerate(frames):
            layers.clock.time_s = t / rate
            answer = model.step(frame)
        assert answer is not None
        responses.append(answer.response)
    assert responses[0] > 0
    assert responses[1] == pytest.approx(responses[0] / 2**4, rel=1e-5)


def test_the_opponency_is_the_sum_of_the_products_of_the_best_unit() -> None:
    """Each product counts in both orders."""
    s = {phi: np.full((20, 20), 0.5, np.float32) for phi in (45, 135, 225, 315)}
    assert zone_response(s, (45, 135), 0.25, 1.0) == (0, 0)  # at the threshold
    s[45][:] = 0.75
    assert zone_response(s, (45, 135), 0.25, 1.0) == pytest.approx(
        (800 * 0.375**2, 2 * 400 * 0.375)
    )


def test_frames_without_a_product_above_the_threshold_have_no_box() -> None:
    model = OpplodPaper((41, 57), OpplodPaperParams(receptive_field=20, threshold=1e3))
    answer = [model.step(frame) for frame in faint_then_clear((41, 57))][-1]
    assert answer is not None
    assert (answer.opponency, answer.response, answer.box) == (0, 0, None)


def test_the_grid_covers_the_frame() -> None:
    model = OpplodPaper((600, 800))
    assert model.lefts == [0, 150, 300, 450, 600]
    assert model.tops == [0, 100, 200, 300, 400]


@pytest.mark.parametrize("units", ["every", "5 by 5", "0x3"])
def test_the_zones_are_a_grid(units: str) -> None:
    said = f"'units' of opplod_paper must be columns x rows such as 5x5, not '{units}'$"
    with pytest.raises(ParameterError, match=said):
        OpplodPaperParams(units=units)


def test_it_has_no_parameter_that_the_paper_has_not() -> None:
    for name in ("cell", "history", "pool_sigma", "periphery"):
        with pytest.raises(ParameterError, match=f"no parameter '{name}' of opplod_paper"):
            OpplodPaperParams().replaced(**{name: 1})


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
    model = OpplodPaper((600, 600))
    boxes = [
        answer.box
        for frame in looming(600, 400, 200, 12)
        if (answer := model.step(frame)) and answer.box
    ]
    assert (boxes[-1].x, boxes[-1].y, boxes[-1].width) == (300, 100, 200)


def test_a_frame_smaller_than_the_field_still_answers() -> None:
    model = OpplodPaper((20, 30))
    answers = [model.step(disk(30, 15, 10, 2 + t)[:20]) for t in range(6)]
    assert answers[-1] is not None
    assert answers[-1].response > 0
    assert answers[-1].box == Box(5, 0, 20, 20)  # the field, which the frame cuts
    model.reset()
    assert not model.units.responses.any()
