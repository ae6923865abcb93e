"""Models of LPLC2 neurons against literal versions, and their known responses."""

from __future__ import annotations

from importlib.resources import files
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from oppload_cli.errors import OpploadError, ParameterError
from oppload_cli.models import published
from oppload_cli.models.bank import DetectorBank
from oppload_cli.models.published import emd_lplc2_gf, mlplc2, zhou_lrf
from oppload_cli.models.registry import detector_named
from tests.media import grey_frames
from tests.models import lplc2_reference as literal

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from numpy.typing import NDArray

    Frames = list[NDArray[np.uint8]]

NAMES = "emd_lplc2_gf", "zhou_lrf", "mlplc2", "hua_fixed", "hua_literal"
SHAPE = 150, 200


@pytest.fixture(autouse=True, scope="module")
def each_arithmetic() -> None:
    """Run these tests once: no compiled loops are used."""


def textured(frames: int, shape: tuple[int, int]) -> Frames:
    """A soft disk that grows and drifts over moving texture."""
    rng = np.random.default_rng(9)
    height, width = shape
    blocks = rng.random((height // 4 + 1, width // 4 + 1))
    ground = 90 + 80 * np.kron(blocks, np.ones((4, 4)))[:height, :width]
    y, x = np.mgrid[:height, :width]
    shown = []
    for t in range(frames):
        frame = np.roll(ground, t // 2, axis=1)
        distance = np.hypot(y - height * 0.45 - 0.3 * t, x - width * 0.55)
        frame = np.where(distance < 3 + 2.2 * t, 20.0, frame)
        shown.append(np.round(frame + rng.normal(0, 3, shape)).clip(0, 255).astype(np.uint8))
    return shown


def scene(kind: str, frames: int = 30) -> Frames:
    """Clean stimuli of 200 x 150 px, dark on light."""
    rng = np.random.default_rng(2)
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(float)
    y, x = y - SHAPE[0] / 2, x - SHAPE[1] / 2
    tiles = np.kron(rng.random((40, 80)), np.ones((5, 5)))

    def inside(distance: Any) -> Any:
        return np.clip(0.5 - distance, 0, 1)  # antialiased

    def frame(t: int) -> Any:
        if kind in {"looming", "receding"}:
            step = t if kind == "looming" else frames - 1 - t
            return 1 - inside(np.hypot(y, x) - (3 + 100 / (frames + 1 - step)))
        if kind == "translation":
            return 1 - inside(np.hypot(y, x + 70 - 5 * t) - 20)
        if kind == "grating":
            return 0.5 + 0.5 * np.sin(2 * np.pi * (x - 4 * t) / 40)
        if kind == "pan":
            return tiles[: SHAPE[0], 3 * t : 3 * t + SHAPE[1]]
        if kind == "noise":
            return 0.5 + rng.normal(0, 0.05, SHAPE)
        return np.full(SHAPE, 1 - t / frames)  # dimming

    return [np.round(255 * np.clip(frame(t), 0, 1)).astype(np.uint8) for t in range(frames)]


def answers(name: str, frames: Frames, **params: Any) -> list[Any]:
    kind = detector_named(name)
    model = kind(frames[0].shape, kind.parameters(**params), frame_rate=30)
    light = [np.asarray(each, np.float32) / np.float32(255) for each in frames]
    return [model.step(each) for each in light]


def assert_equal(
    found: list[Any], expected: Iterator[dict[str, Any]], rel: float, still: tuple[str, ...] = ()
) -> None:
    rows = list(expected)
    found = found[-len(rows) :]
    for name in rows[0]:
        values = np.array([float(row[name]) for row in rows])
        got = np.array([float(getattr(each, name)) for each in found])
        assert got == pytest.approx(values, rel=rel, abs=1e-6 * np.abs(values).max()), name
        assert np.ptp(values) > 0 or name in still, f"{name} is the same in every frame"


@pytest.mark.long
def test_emd_lplc2_gf_is_the_literal_version() -> None:
    frames = scene("looming")[25:]
    assert_equal(answers("emd_lplc2_gf", frames), literal.emd_lplc2_gf(frames), 1e-9)
    frames = textured(5, SHAPE)
    found = answers("emd_lplc2_gf", frames, full_scale=255)
    assert_equal(found, literal.emd_lplc2_gf(frames, 255), 1e-9, ("collision", "spikes"))


@pytest.mark.parametrize(
    ("element", "part"), [(2, (60, 87, 85, 116)), (4, (45, 105, 64, 136)), (8, (20, 133, 43, 156))]
)
def test_zhou_lrf_is_the_literal_version(element: int, part: tuple[int, int, int, int]) -> None:
    top, bottom, left, right = part  # also sides that are no multiple of the element
    weights = np.loadtxt(str(files(published) / "zhou_lrf.csv"), delimiter=",")
    frames = [each[top:bottom, left:right] for each in scene("looming")[21:]]
    found = answers("zhou_lrf", frames, element=element)
    assert_equal(found, literal.zhou_lrf(frames, weights, element), 1e-9)


@pytest.mark.parametrize("variant", ["fixed", "literal"])
def test_hua_is_the_literal_version(variant: str) -> None:
    frames = textured(12, (40, 51))
    found = answers(f"hua_{variant}", frames)
    assert found[:2] == [None, None]
    assert_equal(found, literal.hua(frames, literal=variant == "literal"), 3e-4)
    for each in found[2:]:
        assert each.response == pytest.approx(each.product**0.25)


def test_hua_counts_the_delay_in_milliseconds() -> None:
    """Half the delay at twice the rate is the same for frames."""
    kind = detector_named("hua_fixed")
    models = (
        kind((40, 51), kind.parameters(low_pass_ms=30.0 * 30 / rate), frame_rate=rate)  # type: ignore[call-arg]
        for rate in (30, 60)
    )
    frames = [np.asarray(each, np.float32) / np.float32(255) for each in textured(5, (40, 51))]
    one, other = ([model.step(each) for each in frames] for model in models)
    assert one == other


@pytest.mark.long
def test_mlplc2_is_the_literal_version() -> None:
    frames = textured(16, (60, 200))
    assert_equal(answers("mlplc2", frames), literal.mlplc2(frames), 1e-9)


def test_a_reset_forgets_everything() -> None:
    frames = [np.asarray(each, np.float32) / np.float32(255) for each in textured(8, (64, 80))]
    for name in NAMES:
        model = detector_named(name)((64, 80), frame_rate=30)
        first = [model.step(each) for each in frames]
        model.reset()
        assert [model.step(each) for each in frames] == first, name


@pytest.mark.long
def test_emd_lplc2_gf_answers_to_looming_only() -> None:
    found = answers("emd_lplc2_gf", scene("looming"))
    assert max(each.active for each in found[1:]) > 50
    assert found[-1].collision == 1
    for kind in ("receding", "translation", "grating", "pan", "noise", "dimming"):
        assert {each.active for each in answers("emd_lplc2_gf", scene(kind))[1:]} == {0}, kind


def test_units_of_emd_lplc2_gf_are_never_minus_zero() -> None:
    found = answers("emd_lplc2_gf", grey_frames(4))[1:]
    values = np.array([(each.lplc2_sum, each.lplc2_max, each.lplc2_centre) for each in found])
    assert not np.signbit(values).any()  # a table would show "-0"


def test_emd_lplc2_gf_reduces_taller_frames() -> None:
    small = scene("looming")
    large = [np.kron(each, np.ones((2, 2), np.uint8)) for each in small]
    one, other = answers("emd_lplc2_gf", small)[-1], answers("emd_lplc2_gf", large)[-1]
    assert (one.active, one.lplc2_max) == (other.active, pytest.approx(other.lplc2_max))
    assert other.box == pytest.approx([2 * side for side in one.box])
    assert one.box.centre == (one.max_x + 1, one.max_y + 1)  # motion is between two pixels


def test_the_input_of_the_giant_fibre_counts_a_share_of_all_units() -> None:
    """The authors' 2500 active units of 200 x 150 are an input of 1 (docs/detectors.md)."""
    shown = [each[15:135, 20:180] for each in scene("looming")]
    found = answers("emd_lplc2_gf", [*shown, *shown[::-1]])[1:]
    drives = [each.active / 2500 * 30_000 / (160 * 120) for each in found]
    assert sum(drive > 0 for drive in drives) > 3
    for (before, drive), each in zip(pairwise(drives), found[1:], strict=True):
        expected = 250 * drive * (drive - before) / 0.01 / 57.6 if before else 0
        assert each.current == pytest.approx(expected, rel=1e-9)
        assert each.response == max(0, each.current)
    assert min(each.current for each in found) < 0


def test_the_voltage_of_the_giant_fibre_stays_at_its_least_value() -> None:
    """As in the authors' code: a current no longer changes it."""
    assert emd_lplc2_gf._membrane(-90.0, 0.0) == (-80.0, 0)
    assert emd_lplc2_gf._membrane(-80.0, 500.0) == (-80.0, 0)


@pytest.mark.parametrize("name", ["emd_lplc2_gf", "zhou_lrf"])
def test_a_camera_that_is_turned_gives_the_same(name: str) -> None:
    frames = scene("looming")[24:]
    wide, upright = (
        [each.response for each in answers(name, shown)[1:]]
        for shown in (frames, [np.ascontiguousarray(each.T) for each in frames])
    )
    assert max(wide) > 0
    assert upright == pytest.approx(wide, rel=1e-9)


def test_zhou_lrf_tells_looming_from_receding() -> None:
    looming, receding = (
        sum(each.r_sum for each in answers("zhou_lrf", scene(kind))[1:])
        for kind in ("looming", "receding")
    )
    assert 0 <= receding < 0.15 * looming


def test_zhou_lrf_answers_less_at_low_contrast() -> None:
    full = scene("looming")
    faint = [np.round(255 - (255.0 - each) * 0.5).astype(np.uint8) for each in full]
    strong, weak = (max(e.r_max for e in answers("zhou_lrf", f)[1:]) for f in (full, faint))
    assert weak < strong / 3


def test_hua_fixed_answers_less_to_receding() -> None:
    looming, receding = (
        max(each.product for each in answers("hua_fixed", scene(kind))[2:])
        for kind in ("looming", "receding")
    )
    assert 0 < receding < 0.2 * looming


@pytest.mark.long
def test_mlplc2_answers_to_drifting_texture_more_than_to_looming() -> None:
    looming, pan = (
        max(each.best_out for each in answers("mlplc2", scene(kind))[1:])
        for kind in ("looming", "pan")
    )
    assert pan > 2 * looming > 0


def test_missing_and_damaged_weights_are_named(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(zhou_lrf, "files", lambda _: tmp_path)
    with pytest.raises(OpploadError, match="weights of zhou_lrf"):
        zhou_lrf.ZhouLrf((150, 200))
    (tmp_path / "zhou_lrf.csv").write_text("1,2\n3,4\n")
    with pytest.raises(OpploadError, match=r"cannot be read \(cannot reshape .* size 4"):
        zhou_lrf.ZhouLrf((150, 200))


@pytest.mark.parametrize(("name", "shape"), [("zhou_lrf", (20, 200)), ("mlplc2", (12, 30))])
def test_frames_too_small_for_the_fields_are_refused(name: str, shape: tuple[int, int]) -> None:
    with pytest.raises(ParameterError, match="needs frames of at least"):
        detector_named(name)(shape)


def test_an_odd_element_is_refused() -> None:
    with pytest.raises(ParameterError, match="must be even"):
        zhou_lrf.ZhouLrfParams(element=5)


def test_the_middle_of_a_field_of_attention_is_right_below() -> None:
    """The field reaches 75 px to the left and up, and 74 px to the right and down."""
    field = mlplc2._Attention(1, 100, 100)
    places = np.array([[100, 100, 25, 174, 175, 100], [100, 25, 100, 100, 100, 175]])
    right_down = np.array([[3.0, -1, 0, 0, 9, 9], [2.0, 0, -4, 8, 9, 9]])
    field.take(places[0], places[1], right_down)
    assert field.quadrants == (0, 4, 1, 5 + 8)  # upper right, upper left, lower left, lower right


def test_a_threshold_that_no_signal_reaches_gives_no_motion() -> None:
    found = answers("mlplc2", scene("looming")[24:], compression_threshold=1)
    assert {each.max_mag for each in found[1:]} == {0}


def test_both_variants_of_hua_share_their_motion() -> None:
    frames = [np.asarray(each, np.float32) / np.float32(255) for each in textured(8, (60, 80))]
    kinds = [detector_named(name) for name in ("hua_fixed", "hua_literal")]
    bank = DetectorBank((60, 80), [kind.parameters() for kind in kinds], frame_rate=30)
    together = [bank.step(each) for each in frames]
    for kind in kinds:
        alone = kind((60, 80), frame_rate=30)
        assert [alone.step(each) for each in frames] == [each[kind.name] for each in together]
    fixed, literal_one = (bank.detectors[kind.name] for kind in kinds)
    assert fixed._motion.layer is literal_one._motion.layer  # type: ignore[attr-defined]
    assert together[-1]["hua_fixed"] != together[-1]["hua_literal"]
