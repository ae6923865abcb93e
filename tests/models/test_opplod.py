"""OppLoD of all presets, from frames to answers."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from oppload_cli.errors import ParameterError
from oppload_cli.models.layers import Layers
from oppload_cli.models.opplod import Opplod
from oppload_cli.models.opposing_motion import CellJudgement, PooledJudgement
from oppload_cli.models.timebase import Clock, TimeParams
from tests import reference
from tests.media import disk, looming, texture
from tests.presets import DEFAULT, LPLC2, PAPER, REFERENCE

if TYPE_CHECKING:
    from oppload_cli.models.opplod_parameters import OpplodParams
    from tests.media import Luma

FIELD_OF_200 = REFERENCE.replaced(receptive_field=200, cell=10)


def strongest(frames: list[np.ndarray], params: OpplodParams) -> tuple[float, int, float, float]:
    """Return the peak of R, its frame, and the winning unit's centre."""
    model = Opplod(frames[0].shape, params)
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
    params = REFERENCE.replaced(
        receptive_field=field, cell=cell, pool_sigma=sigma, axes=axes, periphery=0.7, gain=2.5,
        history=0,
    )  # fmt: skip
    model = Opplod(shape, params)
    answer = [model.step(frame) for frame in frames][-1]
    p = reference.photoreceptors(frames)
    expected = reference.opponency(p, field=field, cell=cell, sigma=sigma, axes=axes, w_p=0.7)
    np.testing.assert_allclose(
        np.sqrt(model.units.responses / 2.5), expected, atol=1e-5 * max(1, expected.max())
    )
    assert answer is not None
    assert answer.opponency == pytest.approx(expected.max(), rel=1e-4)
    assert answer.response == pytest.approx(2.5 * expected.max() ** 2, rel=1e-4)


@pytest.mark.parametrize("params", [REFERENCE, DEFAULT])
def test_pathways_agree_with_the_literal_reference(params: OpplodParams) -> None:
    rng = np.random.default_rng(6)
    frames = [rng.random((25, 31), dtype=np.float32) for _ in range(4)]
    model = Opplod((25, 31), params)
    for frame in frames:
        model.step(frame)
    p = reference.photoreceptors(frames)
    for phi in (45, 135, 225, 315):
        np.testing.assert_allclose(model.pathways[phi], reference.pathway(p, phi), atol=1e-5)


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
    silent = Opplod((240, 240), REFERENCE.replaced(threshold=1e3))
    loud = Opplod((240, 240), REFERENCE.replaced(gain=3))
    for frame in frames:
        off, on = silent.step(frame), loud.step(frame)
    assert off is not None
    assert (off.response, off.box) == (0, None)
    assert off.opponency > 0
    assert on is not None
    assert on.response == pytest.approx(3 * on.opponency**2)


def test_defaults_follow_the_height() -> None:
    assert [REFERENCE.resolved(h).receptive_field for h in (240, 600, 1)] == [100, 250, 2]
    assert [REFERENCE.resolved(h).cell for h in (240, 600, 1)] == [8, 20, 1]
    with pytest.raises(ParameterError, match="'cell' of opplod depends on the working height"):
        PooledJudgement((60, 80), REFERENCE)


# ---- What the presets have in common -----------------------------------------------------------

SHAPE = (60, 80)


def random_frames() -> list[Luma]:
    """Every fourth of 16 frames has a high contrast, so that inhibition leaves some excitation."""
    return [
        0.5 + (frame - np.float32(0.5)) * np.float32(1 if t in {3, 7, 11, 15} else 0.02)
        for t, frame in enumerate(np.random.default_rng(21).random((16, *SHAPE), dtype=np.float32))
    ]


def test_a_contrast_counts_to_the_fourth_power() -> None:
    """S is linear in the luminance, an opponent product has two factors S, and R^2 has four."""
    # history=0, because random frames lack the history of a moving object.
    params, peaks = REFERENCE.replaced(receptive_field=40, cell=5, history=0), []
    for contrast in (1.0, 0.25):
        model = Opplod(SHAPE, params)
        answers = [model.step(frame * np.float32(contrast)) for frame in random_frames()]
        assert answers[-1] is not None
        peaks.append(answers[-1].response)
    assert peaks[1] / peaks[0] == pytest.approx(0.25**4, rel=1e-4)


@pytest.mark.once
@pytest.mark.parametrize("params", [REFERENCE, DEFAULT, LPLC2])
def test_a_model_can_be_used_again(params: OpplodParams) -> None:
    disks = looming(120, 60, 60, 12)
    model = Opplod((120, 120), params.replaced(threshold=0, history=0))
    first = [model.step(frame) for frame in disks]
    assert sum(answer.response > 0 for answer in first if answer) > 1
    model.reset()
    assert not model.units.responses.any()
    assert not model.units.pathways
    assert not any(each.any() for each in model.maps.values())
    assert [model.step(frame) for frame in disks] == first


def test_the_judgement_knows_the_time_base_and_the_layers_are_shared() -> None:
    for params in (DEFAULT, REFERENCE, LPLC2):
        layers = Layers(SHAPE, Clock(TimeParams(interval="0.05")))
        model = Opplod(SHAPE, params, layers=layers)
        assert isinstance(model.judgement, CellJudgement)
        assert model.judgement._per_second == 20
        assert model._dpc.layer is layers.dpc(model.params, model.params.both_axes).layer


def test_the_fields_of_the_preset() -> None:
    resolved = DEFAULT.resolved(240)
    assert (resolved.receptive_field, resolved.cell) == (100, 8)


# ---- Parameters ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("cell", 2),
        ("history", 0.1),
        ("interpolated", "earlier"),
        ("pool_sigma", 1.0),
        ("periphery", 1.0),
    ],
)
def test_the_paper_to_the_letter_has_no_addition(name: str, value: object) -> None:
    with pytest.raises(ParameterError, match=f"'{name}' of opplod must be .* judgement=pixelwise"):
        PAPER.replaced(**{name: value})


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"receptive_feild": 3}, "did you mean 'receptive_field'"),
        ({"cell": 0}, "'cell' of opplod must be at least 1, not 0"),
        ({"axes": 30}, "must be 0 or 45, not 30"),
        ({"pool_sigma": float("nan")}, "must be a finite number"),
        ({"gain": "much"}, "takes a number, not 'much'"),
        ({"cell": 2.5}, "takes a whole number or 'auto', not 2.5"),
        ({"cell": True}, "takes a whole number or 'auto', not true"),
        ({"units": "5 by 5"}, "'every' or columns x rows"),
        ({"judgement": "pixelwise"}, "'cell' of opplod must be 1 with judgement=pixelwise"),
    ],
)
def test_wrong_values_say_what_is_right(values: dict[str, Any], message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        REFERENCE.replaced(**values)


def test_pixelwise_needs_a_grid() -> None:
    with pytest.raises(ParameterError, match="must be a grid such as 5x5"):
        PAPER.replaced(units="every")


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
    assert REFERENCE.parsed(name, text) == value


def test_text_of_the_wrong_kind() -> None:
    with pytest.raises(ParameterError, match="takes a whole number or 'auto', not 'wide'"):
        REFERENCE.parsed("cell", "wide")


@pytest.mark.once
def test_motion_counts_once_it_has_a_history() -> None:
    """A disk grows from the first frame on, another one from the seventh."""
    frames = [
        np.minimum(disk(240, 60, 60, 10 + 2 * t), disk(240, 180, 180, 10 + 3 * max(0, t - 6)))
        for t in range(14)
    ]
    models = [Opplod((240, 240), REFERENCE.replaced(history=history)) for history in (0.125, 0)]
    gated, plain = (
        [answer.response if answer else 0 for answer in map(model.step, frames)] for model in models
    )
    assert 0 < gated[8] < plain[8] / 5
    assert gated[9:] == plain[9:]
