"""The published detectors against literal versions, and their known responses."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from oppload_cli.errors import ParameterError
from oppload_cli.models.published import ci_lmd
from oppload_cli.models.published.parts import at_least, mean_change, total
from oppload_cli.models.registry import detector_named
from tests.models import published_reference as literal

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from oppload_cli.models.detector import Detector, Response

    Frames = list[NDArray[np.uint8]]


@pytest.fixture(autouse=True, scope="module")
def each_arithmetic() -> None:
    """Run these tests once: no compiled loops are used."""


NAMES = (
    *("lgmd1_single", "lgmd1_onoff", "lgmd1_group", "lgmd2", "lgmd_plus", "lgmd_contrast"),
    *("ci_lmd", "area_growth", "ttc_gradient"),
)


def scene(kind: str, frames: int = 14, shape: tuple[int, int] = (36, 49)) -> Frames:
    """A square that grows over a texture, with noise; of kind `flash`, some frames are inverted."""
    rng = np.random.default_rng(5)
    ground = 120 + 40 * np.kron(rng.random((9, 13)), np.ones((4, 4)))[: shape[0], : shape[1]]
    y, x = np.mgrid[: shape[0], : shape[1]]
    shown = []
    for t in range(frames):
        frame = np.roll(ground, t // 3, axis=1)
        inside = np.maximum(abs(y - 16), abs(x - 22)) < 2 + 0.9 * t
        frame = np.where(inside, 250.0 if kind == "bright" else 15.0, frame)
        if kind == "flash" and t in {5, 6, 9}:
            frame = 255 - frame
        shown.append(np.round(frame + rng.normal(0, 2, shape)).clip(0, 255).astype(np.uint8))
    return shown


def light(grey: NDArray[np.uint8]) -> NDArray[np.float32]:
    return np.asarray(grey, np.float32) / np.float32(255)


def model_of(name: str, frames: Frames, **params: Any) -> Detector:
    kind = detector_named(name)
    return kind(frames[0].shape, kind.parameters(**params), frame_rate=30)


def answers(name: str, frames: Frames, **params: Any) -> list[Any]:
    model = model_of(name, frames, **params)
    return [model.step(light(each)) for each in frames]


def peak(found: list[Response | None]) -> float:
    return max(each.response for each in found if each is not None)


def assert_equal(found: list[Any], expected: Iterator[dict[str, float]]) -> None:
    rows = list(expected)
    for name in rows[0]:
        values = np.array([row[name] for row in rows])
        got = np.array([float(getattr(each, name)) for each in found[1:]])
        assert got == pytest.approx(values, rel=1e-4, abs=1e-6 * np.abs(values).max()), name


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        # The literal `ttc_gradient` takes a second for a scene.
        pytest.param(name, kind, marks=pytest.mark.slow if slow else ())
        for name in NAMES
        for kind, slow in (("dark", name == "ttc_gradient"), ("bright", True), ("flash", False))
    ],
)
def test_every_value_is_that_of_the_literal_version(name: str, kind: str) -> None:
    frames = scene(kind)
    found = answers(name, frames)
    assert_equal(found, getattr(literal, name)(frames))
    if kind == "flash":
        assert peak(found) > 0


@pytest.mark.parametrize("name", ["lgmd1_single", "lgmd1_onoff", "lgmd2", "lgmd_plus"])
def test_every_value_at_another_frame_rate(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Delays are in ms; LGMD2's path of brightening is silent at 30 frames per second."""
    frames, kind = scene("bright"), detector_named(name)
    model = kind(frames[0].shape, frame_rate=120)
    monkeypatch.setattr(literal, "TI", 8)
    found = [model.step(light(each)) for each in frames]
    assert_equal(found, getattr(literal, name)(frames))
    assert peak(found) > 0


@pytest.mark.parametrize(
    ("name", "params", "expected"),
    [
        ("lgmd1_single_paper", {}, lambda f: literal.lgmd1_single(f, absolute=True)),
        (
            "lgmd1_group_paper",
            {},
            lambda f: literal.lgmd1_group(f, 1 / (1 + np.e), 1 / (1 + np.e**2)),
        ),
        ("plgmd", {"p": 1.0}, literal.lgmd1_group),
    ],
)
def test_variants(
    name: str, params: dict[str, Any], expected: Callable[[Frames], Iterator[dict[str, float]]]
) -> None:
    frames = scene("dark")
    rows = list(expected(frames))
    if name == "plgmd":
        rows = [{key: row[key] for key in ("k", "sum_abs_g")} for row in rows]
    assert_equal(answers(name, frames, **params), iter(rows))


def test_a_reset_forgets_everything() -> None:
    frames = scene("dark")
    for name in (*NAMES, "plgmd"):
        model = model_of(name, frames)
        first = [model.step(light(each)) for each in frames]
        model.reset()
        assert [model.step(light(each)) for each in frames] == first, name


def test_the_sum_of_a_map_does_not_depend_on_its_place_in_memory() -> None:
    # Values of very different size: each order of additions gives another sum.
    values = np.asarray(10 ** np.random.default_rng(1).uniform(-8, 3, (120, 213)), np.float32)
    room = np.empty(values.size + 16, np.float32)
    sums = set()
    for start in range(16):
        room[start:][: values.size] = values.ravel()
        sums.add(total(room[start:][: values.size].reshape(values.shape)))
    assert len(sums) == 1


def test_large_sums_of_changes_are_rounded_as_those_of_the_authors() -> None:
    """Above 2^24 they are even: two changes of 255 add 254 and 256, or twice 256."""
    summed = np.float32(0)
    for _ in range(66_000):
        summed += np.float32(255)
    assert summed != 255 * 66_000
    assert mean_change(np.full((66, 1000), -255, np.float32)) == float(summed) / 66_000


def test_values_at_a_threshold_count() -> None:
    """A mean change of exactly 10 silences the next frame, and one of 9 does not."""
    for level, silent in ((10, True), (9, False)):
        frames = [np.full((8, 8), each, np.uint8) for each in (0, level, 80)]
        assert (answers("lgmd1_single", frames)[-1].mp == 0) is silent
    model = model_of("lgmd1_group", scene("dark"), layer_threshold=2)
    found = model._thresholded(np.array([-2.0, -1.9, 1.9, 2]))  # type: ignore[attr-defined]
    assert found.tolist() == [-2, 0, 0, 2]
    p = np.full((36, 49), 100.0)  # a change of 1.9 before does not inhibit
    assert model._respond_to(p, 0.019 * p).sum_abs_s == p.sum()  # type: ignore[attr-defined]
    assert at_least(np.array([[29.999, 30]], np.float32), 30).tolist() == [[0, 30]]


def test_each_mask_of_plgmd_is_that_of_its_own_layer() -> None:
    """Without G nothing is left; without inhibition more is left than with it."""
    rng = np.random.default_rng(3)
    q, before = rng.uniform(50, 200, (2, 20, 30))
    sums = []
    for closed in (None, 0, 1, 2, 10):  # of Q and E, of I, of G, of the last tap
        model = model_of("plgmd", [np.zeros((20, 30), np.uint8)], p=0.5)
        masks = np.ones((11, 20, 30), np.bool_)
        masks[[] if closed is None else closed] = False
        model._masks = lambda masks=masks: masks  # type: ignore[attr-defined]
        sums.append(model._sum_of_g(q, before))  # type: ignore[attr-defined]
    everything, without_e, without_i, without_g, without_tap = sums
    assert without_g == 0
    assert without_i > without_tap > everything > 0
    assert without_e != everything


def test_the_count_of_spikes_is_a_byte() -> None:
    still = [np.zeros((8, 8), np.uint8)] * 258
    counts = [each.nsp for each in answers("lgmd1_single", still, spike=0)[1:]]
    assert counts == [*range(1, 256), 0, 1]


def test_ci_lmd_sees_nothing_where_both_gaussians_differ_in_sign() -> None:
    """The dark pixel lies within the wide Gaussian only."""
    p = np.zeros((11, 11), np.float32)
    p[5, 5], p[5, 9] = 1, -100
    assert ci_lmd._difference(p)[5, 5] == 0
    assert ci_lmd._difference(np.maximum(p, 0))[5, 5] > 0


@pytest.mark.parametrize(
    ("name", "value", "per_pixel"),
    [
        *((each, "mp", True) for each in ("lgmd1_single", "lgmd1_onoff", "lgmd2", "lgmd_plus")),
        *(("lgmd1_group", "sum_abs_g", True), ("plgmd", "sumg_mean", True)),
        *(("ttc_gradient", "best_score", False), ("area_growth", "growth", False)),
    ],
)
def test_the_response_is_one_of_the_values(name: str, value: str, per_pixel: bool) -> None:
    """The table of docs/detectors.md."""
    first, _, *found = answers(name, scene("bright"))
    assert (first is None) == (detector_named(name).warm_up > 0)
    expected = [max(0, getattr(each, value)) / (36 * 49 if per_pixel else 1) for each in found]
    assert [each.response for each in found] == pytest.approx(expected)
    assert max(expected) > 0


def test_the_milliseconds_of_a_frame_are_cut_to_an_integer() -> None:
    kind = detector_named("lgmd2")
    rates = {30: 33, 60: 16, 29.97: 33, 1000 / 30: 30, 1000 / 15: 15, 2000: 1, None: 33}
    assert {rate: kind((9, 9), frame_rate=rate).ti for rate in rates} == rates  # type: ignore[attr-defined]


@pytest.mark.parametrize("name", ["lgmd1_single", "lgmd1_onoff", "lgmd_plus"])
def test_a_collision_stays_over_a_still_scene(name: str) -> None:
    frames = growing(1.0)
    model = model_of(name, frames, spike=0.5)
    last = [model.step(light(each)) for each in frames][-1]
    assert (last.collision, model.at_rest().collision) == (1, 1)  # type: ignore[union-attr,attr-defined]
    model.reset()
    assert model.at_rest().collision == 0  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("name", "lasting"),
    [
        ("area_growth", ("area", "size")),
        ("emd_lplc2_gf", ("v_end", "collision")),
        ("mlplc2", ("n_fields", "field_id", "field_x", "field_y")),
        ("hua_literal", ("q_right_down", "q_left_down", "q_left_up", "q_right_up", "product")),
    ],
)
def test_values_that_outlast_the_motion_stay_over_a_still_scene(
    name: str, lasting: tuple[str, ...]
) -> None:
    frames = growing(1.0)
    model = model_of(name, frames)
    at_start = model.at_rest()
    last = [model.step(light(each)) for each in frames][-1]
    kept = model.at_rest()
    assert [getattr(kept, each) for each in lasting] == [getattr(last, each) for each in lasting]
    assert (kept.response, kept != at_start) == (0, True)
    model.reset()
    assert model.at_rest() == at_start == model.responses(0.0)


@pytest.mark.parametrize("name", ["lgmd1_group", "lgmd1_group_paper", "plgmd"])
def test_the_potential_over_a_still_scene_is_that_without_any_g(name: str) -> None:
    still = [np.full((36, 49), 128, np.uint8)] * 3
    assert [each.k for each in answers(name, still)] == [0, 0, 0.5]
    assert model_of(name, still).at_rest().k == 0.5  # type: ignore[attr-defined]


def test_the_scale_of_grouping_over_a_still_scene_is_its_least() -> None:
    still = [np.full((36, 49), 128, np.uint8)] * 3
    assert [each.omega for each in answers("lgmd1_group", still)] == [0, 0, 0.01]
    assert model_of("lgmd1_group", still).at_rest().omega == 0.01  # type: ignore[attr-defined]


# ---- Known responses of each detector ------------------------------------------------------


def growing(
    contrast: float, *, back: bool = False, ground: int = 128, speed: float = 1.0
) -> Frames:
    """A disk that grows on a plain ground, dark for a contrast below 0; or one that shrinks."""
    y, x = np.mgrid[:72, :99]
    distance = np.hypot(y - 36, x - 49)
    level = round(ground * (1 + contrast)) if contrast < 0 else round(128 + 127 * contrast)
    shown = [np.where(distance < 3 + t, level, ground).astype(np.uint8) for t in range(25)]
    return shown[::-1] if back else shown


DARK, BRIGHT = growing(-1.0), growing(1.0)


def test_lgmd1_single_sees_only_brightening_as_coded() -> None:
    assert peak(answers("lgmd1_single", DARK)) == 0
    assert peak(answers("lgmd1_single", BRIGHT)) > 1
    as_published = peak(answers("lgmd1_single", DARK, variant="paper"))
    assert as_published == pytest.approx(peak(answers("lgmd1_single", BRIGHT)), rel=0.1)


def test_lgmd1_single_and_onoff_are_silenced_by_a_large_change() -> None:
    flash = np.minimum(BRIGHT[12].astype(int) + 100, 255).astype(np.uint8)
    frames = [*BRIGHT[:12], flash, *BRIGHT[13:]]
    single, paired = answers("lgmd1_single", frames), answers("lgmd1_onoff", frames)
    assert (single[12].mp > 0, single[13].mp) == (True, 0)
    assert (paired[12].mp, paired[12].sfa) == (0, 0.5)
    assert paired[11].mp > 0


def test_lgmd1_group_is_blind_to_the_sign_of_contrast() -> None:
    ground = growing(-0.5, ground=120)
    dark, bright = (answers("lgmd1_group", frames) for frames in (ground, invert(ground)))
    assert [each.k for each in dark] == pytest.approx([each.k for each in bright])
    assert peak(dark) > 0


def invert(frames: Frames) -> Frames:
    return [255 - each for each in frames]


def test_lgmd1_group_never_forgets_as_coded() -> None:
    still = [*DARK, *[DARK[-1]] * 12]
    for persistence, remains in (("literal", True), ("paper", False)):
        found = answers("lgmd1_group", still, persistence=persistence)
        assert (found[-1].response > 0.1 * peak(found)) == remains


def test_lgmd2_is_silent_for_a_bright_approach_and_a_dark_retreat() -> None:
    for frames in (BRIGHT, growing(-1.0, back=True)):
        assert {each.smp for each in answers("lgmd2", frames)[1:]} == {0.5}
    assert peak(answers("lgmd2", DARK)) > 1
    assert peak(answers("lgmd2", growing(1.0, back=True))) > 1


def test_lgmd_plus_gates_weak_changes() -> None:
    rng = np.random.default_rng(3)
    noise = [np.asarray(128 + rng.integers(-2, 3, (72, 99)), np.uint8) for _ in range(8)]
    assert peak(answers("lgmd_plus", noise)) == 0
    assert peak(answers("lgmd_plus", BRIGHT)) > 1.5 * peak(answers("lgmd_plus", growing(-0.99)))


@pytest.mark.long
def test_plgmd_depends_on_its_seed_alone_and_scatters() -> None:
    again = answers("plgmd", DARK, runs=8), answers("plgmd", DARK, runs=8)
    assert again[0] == again[1]
    other = answers("plgmd", DARK, runs=8, seed=2)
    assert [each.sumg_mean for each in other] != [each.sumg_mean for each in again[0]]
    late = again[0][-1]
    assert 0 < late.sumg_sd < late.sumg_mean
    means = [answers("plgmd", DARK, runs=8, p=p)[-1].sumg_mean for p in (0.3, 0.55, 0.8, 1)]
    assert means == sorted(means)


def test_the_synapses_of_plgmd_transmit_independently() -> None:
    model = model_of("plgmd", scene("dark"), p=0.3)
    masks = np.stack([model._masks() for _ in range(60)])  # type: ignore[attr-defined]
    shares = masks.mean((0, 2, 3))
    assert shares == pytest.approx([0.3**2] + [0.3] * 10, abs=0.006)
    pairs = np.corrcoef(masks.transpose(1, 0, 2, 3).reshape(11, -1)) - np.eye(11)
    assert np.abs(pairs).max() < 0.015


def test_lgmd_contrast_keeps_its_response_from_a_contrast_of_a_fifth() -> None:
    # The contrast is below 0: at 1 the disk is black.
    peaks = [peak(answers("lgmd_contrast", growing(-c))) for c in (0.2, 0.4, 0.6, 0.8, 1.0)]
    assert max(peaks) <= 1.2 * min(peaks)
    flash = [np.full((72, 99), level, np.uint8) for level in (60, 200)]
    assert answers("lgmd_contrast", flash)[-1].mp == pytest.approx(1, abs=1e-6)


def test_ci_lmd_answers_to_a_strong_change_when_it_is_over() -> None:
    # During a change So and Sf have different signs, so that their product is below 0.
    for frames in (BRIGHT, DARK):
        assert {each.ci_lmd for each in answers("ci_lmd", frames)} == {0.5}
    step = [np.full((40, 40), level, np.uint8) for level in (255, 0, 0, 0)]
    found = answers("ci_lmd", step)
    assert [each.response > 0 for each in found] == [False, False, True, False]


def test_area_growth_is_one_over_the_time_to_contact() -> None:
    y, x = np.mgrid[:120, :120]
    contact = 60
    frames = [
        np.where(np.hypot(y - 60, x - 60) < 300 / (contact - t), 20, 200).astype(np.uint8)
        for t in range(52)
    ]
    frames.insert(0, np.full((120, 120), 200, np.uint8))
    found = answers("area_growth", frames)
    # Growth compares with the size 3 frames ago: 1 / growth is 3 frames late.
    assert 1 / found[51].growth == pytest.approx(contact - 50 + 3, rel=0.03)
    retreat = [frames[0], *frames[:0:-1]]
    assert peak(answers("area_growth", retreat)[5:]) == 0
    # All areas that appear grow alike: a rounding error would rank approaches and controls.
    areas = [[np.where(np.arange(25) < size, 255, 0).astype(np.uint8).reshape(5, 5)]
             for size in range(1, 25)]  # fmt: skip
    still = [np.zeros((5, 5), np.uint8)] * 4
    assert {peak(answers("area_growth", still + area)) for area in areas} == {1 / 3}


def test_ttc_gradient_tells_the_time_to_contact_and_the_place() -> None:
    y, x = np.mgrid[:90, :120].astype(float)

    def surface(scale: float) -> NDArray[np.uint8]:
        v, u = (y - 45) * scale, (x - 60) * scale
        return np.asarray(np.round(127 + 60 * np.sin(u / 5) * np.cos(v / 6)), np.uint8)

    left = [40.0 - t for t in range(8)]  # frames to contact
    found = answers("ttc_gradient", [surface(each / 40) for each in left])
    assert 1 / found[-1].c == pytest.approx(left[-1] + 0.5, rel=0.05)
    assert found[-1].r2 > 0.9
    assert found[-1].response == pytest.approx(found[-1].best_c * found[-1].best_r2)
    box = found[-1].box  # derivative i lies on the border of pixels i and i + 1
    assert (box.x + box.width / 2 - 1, box.y + box.height / 2 - 1) == (
        found[-1].best_x, found[-1].best_y,
    )  # fmt: skip
    moving = [np.roll(surface(1), 2 * t, axis=1)[:, 16:-16] for t in range(4)]
    assert abs(answers("ttc_gradient", moving)[-1].c) < 0.1 * found[-1].c
    retreat = answers("ttc_gradient", [surface(each / 40) for each in left[::-1]])
    assert retreat[-1].c < 0
    assert retreat[-1].response < 0.2 * found[-1].response
    assert min(each.response for each in retreat if each) >= 0


def test_ttc_gradient_answers_with_the_smallest_window() -> None:
    kind = detector_named("ttc_gradient")
    model = kind((40, 40), kind.parameters(window=0.02))  # type: ignore[call-arg]
    frames = np.random.default_rng(4).random((2, 40, 40), dtype=np.float32)
    first, second = (model.step(frame) for frame in frames)
    assert first is None
    assert second is not None
    assert second.box is not None
    assert (second.response > 0, second.box.width) == (True, 3)


def test_ttc_gradient_says_its_least_size() -> None:
    with pytest.raises(ParameterError, match="needs frames of at least 9 x 9 px, not 20 x 8"):
        detector_named("ttc_gradient")((8, 20))
    assert detector_named("ttc_gradient")((100, 12)).step(np.zeros((100, 12), np.float32)) is None
