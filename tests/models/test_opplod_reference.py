"""OppLoD with its judgement of opposing motion made to work, and what all its versions share."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from oppload_cli.errors import ParameterError
from oppload_cli.models.detector import Box
from oppload_cli.models.layers import Layers
from oppload_cli.models.opplod import Opplod, OpplodParams
from oppload_cli.models.opplod_lplc2 import AXES, OpplodLplc2, OpplodLplc2Params
from oppload_cli.models.opplod_paper import OpplodPaper
from oppload_cli.models.opplod_reference import (
    OpplodReference,
    OpplodReferenceParams,
    OpplodReferenceResponse,
    enhanced,
    offset_weights,
)
from oppload_cli.models.timebase import Clock, TimeParams
from tests import reference
from tests.media import disk, looming, texture

if TYPE_CHECKING:
    from oppload_cli.models.detector import Detector
    from oppload_cli.models.units import CellDetector, UnitParams
    from tests.media import Luma

FIELD_OF_200 = OpplodReferenceParams(receptive_field=200, cell=10)
SHAPE = (60, 80)


def random_frames() -> list[Luma]:
    """Every fourth of 16 frames has a high contrast, so that inhibition leaves some excitation."""
    return [
        0.5 + (frame - np.float32(0.5)) * np.float32(1 if t in {3, 7, 11, 15} else 0.02)
        for t, frame in enumerate(np.random.default_rng(21).random((16, *SHAPE), dtype=np.float32))
    ]


def strongest(
    frames: list[np.ndarray], params: OpplodReferenceParams
) -> tuple[float, int, float, float]:
    """Return the peak of R, its frame, and the winning unit's centre."""
    model = OpplodReference(frames[0].shape, params)
    best = (-1.0, -1, np.nan, np.nan)
    for t, frame in enumerate(frames):
        answer = model.step(frame)
        if answer is not None and answer.opponency > best[0]:
            box = answer.box
            centre = (box.x + box.width / 2, box.y + box.height / 2) if box else (np.nan, np.nan)
            best = (answer.opponency, t, *centre)
    return best


@pytest.mark.parametrize("axes", [45, 0])
@pytest.mark.parametrize(
    ("shape", "cell", "field", "sigma"),
    [((40, 61), 5, 38, 1.0), ((33, 29), 7, 28, 1.5), ((3, 5), 8, 100, 1.5)],
)
def test_pooled_opponency_agrees_with_the_literal_reference(
    shape: tuple[int, int], cell: int, field: int, sigma: float, axes: int
) -> None:
    rng = np.random.default_rng(5)
    # Earlier frames have low contrast, so that inhibition leaves some S to pool.
    frames = [rng.random(shape, dtype=np.float32) * s for s in (0, 0, 0.05, 0.1, 1)]
    params = OpplodReferenceParams(
        receptive_field=field, cell=cell, pool_sigma=sigma, axes=axes, periphery=0.7, gain=2.5,
        history=0,
    )  # fmt: skip
    model = OpplodReference(shape, params)
    answer = [model.step(frame) for frame in frames][-1]
    p = reference.photoreceptors(frames)
    expected = reference.opponency(p, field=field, cell=cell, sigma=sigma, axes=axes, w_p=0.7)
    np.testing.assert_allclose(
        np.sqrt(model.units.responses / 2.5), expected, atol=1e-5 * max(1, expected.max())
    )
    assert answer is not None
    assert answer.opponency == pytest.approx(expected.max(), rel=1e-4)
    assert answer.response == pytest.approx(2.5 * expected.max() ** 2, rel=1e-4)


@pytest.mark.parametrize("kind", [Opplod, OpplodReference, OpplodPaper])
def test_pathways_agree_with_the_literal_reference(kind: type[Detector]) -> None:
    rng = np.random.default_rng(6)
    frames = [rng.random((25, 31), dtype=np.float32) for _ in range(4)]
    model = kind((25, 31))
    for frame in frames:
        model.step(frame)
    p = reference.photoreceptors(frames)
    for phi in (45, 135, 225, 315):
        expected = reference.pathway(p, phi)
        np.testing.assert_allclose(model.maps[f"S_{phi}"], expected, atol=1e-5)


# ---- The equations -------------------------------------------------------------------------


def test_offsets_ahead_weigh_1_and_offsets_behind_minus_w_p() -> None:
    right = offset_weights(2, 0, 0.7)
    np.testing.assert_allclose(right, np.tile([-0.7, -0.7, 0, 1, 1], (5, 1)))
    up = offset_weights(1, 90, 2.0)  # rows grow down
    np.testing.assert_array_equal(up, [[1, 1, 1], [0, 0, 0], [-2, -2, -2]])
    up_right = offset_weights(1, 45, 1.0)
    np.testing.assert_array_equal(up_right, [[0, 1, 1], [-1, 0, 1], [-1, -1, 0]])


def model_that_sees(
    pathways: dict[int, Luma], params: OpplodReferenceParams, still: int = 0
) -> OpplodReference:
    """A model after frames that change, with these S_phi.

    The first `still` columns rest until the latest frame.
    """
    shape = next(iter(pathways.values())).shape
    model = OpplodReference((shape[0], shape[1]), params)
    for t, frame in enumerate(np.random.default_rng(1).random((4, *shape), dtype=np.float32)):
        if t < 3:
            frame[:, :still] = 0.5
        model.step(frame)
    for phi, values in pathways.items():
        model._dpc.layer.sums.pathways[phi][:] = values
    return model


@pytest.mark.parametrize("axis", [0, 45, 90, 135])
def test_expansion_is_outward_and_contraction_is_inward(axis: int) -> None:
    """S_phi is 1 at c + u, and S_(phi+180) at c - u; or the two places are exchanged."""
    up, right = np.sin(np.radians(axis)), np.cos(np.radians(axis))
    ahead = (round(10 - 4 * up), round(10 + 4 * right))
    behind = (20 - ahead[0], 20 - ahead[1])
    opponency = {}
    for name, (first, second) in {"out": (ahead, behind), "in": (behind, ahead)}.items():
        turned = (axis % 90 + turn for turn in (0, 90, 180, 270))
        pathways = {phi: np.zeros((21, 21), np.float32) for phi in turned}
        pathways[axis][first] = 1
        pathways[axis + 180][second] = 1
        params = OpplodReferenceParams(receptive_field=11, cell=1, pool_sigma=0.0, axes=axis % 90)
        model = model_that_sees(pathways, params)
        opponency[name] = model._opponency(model._dpc.layer)
    middle = np.zeros((21, 21))
    middle[10, 10] = 1
    np.testing.assert_array_equal(opponency["out"], middle)
    np.testing.assert_array_equal(opponency["in"], 0)
    assert model.units.box(10, 10) == Box(5, 5, 11, 11)


def test_motion_without_history_does_not_count() -> None:
    """The left half rests until the latest frame; 6 cells from the right half there is none."""
    params = OpplodReferenceParams(receptive_field=9, cell=1, pool_sigma=0.0, periphery=0)
    pathways = {phi: np.ones((20, 40), np.float32) for phi in (45, 135, 225, 315)}
    model = model_that_sees(pathways, params, still=20)
    counts = np.ones((20, 40))
    counts[:, :14] = 0
    expected = sum(
        reference.opponent_products(counts, counts, axis, 4, w_p=0) for axis in (45, 135)
    )
    np.testing.assert_array_equal(model._opponency(model._dpc.layer), expected)


def test_enhancing_squares_values_above_the_threshold() -> None:
    values = np.array([[0.0, 0.5, 1.0, 2.0]], np.float32)
    np.testing.assert_array_equal(enhanced(values, 3.0, 0.5), [[0, 0, 3, 12]])


def test_r_at_the_threshold_is_no_response(monkeypatch: pytest.MonkeyPatch) -> None:
    params = OpplodReferenceParams(receptive_field=30, cell=5, threshold=1)
    model = OpplodReference(SHAPE, params)
    monkeypatch.setattr(model, "_opponency", lambda _: np.ones_like(model.units.responses))
    answer = [model.step(frame) for frame in random_frames()][-1]
    assert answer is not None
    assert isinstance(answer, OpplodReferenceResponse)
    assert (answer.opponency, answer.response, answer.box) == (1, 0, None)
    assert model.units.responses.max() == 0


@pytest.mark.once
@pytest.mark.parametrize("axes", [0, 45])
def test_the_winning_unit_is_the_best_one_of_the_maps(axes: int) -> None:
    model = OpplodReference((240, 240), OpplodReferenceParams(axes=axes, gain=2.0))
    answer = [model.step(frame) for frame in looming(240, 100, 130, 12)][-1]
    maps = model.units
    assert answer is not None
    assert answer.box is not None
    assert maps.responses.max() == pytest.approx(answer.response, rel=1e-6)
    row, column = np.unravel_index(maps.responses.argmax(), maps.responses.shape)
    assert maps.centres_x[column] == answer.box.x + 50
    assert maps.centres_y[row] == answer.box.y + 50
    assert maps.field == 100
    assert answer.response == pytest.approx(2 * answer.opponency**2)


@pytest.mark.once
def test_units_below_the_threshold_and_beside_the_grid_answer_zero() -> None:
    frames = looming(240, 120, 120, 12)
    answers = {}
    for threshold, units in ((0.0, "every"), (0.1, "every"), (0.0, "4x4")):
        params = OpplodReferenceParams(threshold=threshold, units=units)
        model = OpplodReference((240, 240), params)
        for frame in frames:
            model.step(frame)
        answers[threshold, units] = model.units.responses
    every = answers[0.0, "every"]
    expected = np.where(every > 0.1**2, every, 0)
    assert 0 < (expected > 0).sum() < (every > 0).sum()
    np.testing.assert_array_equal(answers[0.1, "every"], expected)
    grid = answers[0.0, "4x4"]
    assert 0 < (grid > 0).sum() <= 16
    np.testing.assert_array_equal(grid[grid > 0], every[grid > 0])


# ---- A disk ----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def centre_loom(each_arithmetic: None) -> tuple[float, int, float, float]:
    return strongest(looming(600, 300, 300, 26), FIELD_OF_200)


@pytest.mark.long
@pytest.mark.once
def test_looming_disk_peaks_where_the_edge_leaves_the_field(
    centre_loom: tuple[float, int, float, float],
) -> None:
    assert abs(centre_loom[1] - 22) <= 1


@pytest.mark.long
@pytest.mark.once
def test_receding_disk(centre_loom: tuple[float, int, float, float]) -> None:
    receding = strongest(looming(600, 300, 300, 26)[::-1], FIELD_OF_200)
    assert receding[0] <= 0.01 * centre_loom[0]


@pytest.mark.once
def test_translating_disk(centre_loom: tuple[float, int, float, float]) -> None:
    moving = [disk(600, 200 + 4 * t, 300, 50) for t in range(20)]
    assert strongest(moving, FIELD_OF_200)[0] <= 0.02 * centre_loom[0]


@pytest.mark.once
def test_drifting_texture(centre_loom: tuple[float, int, float, float]) -> None:
    image = texture(600, 680, 1)
    drift = [np.ascontiguousarray(image[:, 4 * t : 4 * t + 600]) for t in range(12)]
    assert strongest(drift, FIELD_OF_200)[0] <= 0.001 * centre_loom[0]


def constancy(count: int) -> tuple[float, float, float]:
    rng = np.random.default_rng(11)
    peaks, errors = [], []
    for x, y in rng.uniform(150, 450, (count, 2)):
        # The peak is near frame 22 wherever the disk is; earlier frames are only warm-up.
        frames = [disk(600, x, y, 5 + 4 * t) for t in range(16, 26)]
        peak, _, found_x, found_y = strongest(frames, FIELD_OF_200)
        peaks.append(peak)
        errors.append(max(abs(found_x - x), abs(found_y - y)))
    values = np.array(peaks)
    return (
        float(values.std() / values.mean()),
        float(values.min() / values.max()),
        float(max(errors)),
    )


def check_constancy(count: int) -> None:
    variation, smallest, error = constancy(count)
    assert variation <= 0.05
    assert smallest >= 0.85
    assert error <= 10


@pytest.mark.long
@pytest.mark.once
def test_peak_and_place_do_not_depend_on_the_position() -> None:
    check_constancy(6)


@pytest.mark.slow
def test_peak_and_place_do_not_depend_on_the_position_of_a_hundred() -> None:
    check_constancy(100)


@pytest.mark.once
def test_units_of_a_grid_are_the_only_ones_that_answer() -> None:
    params = FIELD_OF_200.replaced(units="1x1")
    _, _, x, y = strongest(looming(600, 380, 300, 20), params)
    assert (x, y) == (300, 300)  # in the middle, though 60 cells would fit


@pytest.mark.once
def test_threshold_and_gain_act_on_the_opponency() -> None:
    frames = looming(240, 120, 120, 12)
    silent = OpplodReference((240, 240), OpplodReferenceParams(threshold=1e3))
    loud = OpplodReference((240, 240), OpplodReferenceParams(gain=3))
    for frame in frames:
        off, on = silent.step(frame), loud.step(frame)
    assert off is not None
    assert (off.response, off.box) == (0, None)
    assert off.opponency > 0
    assert on is not None
    assert on.response == pytest.approx(3 * on.opponency**2)


# ---- What the versions have in common --------------------------------------------------------


def test_a_contrast_counts_to_the_fourth_power() -> None:
    """S is linear in the luminance, an opponent product has two factors S, and R^2 has four."""
    # history=0, because random frames lack the history of a moving object.
    params, peaks = OpplodReferenceParams(receptive_field=40, cell=5, history=0), []
    for contrast in (1.0, 0.25):
        model = OpplodReference(SHAPE, params)
        answers = [model.step(frame * np.float32(contrast)) for frame in random_frames()]
        assert answers[-1] is not None
        peaks.append(answers[-1].response)
    assert peaks[1] / peaks[0] == pytest.approx(0.25**4, rel=1e-4)


@pytest.mark.once
@pytest.mark.parametrize(
    ("kind", "params"),
    [
        (Opplod, OpplodParams(threshold=0, history=0)),
        (OpplodReference, OpplodReferenceParams(threshold=0, history=0)),
        (OpplodLplc2, OpplodLplc2Params(threshold=0, history=0)),
    ],
)
def test_a_model_can_be_used_again(kind: type[CellDetector], params: UnitParams) -> None:
    disks = looming(120, 60, 60, 12)
    model = kind((120, 120), params)
    first = [model.step(frame) for frame in disks]
    assert sum(answer.response > 0 for answer in first if answer) > 1
    model.reset()
    assert not model.units.responses.any()
    assert not any(values.any() for values in model.maps.values())
    assert [model.step(frame) for frame in disks] == first


@pytest.mark.parametrize(
    ("kind", "axes"), [(Opplod, (45, 135)), (OpplodReference, (45, 135)), (OpplodLplc2, AXES)]
)
def test_the_layers_are_shared(kind: type[CellDetector], axes: tuple[int, int]) -> None:
    layers = Layers(SHAPE, Clock(TimeParams(interval="0.05")))
    model = kind(SHAPE, layers=layers)
    constants = model.params.scaled(60) if isinstance(model, OpplodLplc2) else model.params
    assert model._dpc.layer is layers.dpc(constants, axes).layer


# ---- Parameters ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"receptive_feild": 3}, "did you mean 'receptive_field'"),
        ({"cell": 0}, "'cell' of opplod_reference must be at least 1, not 0"),
        ({"axes": 30}, "must be 0 or 45, not 30"),
        ({"pool_sigma": float("nan")}, "must be a finite number"),
        ({"gain": "much"}, "takes a number, not 'much'"),
        ({"cell": 2.5}, "takes a whole number or 'auto', not 2.5"),
        ({"cell": True}, "takes a whole number or 'auto', not true"),
        ({"units": "5 by 5"}, "columns x rows such as 5x5, or 'every', not '5 by 5'"),
    ],
)
def test_wrong_values_say_what_is_right(values: dict[str, Any], message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        OpplodReferenceParams().replaced(**values)


@pytest.mark.parametrize(
    ("name", "text", "value"),
    [
        ("receptive_field", "200", 200),
        ("receptive_field", "auto", None),
        ("pool_sigma", "1", 1.0),
        ("units", "5x5", "5x5"),
        ("axes", "45", 45),
    ],
)
def test_text_becomes_a_value(name: str, text: str, value: object) -> None:
    assert OpplodReferenceParams().parsed(name, text) == value


def test_text_of_the_wrong_kind() -> None:
    with pytest.raises(ParameterError, match="takes a whole number or 'auto', not 'wide'"):
        OpplodReferenceParams().parsed("cell", "wide")


@pytest.mark.once
def test_motion_counts_once_it_has_a_history() -> None:
    """A disk grows from the first frame on, another one from the seventh."""
    frames = [
        np.minimum(disk(240, 60, 60, 10 + 2 * t), disk(240, 180, 180, 10 + 3 * max(0, t - 6)))
        for t in range(14)
    ]
    models = [
        OpplodReference((240, 240), OpplodReferenceParams(history=history))
        for history in (0.125, 0)
    ]
    gated, plain = (
        [answer.response if answer else 0 for answer in map(model.step, frames)] for model in models
    )
    assert 0 < gated[8] < plain[8] / 5
    assert gated[9:] == plain[9:]
