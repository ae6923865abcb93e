"""Photoreceptors, DPC and MDE against the literal reference and the table of docs/model.md."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from oppload_cli.errors import FrameError
from oppload_cli.models.dpc import (
    DpcParams,
    PresynapticSums,
    directional_inhibition,
    excitation,
    inhibition,
    presynaptic_sums,
    rectified,
)
from oppload_cli.models.layers import Dpc, Layers, Photoreceptors
from tests import reference
from tests.media import edge

if TYPE_CHECKING:
    from tests.media import Luma

SHAPES = [(40, 61), (13, 13), (5, 90), (1, 1), (7, 4)]


def random_frames(shape: tuple[int, int], count: int = 5) -> list[Luma]:
    rng = np.random.default_rng(7)
    return [rng.random(shape, dtype=np.float32) for _ in range(count)]


def stepped(frames: list[Luma], axes: tuple[int, ...] = (45, 135)) -> Dpc:
    height, width = frames[0].shape
    dpc = Layers((height, width)).dpc(DpcParams(), axes).layer
    for frame in frames:
        dpc.step(frame)
    return dpc


def all_of(sums: PresynapticSums) -> list[Luma]:
    return [sums.presynaptic, *sums.pathways.values()]


# ---- The equations -------------------------------------------------------------------------


@pytest.mark.parametrize("axes", [(45, 135), (0, 90)])
@pytest.mark.parametrize("shape", SHAPES)
def test_each_equation_agrees_with_the_literal_reference(
    shape: tuple[int, int], axes: tuple[int, int]
) -> None:
    frames = random_frames(shape)
    dpc, expected = stepped(frames, axes), reference.photoreceptors(frames)
    p, kernels = dpc.photoreceptors.maps, dpc.kernels
    np.testing.assert_allclose(p, expected[:-4:-1], atol=1e-6)
    assert dpc.photoreceptors.means == pytest.approx([each.mean() for each in expected[:-4:-1]])
    e, i = excitation(p, kernels), inhibition(p, kernels)
    np.testing.assert_allclose(e, reference.excitation(expected), atol=1e-6)
    np.testing.assert_allclose(i, reference.inhibition(expected), atol=1e-5)
    for phi in axes:
        i_phi = directional_inhibition(p, kernels, phi)
        literal = [reference.directional_inhibition(expected, phi + turn) for turn in (0, 180)]
        np.testing.assert_allclose([i_phi, i - i_phi], literal, atol=1e-5)


@pytest.mark.parametrize("axes", [(45, 135), (0, 90), ()])
@pytest.mark.parametrize("shape", SHAPES)
def test_the_presynaptic_sums_agree_with_the_literal_reference(
    shape: tuple[int, int], axes: tuple[int, ...]
) -> None:
    contrasts = (0.02, 0.02, 0.02, 0.02, 1)  # so that some excitation is not inhibited
    frames = [f * np.float32(k) for f, k in zip(random_frames(shape), contrasts, strict=True)]
    sums, p = stepped(frames, axes).sums, reference.photoreceptors(frames)
    np.testing.assert_allclose(sums.presynaptic, reference.presynaptic(p), atol=1e-5)
    assert sums.presynaptic.max() > 0.1 or shape == (1, 1)
    assert set(sums.pathways) == {phi + turn for phi in axes for turn in (0, 180)}
    for phi, values in sums.pathways.items():
        np.testing.assert_allclose(values, reference.pathway(p, phi), atol=1e-5)


def test_s_is_at_least_0_and_at_most_e() -> None:
    e, i = np.array([[0.5, 0.5, 0.0, 0.0]], np.float32), np.array([[0.2, 0.9, 0.1, -1e-9]])
    np.testing.assert_allclose(rectified(e, i.astype(np.float32)), [[0.3, 0, 0, 0]], atol=1e-7)


# docs/model.md, sections 3 and 4: S per pixel of edge length.
EDGE = {
    1: (0, 0.21, 0),
    2: (0, 0.68, 0),
    3: (0, 1.20, 0),
    4: (0.11, 1.73, 0.11),
    6: (1.17, 2.79, 1.17),
    10: (3.28, 4.90, 3.28),
    15: (5.93, 7.55, 5.93),
}


@pytest.mark.parametrize("speed", EDGE)
def test_straight_edge_table(speed: int) -> None:
    sums = stepped(list(edge(speed, 10)), (0, 90)).sums
    maps = (sums.presynaptic, sums.pathways[0], sums.pathways[180])
    measured = [float(each[20].sum()) for each in maps]
    assert measured == pytest.approx(EDGE[speed], abs=0.01)


def test_s_is_exactly_0_where_nothing_changed() -> None:
    """Far from an earlier change, I is 0 up to rounding errors of either sign."""
    frames = [np.zeros((60, 60), np.float32) for _ in range(5)]
    for t, frame in enumerate(frames[:3]):
        frame[:9, :9] = 0.3 * t
    frames[3:] = frames[2], frames[2]
    dpc = stepped(frames)
    p = dpc.photoreceptors.maps
    assert inhibition(p, dpc.kernels).max() > 0
    fresh = PresynapticSums.zeros((60, 60), (45, 135))
    for values in all_of(fresh):
        values[:] = 1
    presynaptic_sums(p, dpc.kernels, fresh)
    assert not any(values.any() for values in (*all_of(dpc.sums), *all_of(fresh)))


@pytest.mark.parametrize("levels", [219, 876])
def test_s_is_exactly_0_beside_a_change(levels: int) -> None:
    """Where E is 0, rounding errors can make I_phi a little less than 0."""
    codes = np.random.default_rng(4).integers(0, levels + 1, (5, 30, 70))
    codes[:4] //= 100  # so that inhibition is weak in the last frame
    codes[2:, :, 20:50] = codes[2, :, 20:50]
    dpc = Layers((30, 70)).dpc(DpcParams(kernel_radius=20, sigma_inhibition=12.0), (0, 90)).layer
    for each in codes:
        dpc.step((each / levels).astype(np.float32))
    for values in all_of(dpc.sums):
        assert not values[:, 22:48].any()
        assert values.max() > 0.1


def test_s_returns_to_0_where_the_motion_has_passed() -> None:
    """No S of the frame before remains, with a texture that drifts and an object that moves."""
    shape = (50, 90)
    codes = np.random.default_rng(1).integers(0, 220, shape)
    frames: list[Luma] = []
    for t in range(10):
        shifted = np.roll(codes, 3 * t, axis=1)
        shifted[10 : 20 + t, 5 * t : 5 * t + 30] = 219 * (t % 3) // 2
        frames.append((shifted / 219).astype(np.float32))
    dpc = Layers(shape).dpc(DpcParams(), (45, 135)).layer
    for t, frame in enumerate(frames):
        if dpc.step(frame):
            p = reference.photoreceptors(frames[: t + 1])
            np.testing.assert_allclose(dpc.sums.presynaptic, reference.presynaptic(p), atol=1e-5)
            for phi, values in dpc.sums.pathways.items():
                np.testing.assert_allclose(values, reference.pathway(p, phi), atol=1e-5)


# ---- The layers over one video -------------------------------------------------------------


def test_warm_up_is_three_frames() -> None:
    dpc = Layers((9, 9)).dpc(DpcParams()).layer
    assert [dpc.step(frame) for frame in random_frames((9, 9))] == [False, False, False, True, True]


def test_reset_starts_over() -> None:
    frames = random_frames((20, 30))
    dpc = stepped(frames[::-1])
    dpc.reset()
    again = [dpc.step(frame) for frame in frames]
    assert again == [False, False, False, True, True]
    np.testing.assert_array_equal(all_of(dpc.sums), all_of(stepped(frames).sums))


def test_luma_change_is_the_mean_of_p_from_the_second_frame_on() -> None:
    frames = random_frames((9, 12))
    layer = Photoreceptors((9, 12))
    assert layer.luma_change is None
    layer.step(frames[0])
    assert layer.luma_change is None
    layer.step(frames[1])
    assert layer.luma_change == pytest.approx(float(np.abs(frames[1] - frames[0]).mean()))


def test_the_frame_given_may_be_overwritten() -> None:
    frames = random_frames((9, 12))
    shown, layer = frames[0].copy(), Photoreceptors((9, 12))
    layer.step(shown)
    shown[:] = frames[1]
    layer.step(shown)
    np.testing.assert_array_equal(layer.maps[0], np.abs(frames[1] - frames[0]))


def test_a_refused_frame_changes_nothing() -> None:
    shape = (20, 30)
    one, other = (Layers(shape).dpc(DpcParams(), (45, 135)) for _ in "ab")
    for frame in random_frames(shape, 9):
        with pytest.raises(FrameError, match="float32 array of shape"):
            one.step(frame[1:])
        with pytest.raises(FrameError, match="not finite"):
            one.step(np.full(shape, np.nan, np.float32))
        assert one.step(frame) == other.step(frame)
        np.testing.assert_array_equal(all_of(one.layer.sums), all_of(other.layer.sums))


@pytest.mark.parametrize(
    "frame",
    [np.zeros((8, 9), np.float32), np.zeros((9, 9), np.float64), np.zeros((9, 9, 3), np.float32)],
)
def test_a_wrong_array_is_refused(frame: Luma) -> None:
    with pytest.raises(FrameError, match="float32 array of shape"):
        Layers((9, 9)).dpc(DpcParams()).layer.step(frame)


def test_luminance_of_8_bits_is_refused() -> None:
    """Every response would be 255 times too large, and the first frame would cause an alarm."""
    dpc = Layers((9, 9)).dpc(DpcParams()).layer
    for black in range(3):
        with pytest.raises(FrameError, match="L must be 0 to 1: divide 8-bit values by 255"):
            dpc.step(np.full((9, 9), 200, np.float32))
        assert dpc.frames == black
        dpc.step(np.zeros((9, 9), np.float32))
    dpc.step(np.full((9, 9), 200, np.float32))  # after three frames it is no error of the unit


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_luminance_that_is_not_finite_is_refused(value: float) -> None:
    dpc = Layers((9, 9)).dpc(DpcParams()).layer
    dpc.step(np.zeros((9, 9), np.float32))
    with pytest.raises(FrameError, match="not finite"):
        dpc.step(np.full((9, 9), value, np.float32))
