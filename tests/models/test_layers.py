from __future__ import annotations

import numpy as np
import pytest

from oppload_cli.errors import FrameError
from oppload_cli.models import convolution
from oppload_cli.models.grouping import grouping_of
from oppload_cli.models.layers import Dpc
from oppload_cli.models.parameters import DlgmdParams, DpcParams
from oppload_cli.models.pooling import Pooling
from oppload_cli.native.library import LANES
from tests import reference
from tests.media import edge

SHAPES = [(40, 61), (13, 13), (5, 90), (1, 1), (7, 4)]


def random_frames(shape: tuple[int, int], count: int = 5) -> list[np.ndarray]:
    rng = np.random.default_rng(7)
    return [rng.random(shape, dtype=np.float32) for _ in range(count)]


def stepped(frames: list[np.ndarray], axes: tuple[int, ...] = (45, 135)) -> Dpc:
    dpc = Dpc(frames[0].shape, DpcParams(), axes)
    for frame in frames:
        dpc.step(frame)
    return dpc


@pytest.mark.parametrize("shape", SHAPES)
def test_layers_agree_with_the_literal_reference(shape: tuple[int, int]) -> None:
    frames = random_frames(shape)
    dpc, p = stepped(frames, (45, 135)), reference.photoreceptors(frames)
    np.testing.assert_allclose(dpc.photoreceptors, p[-1], atol=1e-6)
    np.testing.assert_allclose(dpc.layers.excitation, reference.excitation(p), atol=1e-6)
    np.testing.assert_allclose(dpc.layers.inhibition, reference.inhibition(p), atol=1e-5)
    for phi in (45, 135, 225, 315):
        np.testing.assert_allclose(
            dpc.inhibition_of(phi), reference.directional_inhibition(p, phi), atol=1e-5
        )


@pytest.mark.parametrize("shape", [(40, 61), (41, 20), (9, 62), (19, 21)])
def test_frames_of_several_tiles_agree_too(
    shape: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(convolution, "LARGEST_TILE", (30, 32))  # 18 x 20 without their padding
    test_layers_agree_with_the_literal_reference(shape)
    dpc = stepped(random_frames(shape))
    dpc.reset()
    for frame in random_frames(shape)[1:]:
        dpc.step(frame)
    p = reference.photoreceptors(random_frames(shape)[1:])
    np.testing.assert_allclose(dpc.layers.inhibition, reference.inhibition(p), atol=1e-5)


@pytest.mark.parametrize("phi", [0, 90])
def test_the_other_axes_agree_too(phi: int) -> None:
    frames = random_frames((33, 20))
    dpc, p = stepped(frames, (0, 90)), reference.photoreceptors(frames)
    np.testing.assert_allclose(
        dpc.inhibition_of(phi), reference.directional_inhibition(p, phi), atol=1e-5
    )


def test_opposite_pathways_share_the_whole_inhibition() -> None:
    dpc = stepped(random_frames((30, 31)))
    both = dpc.inhibition_of(45) + dpc.inhibition_of(225)
    np.testing.assert_allclose(both, dpc.layers.inhibition, rtol=1e-6, atol=1e-7)


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
    dpc = stepped(list(edge(speed, 10)), (0, 90))
    maps = (dpc.presynaptic, dpc.pathways[0], dpc.pathways[180])
    measured = [float(each[20].sum()) for each in maps]
    assert measured == pytest.approx(EDGE[speed], abs=0.01)


def test_warm_up_is_three_frames() -> None:
    dpc = Dpc((9, 9), DpcParams())
    assert [dpc.step(frame) for frame in random_frames((9, 9))] == [False, False, False, True, True]


def test_nothing_answers_where_nothing_changed() -> None:
    """Far from a change that is over, I is 0 but for its last digits, of either sign."""
    frames = [np.zeros((60, 60), np.float32) for _ in range(5)]
    for t, frame in enumerate(frames[:3]):
        frame[:9, :9] = 0.3 * t
    frames[3:] = frames[2], frames[2]
    dpc = stepped(frames[:4])
    for values in (dpc.presynaptic, *dpc.pathways.values()):
        values[:] = 1
    if dpc.live is not None:
        dpc.live[:] = 1
    dpc.step(frames[4])
    assert dpc.layers.inhibition.max() > 0
    for values in (dpc.presynaptic, *dpc.pathways.values()):
        assert not values.any()


@pytest.mark.parametrize("levels", [219, 876])
def test_nothing_answers_beside_what_changed(levels: int) -> None:
    """Half of I less its odd part may be below 0 in its last digit, where E is 0."""
    codes = np.random.default_rng(4).integers(0, levels + 1, (5, 30, 70))
    codes[:4] //= 100  # little inhibits what comes last
    codes[2:, :, 20:50] = codes[2, :, 20:50]
    dpc = Dpc((30, 70), DpcParams(kernel_radius=20, sigma_inhibition=12.0), (0, 90))
    for frame in (codes / levels).astype(np.float32):
        dpc.step(frame)
    still = np.s_[:, 22:48]
    for values in (dpc.presynaptic, *dpc.pathways.values()):
        assert not values[still].any()
        assert values.max() > 0.1


def test_reset_starts_over() -> None:
    frames = random_frames((20, 30))
    dpc = stepped(random_frames((20, 30))[::-1])
    dpc.reset()
    again = [dpc.step(frame) for frame in frames]
    assert again == [False, False, False, True, True]
    np.testing.assert_array_equal(dpc.layers.inhibition, stepped(frames).layers.inhibition)


@pytest.mark.parametrize(
    "frame",
    [
        np.zeros((8, 9), np.float32),
        np.zeros((9, 9), np.float64),
        np.zeros((9, 9, 3), np.float32),
    ],
)
def test_a_wrong_array_is_refused(frame: np.ndarray) -> None:
    with pytest.raises(FrameError, match="float32 array of shape"):
        Dpc((9, 9), DpcParams()).step(frame)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_luminance_that_is_not_finite_is_refused(value: float) -> None:
    dpc = Dpc((9, 9), DpcParams())
    dpc.step(np.zeros((9, 9), np.float32))
    with pytest.raises(FrameError, match="not finite"):
        dpc.step(np.full((9, 9), value, np.float32))


@pytest.mark.parametrize("levels", [219, 876])
def test_what_is_not_live_is_zero(levels: int) -> None:
    """In whole numbers and in floats; what was live may be at rest in the next frame."""
    shape = (50, 90)
    codes = np.random.default_rng(levels).integers(0, levels + 1, shape)
    dpc = Dpc(shape, DpcParams(), (45, 135))
    shares = []
    for t in range(12):
        frame = np.roll(codes, 3 * t, axis=1)  # texture that drifts: all is inhibited
        frame[10 : 20 + t, 5 * t : 5 * t + 30] = levels * (t % 3) // 2  # and what flickers
        dpc.step((frame / levels).astype(np.float32))
        if dpc.live is None:
            continue
        some = np.repeat(dpc.live, LANES, axis=1)[:, : shape[1]] > 0
        for values in (dpc.presynaptic, *dpc.pathways.values()):
            assert not values[~some].any()
        shares.append(some.mean())
    assert not shares or 0 < min(shares[3:]) < max(shares[3:]) < 0.9


def test_maps_are_passed_over_where_they_are_not_live() -> None:
    """Pooling and grouping give the same bits as without knowing."""
    rng = np.random.default_rng(6)
    shape = (61, 90)
    dpc = Dpc(shape, DpcParams(), (45, 135))
    if dpc.live is None:
        return
    dpc.live[:] = rng.random(dpc.live.shape) < 0.3
    dpc.live[20:40] = 0
    some = np.repeat(dpc.live, LANES, axis=1)[:, : shape[1]]
    dpc.presynaptic[:] = rng.random(shape) * some
    pooling = Pooling(shape, 8, 12.0)
    pooled = [np.zeros(pooling.shape, np.float32) for _ in "ab"]
    grouped = []
    for live, out in zip((dpc.live, None), pooled, strict=True):
        pooling(dpc.presynaptic, out, live)
        if live is None:
            dpc.live[:] = 1
        grouping = grouping_of(dpc, DlgmdParams())
        grouped.append((grouping(0.1), grouping.grouped.copy()))
    np.testing.assert_array_equal(pooled[0], pooled[1])
    assert grouped[0][0] == grouped[1][0]
    np.testing.assert_array_equal(grouped[0][1], grouped[1][1])
    assert pooled[0].max() > 0.1
    assert grouped[0][0][1] > 0
