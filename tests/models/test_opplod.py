"""OppLoD of all presets, from frames to answers."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from oppload_cli.errors import ParameterError
from oppload_cli.models.camera import NoiseFilter, SteadyLight
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


@pytest.mark.parametrize(
    ("params", "stride"),
    [(REFERENCE, 1), (DEFAULT.replaced(entering=0, residual_noise=0, steady_view=False), 2)],
)
def test_pathways_agree_with_the_literal_reference(params: OpplodParams, stride: int) -> None:
    rng = np.random.default_rng(6)
    frames = [rng.random((25, 31), dtype=np.float32) for _ in range(1 + 3 * stride)]
    model = Opplod((25, 31), params)
    for frame in frames:
        model.step(frame)
    p = reference.photoreceptors(frames[::stride])
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


# ---- Additions of preset default ---------------------------------------------------------------

SHAPE = (40, 61)
# history=0, because random frames lack the history of a moving object.
SMALL = REFERENCE.replaced(receptive_field=30, cell=5, pool_sigma=1.0, periphery=0.7, history=0)


def random_frames() -> list[Luma]:
    """Seven frames; the last has a high contrast, so that some excitation is not inhibited."""
    rng = np.random.default_rng(5)
    contrasts = (0.01, 0.01, 0.02, 0.01, 0.03, 0.05, 1)
    return [rng.random(SHAPE, dtype=np.float32) * np.float32(each) for each in contrasts]


@cache
def literal_opponency(**changes: Any) -> np.ndarray:
    """Both the compiled loops and the plain ones are held to this."""
    parts = {"axes": 45, "stride": 1, "compression": 1, "border": 0, "halved_weight": 0, "cone": 90}
    frames = random_frames()
    return reference.default_opponency(
        frames, field=30, cell=5, sigma=1.0, w_p=0.7, **(parts | changes)
    )


@pytest.mark.parametrize(
    "changes",
    [
        {"compression": 0.5},
        {"compression": 1.5},
        {"border": 6},
        {"stride": 2},
        {"stride": 2, "compression": 0.5},
        {"stride": 2, "compression": 0.5, "border": 4, "axes": 0},
        {"halved_weight": 1.5},
        {"halved_weight": 3, "border": 4, "axes": 0},
        {"stride": 2, "halved_weight": 1.5, "compression": 0.5, "border": 4, "cone": 60},
    ],
)
def test_opponency_agrees_with_the_literal_reference(changes: dict[str, Any]) -> None:
    frames = random_frames()
    model = Opplod(SHAPE, SMALL.replaced(**changes))
    answer = [model.step(frame) for frame in frames][-1]
    expected = literal_opponency(**changes)
    assert expected.max() > 1e-3
    assert answer is not None
    assert answer.opponency == pytest.approx(expected.max(), rel=3e-4)
    row, column = np.unravel_index(expected.argmax(), expected.shape)
    assert answer.box is not None
    assert answer.box.x + 15 == reference.centres(SHAPE[1], 5)[int(column)]
    assert answer.box.y + 15 == reference.centres(SHAPE[0], 5)[int(row)]


def test_the_border_of_the_frame_answers_nothing() -> None:
    """The noise lies within 6 px of the frame's edges."""
    frames = random_frames()
    for frame in frames:
        frame[6:-6, 6:-6] = 0.5
    found = []
    for border in (0, 12):
        model = Opplod(SHAPE, SMALL.replaced(border=border))
        answers = [model.step(frame) for frame in frames]
        found.append(max(answer.opponency for answer in answers if answer))
    assert found[0] > 0
    assert found[1] == 0


@pytest.mark.parametrize("compression", [0.5, 1.0])
def test_a_contrast_counts_to_the_power_of_the_compression(compression: float) -> None:
    """S is linear in the luminance, an opponent product has two factors S, and R^2 has four."""
    peaks = []
    for contrast in (1.0, 0.25):
        model = Opplod(SHAPE, SMALL.replaced(compression=compression))
        answers = [model.step(frame * np.float32(contrast)) for frame in random_frames()]
        assert answers[-1] is not None
        peaks.append(answers[-1].response)
    assert peaks[1] / peaks[0] == pytest.approx(0.25 ** (4 * compression), rel=1e-4)


def test_the_frame_at_half_its_size_answers_before_two_intervals_have_passed() -> None:
    frames = random_frames()
    alone = SMALL.replaced(stride=2)
    params = alone, SMALL.replaced(halved_weight=2.0), alone.replaced(halved_weight=2.0)
    two, one_and_half, both = (
        [model.step(frame) for frame in frames]
        for model in (Opplod(SHAPE, each) for each in params)
    )
    assert two[:6] == [None] * 6
    assert both[:3] == [None] * 3
    for at in range(3, 6):  # `both` has only R of the frame at half its size
        halved, more = both[at], one_and_half[at]
        assert halved is not None
        assert more is not None
        assert 0 <= halved.opponency < more.opponency
    assert max(answer.opponency for answer in both[3:6] if answer) > 0
    assert two[6] is not None
    assert both[6] is not None
    assert both[6].opponency > two[6].opponency


@pytest.mark.once
@pytest.mark.parametrize(
    "changes",
    [
        {"stride": 2},
        {"halved_weight": 1.5},
        {"border": 4},
        {"light_s": 4},
        {"residual_noise": 0.01},
        {"sudden": 0.5},
    ],
)
def test_a_model_of_several_parts_can_be_used_again(changes: dict[str, float]) -> None:
    """There is a bar at the left, and the last frame is the first one in less light."""
    frames = [
        0.5 + (each - np.float32(0.5)) * np.float32(1 if t in {3, 7, 11, 15} else 0.02)
        for t, each in enumerate(np.random.default_rng(21).random((16, 60, 80), dtype=np.float32))
    ]
    for frame in frames:
        frame[:, :12] = 0.2
    frames.append(frames[0] * np.float32(0.8))
    params = REFERENCE.replaced(receptive_field=40, cell=5, adaptation_level=1e-6, history=0)
    model = Opplod((60, 80), params.replaced(adaptation_guard_s=0, **changes))
    first = [model.step(frame) for frame in frames]
    assert sum(answer.response > 0 for answer in first if answer) > 1
    model.reset()
    assert not model.units.responses.any()
    assert not model.units.pathways
    assert not any(each.any() for each in model.maps.values())
    assert [model.step(frame) for frame in frames] == first


@pytest.mark.once
def test_bars_are_known_after_a_quarter_of_a_second_at_any_rate() -> None:
    model = Opplod((60, 80), DEFAULT, frame_rate=60)
    known = []
    for luma in 0.5 + 0.4 * np.random.default_rng(1).random((20, 60, 80), dtype=np.float32):
        luma[:, :12] = 0.1
        model.step(luma)
        assert model._bars
        known.append(model._bars.widths.left)
    assert known == [0] * 15 + [12] * 5  # the first frame shows the strip, and then 15 steps pass


@pytest.mark.once
def test_a_picture_between_bars_answers_as_it_does_alone() -> None:
    """A disk grows at the upper edge of the picture; without a rule, cells in the bar count."""
    params = DEFAULT.replaced(receptive_field=120, cell=6, persistence=0, adaptation_level=0)
    y, x = np.mgrid[:96, :120] + 0.5
    ground = 0.2 + 0.5 * texture(96, 120, 3)
    found = []
    for across, down in ((0, 0), (0, 36), (36, 0)):
        model = Opplod((96 + 2 * down, 120 + 2 * across), params)
        answers = []
        for t in range(20):
            edge = np.clip(2 * t - np.hypot(x - 62, y - 20) + 0.5, 0, 1)
            picture = ground + edge * (0.9 - ground)
            luma = np.pad(picture, ((down, down), (across, across))).astype(np.float32)
            answers.append(model.step(luma))
        found.append([answer.response for answer in answers[10:] if answer])
    assert max(found[0]) > 0.01
    assert found[1:] == [pytest.approx(found[0], rel=1e-4)] * 2


@pytest.mark.once
def test_a_lasting_change_of_the_light_passes_by_time_at_any_rate() -> None:
    """Half a second, the time constant, are 30 frames: then 1 / e of the gain is removed."""
    model = Opplod((60, 80), DEFAULT.replaced(light_s=0.5), frame_rate=60)
    luma = np.asarray(0.3 + 0.6 * texture(60, 80, 1), np.float32)
    for gain in [1.0, *[0.7] * 31]:
        model.step(luma * np.float32(gain))
    light = model._filters[0]
    assert isinstance(light, SteadyLight)
    assert light._gains is not None
    np.testing.assert_allclose(light._gains, np.log(0.7) / np.e, rtol=1e-3)


def test_the_parts_are_those_of_the_parameters_and_know_the_time_base() -> None:
    def made(params: OpplodParams, shape: tuple[int, int] = SHAPE) -> Opplod:
        return Opplod(shape, params, layers=Layers(shape, Clock(TimeParams(interval="0.05"))))

    model = made(DEFAULT)
    light, noise = model._filters
    assert isinstance(light, SteadyLight)
    assert light._lasting == 4 * 20
    assert isinstance(noise, NoiseFilter)
    assert noise._residual == 0.004
    for params in (DEFAULT, LPLC2):
        judgement = made(params).judgement
        assert isinstance(judgement, CellJudgement)
        assert judgement._per_second == 20
    model = made(REFERENCE)
    assert [model._view, model._bars, model._half, *model._filters] == [None] * 3
    # What changes frames or maps has layers of its own.
    layers = Layers(SHAPE)
    for part in (
        {},
        {"light_s": 4},
        {"residual_noise": 0.1},
        {"steady_view": True},
        {"entering": 24},
    ):
        model = Opplod(SHAPE, REFERENCE.replaced(**part), layers=layers)
        assert (model._dpc.layer is layers.dpc(REFERENCE, (45, 135)).layer) == (not part)
    half = made(DEFAULT, (1, 41))._half
    assert half is not None
    assert half.layer.photoreceptors.shape == (1, 20)


def test_both_sizes_of_the_frame_follow_the_view(monkeypatch: pytest.MonkeyPatch) -> None:
    """The view moves by 8 px right in each frame, which are 4 px at half the size."""
    model = Opplod(SHAPE, DEFAULT, frame_rate=60)
    assert model._view is not None
    assert model._half is not None
    steps: list[float] = []

    def moves(_luma: Luma, elapsed: float) -> np.ndarray:
        steps.append(elapsed)
        return np.array([[1, 0, 8.0 * len(steps)], [0, 1, 0], [0, 0, 1]])

    monkeypatch.setattr(model._view, "step", moves)
    for frame in random_frames():
        model.step(frame)
    assert steps == [0.5] * 7
    for layer, right in ((model._dpc.layer, 8), (model._half.layer, 4)):
        np.testing.assert_allclose(layer.photoreceptors.view[0], [1, 0, 7 * right])
    monkeypatch.undo()
    model._view.step(frame, 0.5)
    model.reset()
    assert not model._view._latest


def test_the_fields_of_the_preset() -> None:
    resolved = DEFAULT.resolved(240)
    assert (resolved.receptive_field, resolved.cell, resolved.border) == (240, 12, 6)


# ---- Parameters ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("border", 6),
        ("compression", 0.5),
        ("stride", 2),
        ("halved_weight", 1.5),
        ("history", 0.1),
        ("adaptation_level", 0.05),
        ("pool_sigma", 1.0),
        ("periphery", 1.0),
    ],
)
def test_the_paper_to_the_letter_has_no_addition(name: str, value: float) -> None:
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
def test_motion_that_history_leaves_out_counts_as_background() -> None:
    """A disk grows from the first frame on, another one from the seventh."""
    frames = [
        np.minimum(disk(240, 60, 60, 10 + 2 * t), disk(240, 180, 180, 10 + 3 * max(0, t - 6)))
        for t in range(14)
    ]
    params = DEFAULT.replaced(persistence=0, stride=1, adaptation_guard_s=0)
    models = [Opplod((240, 240), params.replaced(history=history)) for history in (0.125, 0)]
    gated, plain = (
        [answer.response if answer else 0 for answer in map(model.step, frames)] for model in models
    )
    assert 0 < gated[7] < plain[7]
    assert gated[9:] == plain[9:]
