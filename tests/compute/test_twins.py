"""Each compiled twin against its plain function, and both against the literal reference."""

from __future__ import annotations

import inspect
from typing import TYPE_CHECKING, ParamSpec, TypeVar

import cv2
import numpy as np
import pytest

from oppload_cli.compute import loops
from oppload_cli.models import dlgmd, dpc, opplod_reference, units
from oppload_cli.models.dpc import DpcParams, Kernels, PresynapticSums
from oppload_cli.models.opplod_reference import offset_weights
from oppload_cli.models.units import cell_centres, pooling_weights
from oppload_cli.motion import rmo
from tests import reference
from tests.arithmetic import many_bands

if TYPE_CHECKING:
    from collections.abc import Callable

    from oppload_cli.models.dpc import Map

    Taken = ParamSpec("Taken")
    Returned = TypeVar("Returned")

__all__ = ["many_bands"]

SHAPES = [(1, 1), (5, 90), (13, 13), (7, 4), (40, 61)]
AXES: list[tuple[int, ...]] = [(), (0, 90), (45, 135)]


@pytest.fixture(autouse=True)
def _compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(loops, "portable", False)
    if loops.arithmetic() == "portable":
        pytest.skip("the compiled loops were not built")


def plain(function: Callable[Taken, Returned]) -> Callable[Taken, Returned]:
    """Return the plain function behind a compiled one."""
    unwrapped: Callable[Taken, Returned] = inspect.unwrap(function)
    assert unwrapped is not function
    return unwrapped


@pytest.mark.parametrize(
    "compiled",
    [
        *(dpc.presynaptic_sums, dlgmd.group, units.pool),
        *(opplod_reference.opponent_products, rmo.rmo_sums),
    ],
)
def test_a_twin_has_the_name_and_the_arguments_of_its_plain_function(
    compiled: Callable[..., object],
) -> None:
    twin = loops._TWINS[compiled.__name__]
    assert len(inspect.signature(twin).parameters) == len(inspect.signature(compiled).parameters)


# ---- The presynaptic sums ------------------------------------------------------------------


def photoreceptors(shape: tuple[int, int], seed: int) -> list[Map]:
    """P(t), P(t-1) and P(t-2): inhibition is weak, and part of the frame does not change."""
    rng = np.random.default_rng(seed)
    maps = [rng.random(shape, dtype=np.float32) * np.float32(k) for k in (1, 0.03, 0.02)]
    for change in maps:
        change[shape[0] // 3 : shape[0] // 2, : shape[1] // 2] = 0
    return maps


def stacked(sums: PresynapticSums) -> Map:
    return np.stack([sums.presynaptic, *(sums.pathways[phi] for phi in sorted(sums.pathways))])


@pytest.mark.parametrize("radius", [1, 6, 12])
@pytest.mark.parametrize("shape", SHAPES)
def test_presynaptic_sums(shape: tuple[int, int], radius: int) -> None:
    for axes in AXES:
        kernels = Kernels.of(DpcParams(kernel_radius=radius), axes)
        out, other = (PresynapticSums.zeros(shape, axes) for _ in "ab")
        for values in (out.presynaptic, *out.pathways.values()):
            values[:] = np.nan  # a new array may hold any values
        for seed in (1, 2):  # the second time, the loops do not write zeros over zeros
            p = photoreceptors(shape, seed)
            dpc.presynaptic_sums(p, kernels, out)
            plain(dpc.presynaptic_sums)(p, kernels, other)
            np.testing.assert_allclose(stacked(out), stacked(other), atol=1e-5)
        wide = [np.asarray(change, np.float64) for change in p[::-1]]
        expected = [reference.presynaptic(wide, radius)]
        expected += [reference.pathway(wide, phi, radius) for phi in sorted(out.pathways)]
        np.testing.assert_allclose(stacked(out), expected, atol=1e-5)
        assert expected[0].max() > 0.1 or shape == (1, 1)


def test_sums_of_other_axes_go_into_the_same_arrays() -> None:
    shape = (37, 53)
    p = photoreceptors(shape, 1)
    out, other = (PresynapticSums.zeros(shape, (0, 90)) for _ in "ab")
    for axes in ((), (0, 90)):
        kernels = Kernels.of(DpcParams(), axes)
        dpc.presynaptic_sums(p, kernels, out)
        plain(dpc.presynaptic_sums)(p, kernels, other)
    assert stacked(other)[1:].max() > 0.1
    np.testing.assert_allclose(stacked(out), stacked(other), atol=1e-5)


@pytest.mark.parametrize("axes", [(0, 90), (45, 135)])
@pytest.mark.parametrize("empty", ["left", "right", "above", "below", "nothing"])
def test_presynaptic_sums_where_excitation_and_inhibition_are_about_equal(
    axes: tuple[int, int], empty: str
) -> None:
    """E grows from the left to the right; one side of each block has no inhibition."""
    shape = (70, 173)
    rng = np.random.default_rng(5)
    rows, columns = np.indices(shape)
    sides = {"left": -columns, "right": columns, "above": -rows, "below": rows}
    inhibits = sides[empty] % 14 < 9 if empty in sides else np.ones(shape, bool)
    latest = rng.integers(0, 4, shape) + rng.integers(0, 2, shape) * columns // 2
    before = rng.integers(5, 10, shape) * inhibits
    p = [(change / 219).astype(np.float32) for change in (latest, before, np.zeros(shape))]
    kernels = Kernels.of(DpcParams(), axes)
    out, other = (PresynapticSums.zeros(shape, axes) for _ in "ab")
    dpc.presynaptic_sums(p, kernels, out)
    plain(dpc.presynaptic_sums)(p, kernels, other)
    np.testing.assert_allclose(stacked(out), stacked(other), atol=1e-5)
    shares = (stacked(other) > 0).mean(axis=(1, 2))
    assert 0.005 < shares.min() <= shares.max() < 0.9


@pytest.mark.parametrize(
    "params",
    [
        DpcParams(kernel_radius=30, inhibition_strength=90.0, latency_lambda=0.2),
        DpcParams(latency_one=-10.0, latency_two=100.0),  # nothing excites
        DpcParams(inhibition_strength=0.0),  # nothing inhibits
        DpcParams(kernel_radius=9, sigma_inhibition=8.0, sigma_excitation=4.0),
    ],
)
def test_presynaptic_sums_of_other_constants(params: DpcParams) -> None:
    p, kernels = photoreceptors((45, 75), 3), Kernels.of(params, (45, 135))
    out, other = (PresynapticSums.zeros((45, 75), (45, 135)) for _ in "ab")
    dpc.presynaptic_sums(p, kernels, out)
    plain(dpc.presynaptic_sums)(p, kernels, other)
    scale = max(1.0, float(dpc.excitation(p, kernels).max()))
    np.testing.assert_allclose(stacked(out), stacked(other), atol=1e-5 * scale)


@pytest.mark.usefixtures("many_bands")
@pytest.mark.parametrize("shape", [(40, 61), (13, 13), (8, 300)])
def test_bands_and_threads_change_no_bit(
    shape: tuple[int, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    kernels = Kernels.of(DpcParams(kernel_radius=12), (45, 135))
    results = []
    for threads, band in ((1, 1000), (1, 7), (2, 7), (5, 7), (5, 1)):
        cv2.setNumThreads(threads)
        monkeypatch.setattr(loops, "_BAND", band)
        out, g = PresynapticSums.zeros(shape, (45, 135)), np.empty(shape, np.float32)
        for seed in (1, 2):
            dpc.presynaptic_sums(photoreceptors(shape, seed), kernels, out)
        means = dlgmd.group(out.presynaptic, 4, 0.1, 1.0, g)
        results.append((stacked(out).tobytes(), g.tobytes(), means))
    assert g.max() > 0
    assert all(result == results[0] for result in results[1:])


# ---- Grouping, pooling and opponent products -----------------------------------------------


@pytest.mark.parametrize("side", [1, 4, 7, 100])
@pytest.mark.parametrize("shape", SHAPES)
def test_grouping(shape: tuple[int, int], side: int) -> None:
    s = np.random.default_rng(side).random(shape, dtype=np.float32)
    s[:, shape[1] // 3 : shape[1] // 2] = 0
    limit = 0.7 * side
    out, other = np.full((2, *shape), np.nan, np.float32)
    means = dlgmd.group(s, side, 0.3, limit, out)
    np.testing.assert_allclose(means, plain(dlgmd.group)(s, side, 0.3, limit, other), rtol=1e-6)
    expected = reference.grouped(s.astype(np.float64), side, 0.3, limit)
    for found in (out, other):
        np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-5)
    assert means == pytest.approx((s.mean(dtype=np.float64), expected.mean()), rel=1e-5)


@pytest.mark.parametrize("function", [dlgmd.group, plain(dlgmd.group)])
@pytest.mark.parametrize(("threshold", "kept"), [(0.25, 0.25), (0.2500001, 0.0)])
def test_grouping_keeps_a_value_that_equals_the_threshold(
    function: Callable[..., object], threshold: float, kept: float
) -> None:
    s, out = np.zeros((2, 9, 9), np.float32)
    s[4, 4] = 0.5  # alone, so that C is 0.5 and G is 0.25
    function(s, 4, threshold, 1.0, out)
    assert float(out[4, 4]) == float(out.sum()) == kept


@pytest.mark.parametrize(("cell", "sigma"), [(8, 1.5), (7, 0.43), (1, 2.0), (24, 1.5)])
@pytest.mark.parametrize("shape", [*SHAPES, (131, 118)])
def test_pooling(shape: tuple[int, int], cell: int, sigma: float) -> None:
    maps = list(np.random.default_rng(2).random((3, *shape), dtype=np.float32))
    maps[0][: shape[0] // 4] = 0
    down, across = (
        pooling_weights(length, cell_centres(length, cell), sigma * cell) for length in shape
    )
    found = units.pool(maps, down, across)
    np.testing.assert_allclose(found, plain(units.pool)(maps, down, across), rtol=1e-5, atol=1e-7)
    for one, values in zip(found, maps, strict=True):
        np.testing.assert_allclose(one, reference.pooled(values, cell, sigma), atol=2e-6)


@pytest.mark.parametrize("axes", [(0, 90), (45, 135), (135,)])
def test_opponent_products(axes: tuple[int, ...]) -> None:
    for shape, reach in (((1, 1), 3), ((5, 17), 6), ((9, 9), 2), ((4, 30), 0), ((2, 3), 9)):
        pooled = np.random.default_rng(axes).random((2 * len(axes), *shape), dtype=np.float32)
        weights = np.array([offset_weights(reach, axis, 0.7) for axis in axes])
        found = opplod_reference.opponent_products(pooled, weights)
        for n, axis in enumerate(axes):
            one, other = pooled[n], pooled[len(axes) + n]
            expected = reference.opponent_products(one, other, axis, reach, w_p=0.7)
            np.testing.assert_allclose(found[n], expected, atol=2e-5)
        alike = plain(opplod_reference.opponent_products)(pooled, weights)
        np.testing.assert_allclose(found, alike, atol=1e-5)


# ---- Motion --------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [0, 1, 2, 3, 7, 100, 701])
@pytest.mark.parametrize(("opposite", "outward", "sides"), [(30, 45, 2), (90, 90, 1), (0, 45, 2)])
def test_rmo_sums(count: int, opposite: float, outward: float, sides: int) -> None:
    starts, vectors = np.random.default_rng(count).normal(size=(2, count, 2))
    vectors[::5] = 0
    starts[1::5] = 0  # pairs that start at one point are neither outward nor inward
    found = rmo.rmo_sums(starts, vectors, opposite, outward, sides)
    expected = plain(rmo.rmo_sums)(starts, vectors, opposite, outward, sides)
    assert (found[0], found[-1]) == (expected[0], expected[-1])
    assert found == pytest.approx(expected, rel=1e-9)
    assert expected[-1] > 0 or count < 100 or not opposite
