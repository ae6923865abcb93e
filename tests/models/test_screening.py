"""The bounds by which strips without S are passed over."""

from __future__ import annotations

import numpy as np
import pytest

from oppload_cli.models.kernels import direction_mask, excitation_kernel, inhibition_kernels
from oppload_cli.models.parameters import DpcParams
from oppload_cli.models.screening import Screening
from oppload_cli.models.taps import quadrants

STRIDE = 1000


def places_of(bound: object) -> list[tuple[int, int, list[int]]]:
    """dy, dx and the weights of each place, those of weight 0 left out."""
    found = []
    for n in range(bound.count):  # type: ignore[attr-defined]
        pair = bound.pairs[n]  # type: ignore[attr-defined]
        for which, place in enumerate(pair.places):
            weights = [each[which] for each in pair.weights]
            assert weights == [each[which + 2] for each in pair.weights]
            dy = round(place / STRIDE)
            if any(weights):
                found.append((dy, place - dy * STRIDE, weights))
    return found


@pytest.mark.parametrize("axes", [(45, 135), (0, 90)])
@pytest.mark.parametrize("params", [DpcParams(), DpcParams(kernel_radius=9, sigma_inhibition=5)])
def test_bounds_hold(params: DpcParams, axes: tuple[int, int]) -> None:
    radius = params.kernel_radius
    table = Screening.of(quadrants(params, axes), STRIDE, diagonal=45 in axes)
    w_e, w_i1 = excitation_kernel(params), inhibition_kernels(params)[0]
    of_e = [
        (weights[0], w_e[radius + dy, radius + dx])
        for dy, dx, weights in places_of(table.excitation)
    ]
    assert len(of_e) == np.count_nonzero(w_e)
    least_scale = min(weight / value for weight, value in of_e)
    phis = (axes[0], axes[0] + 180, axes[1], axes[1] + 180)
    # Where they are applied kernels are turned by 180 degrees: that swaps opposite pathways.
    inhibition = [w_i1 * direction_mask(params, phi) for phi in phis]
    used = np.zeros_like(w_i1)
    for dy, dx, weights in places_of(table.inhibition):
        box = np.s_[radius + dy : radius + dy + 2, radius + dx : radius + dx + 2]
        used[box] += 1
        assert max(abs(dy), abs(dx)) <= table.reach
        for weight, kernel in zip(weights, inhibition, strict=True):
            assert kernel[box].shape == (2, 2)
            assert weight <= 1.000001 * least_scale * kernel[box].min()
    assert used.max() == 1
    assert used[w_i1 > 0].mean() > 0.7
