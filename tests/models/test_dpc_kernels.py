from __future__ import annotations

import numpy as np
import pytest

from oppload_cli.models.dlgmd import DlgmdParams
from oppload_cli.models.dpc import (
    DpcParams,
    Kernels,
    direction_mask,
    excitation_kernel,
    inhibition_kernels,
    latency,
)
from oppload_cli.models.opplod_lplc2 import OpplodLplc2Params
from oppload_cli.models.opplod_paper import OpplodPaperParams
from oppload_cli.models.opplod_reference import OpplodReferenceParams
from tests import reference

PARAMS = DpcParams()


def test_kernel_sums_and_supports_are_those_of_the_model() -> None:
    w_e, (one, two) = excitation_kernel(PARAMS), inhibition_kernels(PARAMS)
    assert [int((k > 0).sum()) for k in (w_e, one, two)] == [5, 64, 100]
    assert [k.sum() for k in (w_e, one, two)] == pytest.approx(
        [0.528889, 6.103130, 5.555562], abs=1e-5
    )


def test_kernels_equal_the_literal_ones() -> None:
    one, two = inhibition_kernels(PARAMS)
    np.testing.assert_allclose(
        excitation_kernel(PARAMS), reference.kernel(reference.w_e), atol=1e-14
    )
    np.testing.assert_allclose(one, reference.kernel(reference.w_i(1)), atol=1e-14)
    np.testing.assert_allclose(two, reference.kernel(reference.w_i(2)), atol=1e-14)


def test_excitation_is_never_negative() -> None:
    strong = excitation_kernel(DpcParams(inhibition_strength=3))
    assert strong.min() == 0
    assert strong[6, 6] > 0
    assert strong[6, 7] == 0


def test_latency_grows_with_distance() -> None:
    row = latency(PARAMS)[6, 6:]
    assert (np.diff(row) > 0).all()
    assert row[0] == pytest.approx(-0.1 + 1 / 1.5)


@pytest.mark.parametrize("phi", [0, 45, 90, 200])
def test_opposite_direction_masks_sum_to_one(phi: int) -> None:
    both = direction_mask(PARAMS, phi) + direction_mask(PARAMS, phi + 180)
    np.testing.assert_allclose(both, 1, atol=1e-15)
    np.testing.assert_allclose(
        direction_mask(PARAMS, phi), reference.kernel(reference.mask(phi)), atol=1e-14
    )


def test_a_mask_is_smallest_where_motion_of_its_direction_comes_from() -> None:
    mask = direction_mask(PARAMS, 90)  # up passes: offsets above (y < 0) are not inhibited
    assert mask[0, 6] < 1e-3
    assert mask[12, 6] > 0.999


def test_a_wide_kernel_does_not_overflow() -> None:
    assert np.isfinite(direction_mask(DpcParams(kernel_radius=50), 45)).all()


def test_the_kernels_of_a_layer_keep_every_value() -> None:
    kernels = Kernels.of(PARAMS, (45, 135))
    assert kernels.excitation.shape == (3, 3)  # without the zeros around its five values
    assert kernels.excitation.sum() == excitation_kernel(PARAMS).sum()
    np.testing.assert_array_equal(kernels.inhibition, inhibition_kernels(PARAMS))
    assert list(kernels.odd_masks) == [45, 135]
    np.testing.assert_array_equal(kernels.odd_masks[135] + 0.5, direction_mask(PARAMS, 135))


@pytest.mark.parametrize(
    "kind", [DlgmdParams, OpplodReferenceParams, OpplodPaperParams, OpplodLplc2Params]
)
def test_the_constants_of_a_detector_are_the_dpc_constants_alone(kind: type[DpcParams]) -> None:
    assert kind().dpc() == DpcParams()
    assert kind(kernel_radius=9).dpc() == DpcParams(kernel_radius=9)
    assert DlgmdParams(kernel_radius=9, group_size=2).dpc() == DpcParams(kernel_radius=9)
