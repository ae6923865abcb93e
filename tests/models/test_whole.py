"""S of frames of 8 bits, which the compiled loops compute in whole numbers."""

from __future__ import annotations

import numpy as np
import pytest

from oppload_cli.errors import FrameError
from oppload_cli.models.direct import DirectSums
from oppload_cli.models.layers import Dpc
from oppload_cli.models.parameters import DpcParams
from oppload_cli.models.whole import LEVELS
from tests import reference


def frames_of(levels: int, shape: tuple[int, int], count: int = 5) -> list[np.ndarray]:
    """Noise in whole levels; part of it stands still."""
    codes = np.random.default_rng(levels).integers(0, levels + 1, (count, *shape))
    codes[:, shape[0] // 2 :, : shape[1] // 2] = codes[0, 0, 0]
    return [(each / levels).astype(np.float32) for each in codes]


def sums_of(dpc: Dpc) -> dict[int | None, np.ndarray]:
    return {None: dpc.presynaptic.copy(), **{phi: s.copy() for phi, s in dpc.pathways.items()}}


def expected(frames: list[np.ndarray], axes: tuple[int, ...]) -> dict[int | None, np.ndarray]:
    p = reference.photoreceptors(frames)
    excitation = reference.excitation(p)
    inhibition: dict[int | None, np.ndarray] = {None: reference.inhibition(p)}
    for phi in (*axes, *(each + 180 for each in axes)):
        inhibition[phi] = reference.directional_inhibition(p, phi)
    return {phi: np.maximum(0, excitation - each) for phi, each in inhibition.items()}


def check(dpc: Dpc, frames: list[np.ndarray], atol: float = 1e-5) -> None:
    """Hold the latest S to the literal reference."""
    found, wanted = sums_of(dpc), expected(frames, dpc.axes)
    assert found.keys() == wanted.keys()
    for phi, each in found.items():
        np.testing.assert_allclose(each, wanted[phi], atol=atol)


def counts_whole(dpc: Dpc) -> bool | None:
    """Whether the latest sums were in whole numbers; None where they never are."""
    whole = dpc._sums._whole if isinstance(dpc._sums, DirectSums) else None
    return whole.ready if whole else None


@pytest.mark.parametrize("levels", LEVELS)
@pytest.mark.parametrize("axes", [(45, 135), (0, 90), ()])
@pytest.mark.parametrize("shape", [(40, 61), (130, 50), (5, 90), (1, 1), (7, 4)])
def test_whole_levels_agree_with_the_literal_reference(
    levels: int, axes: tuple[int, ...], shape: tuple[int, int]
) -> None:
    dpc = Dpc(shape, DpcParams(), axes)
    frames = frames_of(levels, shape)
    for frame in frames:
        dpc.step(frame)
    assert counts_whole(dpc) in (True, None)
    check(dpc, frames)
    assert not dpc.presynaptic[shape[0] // 2 + 2 :, : max(0, shape[1] // 2 - 2)].any()


def frames_with(changes: list[np.ndarray]) -> list[np.ndarray]:
    """Frames whose P is these, in levels of limited range, up and down by turns."""
    codes = [np.full(changes[0].shape, 100)]
    for t, change in enumerate(changes):
        codes.append(codes[-1] + (-1) ** t * change)
    return [(each / 219).astype(np.float32) for each in codes]


@pytest.mark.parametrize("axes", [(45, 135), (0, 90), ()])
@pytest.mark.parametrize("empty", ["left", "right", "above", "below", "nothing"])
def test_where_excitation_and_inhibition_are_about_equal(axes: tuple[int, ...], empty: str) -> None:
    """E grows from the left to the right, and what inhibits lacks on one side of each block."""
    shape = (70, 173)
    rng = np.random.default_rng(5)
    rows, columns = np.indices(shape)
    sides = {"left": -columns, "right": columns, "above": -rows, "below": rows}
    inhibits = sides[empty] % 14 < 9 if empty in sides else np.ones(shape, bool)
    latest = rng.integers(0, 4, shape) + rng.integers(0, 2, shape) * columns // 2
    before = rng.integers(5, 10, shape) * inhibits
    frames = frames_with([np.zeros(shape, int), np.zeros(shape, int), before, latest])
    dpc = Dpc(shape, DpcParams(), axes)
    for frame in frames:
        dpc.step(frame)
    check(dpc, frames)
    live = [each > 0 for each in sums_of(dpc).values()]
    assert all(0.01 < each.mean() < 0.9 for each in live)


def test_most_of_what_is_inhibited_is_passed_over() -> None:
    shape = (60, 320)
    texture = np.random.default_rng(6).integers(80, 120, shape)
    frames = [(np.roll(texture, 3 * t, axis=1) / 219).astype(np.float32) for t in range(5)]
    dpc = Dpc(shape, DpcParams(), (45, 135))
    for frame in frames:
        dpc.step(frame)
    check(dpc, frames)
    whole = dpc._sums._whole if isinstance(dpc._sums, DirectSums) else None
    if whole:
        possible = whole._screening[0][: shape[0] * shape[1] // 16]
        assert possible.mean() < 0.3


@pytest.mark.parametrize(
    "constants",
    [
        {"kernel_radius": 9, "sigma_inhibition": 8.0},
        {"kernel_radius": 30, "inhibition_strength": 90.0, "latency_lambda": 0.2},
        {"latency_one": -10.0, "latency_two": 100.0},  # nothing excites
        {"inhibition_strength": 0.0},
    ],
)
def test_other_kernels_neither_overflow_nor_fail(constants: dict[str, float]) -> None:
    params = DpcParams(**constants)  # type: ignore[arg-type]
    shape = (70, 75)
    checks = np.indices(shape).sum(axis=0) % 2
    frames = [np.full(shape, t % 2, np.float32) for t in range(5)]
    frames[-1] = checks.astype(np.float32)
    whole, fractions = Dpc(shape, params, (45, 135)), Dpc(shape, params, (45, 135))
    if isinstance(fractions._sums, DirectSums):
        fractions._sums._whole = None
    for frame in frames:
        whole.step(frame)
        fractions.step(frame)
    scale = max(1.0, float(fractions.layers.excitation.max()))
    for phi, each in sums_of(whole).items():
        np.testing.assert_allclose(each, sums_of(fractions)[phi], atol=1e-5 * scale)


def test_a_full_range_is_recognised_after_black_frames() -> None:
    shape = (20, 30)
    frames = [np.zeros(shape, np.float32)] * 3 + frames_of(255, shape)
    dpc = Dpc(shape, DpcParams(), (45, 135))
    for frame in frames:
        dpc.step(frame)
    assert counts_whole(dpc) in (True, None)
    check(dpc, frames)


def test_fractions_of_a_level_are_computed_as_such() -> None:
    """Frames of 10 bits, from the first or later."""
    shape = (20, 30)
    frames = frames_of(219, shape) + frames_of(876, shape)
    for first in (0, 5):
        dpc = Dpc(shape, DpcParams(), (45, 135))
        for frame in frames[first:]:
            dpc.step(frame)
        assert counts_whole(dpc) in (False, None)
        check(dpc, frames, atol=2e-6)


def test_a_refused_frame_leaves_the_levels_as_they_are() -> None:
    shape = (20, 30)
    frames = frames_of(219, shape)
    dpc = Dpc(shape, DpcParams(), (45, 135))
    for frame in frames[:4]:
        dpc.step(frame)
    broken = frames[4].copy()
    broken[3, 3] = np.nan
    with pytest.raises(FrameError, match="not finite"):
        dpc.step(broken)
    dpc.step(frames[4])
    assert counts_whole(dpc) in (True, None)
    check(dpc, frames)


def test_the_next_video_may_have_other_levels() -> None:
    shape = (20, 30)
    dpc = Dpc(shape, DpcParams(), (45, 135))
    for levels in (876, 255, 219):
        dpc.reset()
        for frame in frames_of(levels, shape):
            dpc.step(frame)
        assert counts_whole(dpc) in (levels in LEVELS, None)
        check(dpc, frames_of(levels, shape))
