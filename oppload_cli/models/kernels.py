"""The DPC and MDE kernels (``docs/model.md``, sections 2 and 4).

All are square arrays of side 2 r + 1 over the OFFSET d = (x, y) from source to
target, x right and y down, the centre being d = 0.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from oppload_cli.models.parameters import DpcParams

    Kernel = NDArray[np.float64]
    Map = NDArray[np.float32]  # one value per pixel of the working frame


class Inhibition(NamedTuple):
    """The inhibitory kernels by delay: W_I1 acts on P(t-1), W_I2 on P(t-2)."""

    one: Kernel
    two: Kernel


def offsets(radius: int) -> tuple[Kernel, Kernel]:
    """Return the offsets x and y of a kernel's pixels.

    Parameters
    ----------
    radius : int
        Kernel radius r in pixels, at least 1.

    Returns
    -------
    x, y : ndarray, shape (2 r + 1, 2 r + 1)
        Offsets in pixels; y grows down.
    """
    y, x = np.mgrid[-radius : radius + 1, -radius : radius + 1].astype(np.float64)
    return x, y


def spread(params: DpcParams, sigma: float) -> Kernel:
    """Return g_s(d), the Gaussian of eq. (kernel EI).

    Its amplitude is the one-dimensional ``1 / (s sqrt(2 pi))``, not renormalised,
    as in the authors' code; with the two-dimensional one the velocity selectivity
    all but vanishes.

    Parameters
    ----------
    params : DpcParams
        Gives the kernel radius.
    sigma : float
        Spread s in pixels, above 0.

    Returns
    -------
    ndarray, shape (2 r + 1, 2 r + 1)
    """
    x, y = offsets(params.kernel_radius)
    gaussian: Kernel = np.exp(-(x**2 + y**2) / (2 * sigma**2)) / (sigma * np.sqrt(2 * np.pi))
    return gaussian


def latency(params: DpcParams) -> Kernel:
    """Return tau(d), the latency of a connection in frames, eq. (tau).

    Parameters
    ----------
    params : DpcParams
        Gives alpha_tau, beta, lambda and the radius.

    Returns
    -------
    ndarray, shape (2 r + 1, 2 r + 1)
    """
    x, y = offsets(params.kernel_radius)
    near = np.exp(-(params.latency_lambda**2) * (x**2 + y**2))
    return params.latency_alpha + 1 / (params.latency_beta + near)


def excitation_kernel(params: DpcParams) -> Kernel:
    """Return W_E = max(0, g_E - a g_I) where the delay is 0 (``docs/model.md``, section 2).

    Parameters
    ----------
    params : DpcParams
        The DPC constants.

    Returns
    -------
    ndarray, shape (2 r + 1, 2 r + 1)
        With the default constants five pixels are not 0; their sum is 0.528889.
    """
    excitation = spread(params, params.sigma_excitation)
    inhibition = params.inhibition_strength * spread(params, params.sigma_inhibition)
    undelayed = latency(params) < params.latency_one
    return np.where(undelayed, np.maximum(0, excitation - inhibition), 0)


def inhibition_kernels(params: DpcParams) -> Inhibition:
    """Return W_I1 and W_I2 = a g_I where the delay is 1 and 2 (``docs/model.md``, section 2).

    Parameters
    ----------
    params : DpcParams
        The DPC constants.

    Returns
    -------
    Inhibition
        Two arrays of shape (2 r + 1, 2 r + 1); with the default constants 64
        pixels of sum 6.103130 and 100 pixels of sum 5.555562.
    """
    inhibition = params.inhibition_strength * spread(params, params.sigma_inhibition)
    tau = latency(params)
    late = tau > params.latency_two
    return Inhibition(
        one=np.where((tau >= params.latency_one) & ~late, inhibition, 0),
        two=np.where(late, inhibition, 0),
    )


def direction_mask(params: DpcParams, direction: float) -> Kernel:
    """Return M_phi(d), the MDE mask on the inhibition kernel, eq. (mde).

    It is named by the direction of the motion that PASSES, and
    ``M_phi + M_(phi+180) = 1`` (``docs/model.md``, section 4).

    Parameters
    ----------
    params : DpcParams
        Gives the kernel radius.
    direction : float
        phi in degrees, counter-clockwise, 0 = right, 90 = up.

    Returns
    -------
    ndarray, shape (2 r + 1, 2 r + 1)
        Values from 0 to 1.
    """
    x, y = offsets(params.kernel_radius)
    phi = np.deg2rad(direction)
    along = x * np.cos(phi) - y * np.sin(phi)
    # 1 / (1 + exp(sqrt(2) along)), written so that a large kernel does not overflow.
    mask: Kernel = 0.5 - 0.5 * np.tanh(along / np.sqrt(2))
    return mask
