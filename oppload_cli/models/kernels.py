"""The DPC and MDE kernels (``docs/model.md``, sections 2 and 4).

All are square arrays of side 2 r + 1 over the OFFSET d = (x, y) from source to target, x right
and y down, with d = 0 in the middle.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from oppload_cli.schema import Parameters, parameter

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Kernel = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class DpcParams(Parameters):
    """Constants of the distributed presynaptic connections (DPC).

    They are in pixels of the working size and do not scale with it: this ties the speed
    selectivity to the working size. Values: the MATLAB code of the D-LGMD authors
    (``docs/model.md``, section 2).
    """

    sigma_excitation: float = parameter(
        1.5, "spread of excitation, sigma_E", unit="px", low=0.1, high=100
    )
    sigma_inhibition: float = parameter(
        5.0, "spread of inhibition, sigma_I", unit="px", low=0.1, high=100
    )
    inhibition_strength: float = parameter(
        1.5, "strength of inhibition against excitation, a", low=0, high=100
    )
    kernel_radius: int = parameter(6, "radius of all DPC kernels, r", unit="px", low=1, high=50)
    latency_alpha: float = parameter(-0.1, "latency constant alpha_tau", low=-10, high=10)
    latency_beta: float = parameter(0.5, "latency constant beta", low=0.01, high=10)
    latency_lambda: float = parameter(
        0.7, "latency constant lambda", unit="1/px", low=0.01, high=10
    )
    latency_one: float = parameter(
        1.0, "latency from which a connection is one frame late", unit="frames", low=-10, high=100
    )
    latency_two: float = parameter(
        1.8999,
        "latency above which a connection is two frames late",
        unit="frames",
        low=-10,
        high=100,
    )

    def dpc(self) -> DpcParams:
        """Return the DPC constants alone: detectors that agree in them share their layers."""
        return DpcParams(**{name: getattr(self, name) for name in DpcParams.names()})


@dataclass(frozen=True, eq=False)
class Kernels:
    """The kernels of one set of DPC constants, and the masks of some axes.

    Attributes
    ----------
    excitation : ndarray
        W_E, without the zeros around its few values: OpenCV sums such a small kernel directly, so
        that E is exactly 0 where P is.
    inhibition : tuple of ndarray, shape (2 r + 1, 2 r + 1)
        W_I1, which acts on P(t-1), and W_I2, which acts on P(t-2).
    masks : dict of int to ndarray, shape (2 r + 1, 2 r + 1)
        M_phi - 1/2 by the direction phi of an axis in degrees.
    """

    excitation: Kernel
    inhibition: tuple[Kernel, Kernel]
    masks: dict[int, Kernel]

    @classmethod
    def of(cls, params: DpcParams, axes: tuple[int, ...] = ()) -> Kernels:
        """Return the kernels of some constants, with the masks of the given axes in degrees."""
        masks = {phi: direction_mask(params, phi) - 0.5 for phi in axes}
        return cls(_trimmed(excitation_kernel(params)), inhibition_kernels(params), masks)


def _spread(params: DpcParams, sigma: float) -> Kernel:
    """Return g_s(d), the Gaussian of eq. (kernel EI).

    Its amplitude is the one-dimensional ``1 / (s sqrt(2 pi))``, not renormalised, as in the
    authors' code; with the two-dimensional one the velocity selectivity all but vanishes.

    Parameters
    ----------
    params : DpcParams
        Gives the kernel radius.
    sigma : float
        Spread s in pixels, above 0.
    """
    x, y = _offsets(params.kernel_radius)
    gaussian: Kernel = np.exp(-(x**2 + y**2) / (2 * sigma**2)) / (sigma * np.sqrt(2 * np.pi))
    return gaussian


def latency(params: DpcParams) -> Kernel:
    """Return tau(d), the latency of a connection in frames, eq. (tau)."""
    x, y = _offsets(params.kernel_radius)
    near = np.exp(-(params.latency_lambda**2) * (x**2 + y**2))
    return params.latency_alpha + 1 / (params.latency_beta + near)


def excitation_kernel(params: DpcParams) -> Kernel:
    """Return W_E = max(0, g_E - a g_I) where the delay is 0 (``docs/model.md``, section 2).

    With the default constants five pixels are not 0; their sum is 0.528889.
    """
    excitation = _spread(params, params.sigma_excitation)
    inhibition = params.inhibition_strength * _spread(params, params.sigma_inhibition)
    undelayed = latency(params) < params.latency_one
    return np.where(undelayed, np.maximum(0, excitation - inhibition), 0)


def inhibition_kernels(params: DpcParams) -> tuple[Kernel, Kernel]:
    """Return W_I1 and W_I2 = a g_I where the delay is 1 and 2 (``docs/model.md``, section 2).

    With the default constants they have 64 pixels of sum 6.103130 and 100 pixels of sum
    5.555562.
    """
    inhibition = params.inhibition_strength * _spread(params, params.sigma_inhibition)
    tau = latency(params)
    late = tau > params.latency_two
    early = (tau >= params.latency_one) & ~late
    return np.where(early, inhibition, 0), np.where(late, inhibition, 0)


def direction_mask(params: DpcParams, direction: float) -> Kernel:
    """Return M_phi(d), the MDE mask on the inhibition kernel, eq. (mde), from 0 to 1.

    It is named by the direction of the motion that PASSES, and ``M_phi + M_(phi+180) = 1``
    (``docs/model.md``, section 4).

    Parameters
    ----------
    params : DpcParams
        Gives the kernel radius.
    direction : float
        phi in degrees, counter-clockwise, 0 = right, 90 = up.
    """
    x, y = _offsets(params.kernel_radius)
    phi = np.deg2rad(direction)
    along = x * np.cos(phi) - y * np.sin(phi)
    # 1 / (1 + exp(sqrt(2) along)), written so that a large kernel does not overflow.
    mask: Kernel = 0.5 - 0.5 * np.tanh(along / np.sqrt(2))
    return mask


def _trimmed(kernel: Kernel) -> Kernel:
    """Cut a kernel to the square about its middle that holds all values other than 0."""
    radius = len(kernel) // 2
    reach = int(np.abs(np.argwhere(kernel) - radius).max(initial=0))
    inner = slice(radius - reach, radius + reach + 1)
    return kernel[inner, inner]


def _offsets(radius: int) -> tuple[Kernel, Kernel]:
    """Return the offsets x and y of a kernel's pixels; y grows down."""
    y, x = np.mgrid[-radius : radius + 1, -radius : radius + 1].astype(np.float64)
    return x, y
