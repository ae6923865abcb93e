"""Photoreceptors, DPC and MDE: the equations that several detectors share.

``docs/model.md`` has these equations in sections 1, 2 and 4. This module has first the kernels,
then the layers. :mod:`oppload_cli.models.layers` applies the equations to the frames of a video.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

import cv2
import numpy as np

from oppload_cli.compute.loops import with_twin
from oppload_cli.errors import FrameError
from oppload_cli.schema import Parameters, parameter

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Kernel = NDArray[np.float64]
    Map = NDArray[np.float32]  # one value per pixel of the working frame


# ---- The kernels ---------------------------------------------------------------------------
# Kernels are square arrays of side 2 r + 1 over the OFFSET d = (x, y) from source to target, x
# right and y down, with d = 0 in the middle.


@dataclass(frozen=True, kw_only=True)
class DpcParams(Parameters):
    """Constants of the distributed presynaptic connections (DPC).

    Lengths are in pixels of the working size and do not scale with it, unless OppLoD's
    `kernel_height` is set. The preferred speed therefore depends on the working size. The values
    are those of the D-LGMD authors' MATLAB code (``docs/model.md``, section 2).
    """

    sigma_excitation: float = parameter(
        1.5, "spread of excitation, sigma_E", unit="px", low=0.1, high=100
    )
    sigma_inhibition: float = parameter(
        5.0, "spread of inhibition, sigma_I", unit="px", low=0.1, high=100
    )
    inhibition_strength: float = parameter(
        1.5, "strength of inhibition relative to excitation, a", low=0, high=100
    )
    kernel_radius: int = parameter(6, "radius of all DPC kernels, r", unit="px", low=1, high=50)
    latency_alpha: float = parameter(-0.1, "latency constant alpha_tau", low=-10, high=10)
    latency_beta: float = parameter(0.5, "latency constant beta", low=0.01, high=10)
    latency_lambda: float = parameter(
        0.7, "latency constant lambda", unit="1/px", low=0.01, high=10
    )
    latency_one: float = parameter(
        1.0, "latency from which on the delay is one frame", unit="frames", low=-10, high=100
    )
    latency_two: float = parameter(
        1.8999, "latency above which the delay is two frames", unit="frames", low=-10, high=100
    )

    def dpc(self) -> DpcParams:
        """Return the DPC constants alone; detectors with equal DPC constants share their layers."""
        return DpcParams(**{name: getattr(self, name) for name in DpcParams.names()})


@dataclass(frozen=True, eq=False)
class Kernels:
    """The kernels of one set of DPC constants, and the masks of some axes.

    Attributes
    ----------
    excitation : ndarray
        W_E, without the rows and columns of zeros at its edges. OpenCV sums such a small kernel
        directly, so that E is exactly 0 where P is 0.
    inhibition : tuple of ndarray, shape (2 r + 1, 2 r + 1)
        W_I1, which acts on P(t-1), and W_I2, which acts on P(t-2).
    odd_masks : dict of int to ndarray, shape (2 r + 1, 2 r + 1)
        M_phi - 1/2 by the direction phi of an axis in degrees. It is an odd function of the offset,
        so that the compiled loops need only one quadrant of it.
    """

    excitation: Kernel
    inhibition: tuple[Kernel, Kernel]
    odd_masks: dict[int, Kernel]

    @classmethod
    def of(cls, params: DpcParams, axes: tuple[int, ...] = ()) -> Kernels:
        """Return the kernels of some constants, with the masks of the given axes in degrees."""
        odd_masks = {phi: direction_mask(params, phi) - 0.5 for phi in axes}
        return cls(_trimmed(excitation_kernel(params)), inhibition_kernels(params), odd_masks)


def _gaussian(params: DpcParams, sigma: float) -> Kernel:
    """Return g_s(d), the Gaussian of eq. (kernel EI) with the spread s in pixels.

    As in the authors' code, its amplitude is that of a one-dimensional Gaussian,
    ``1 / (s sqrt(2 pi))``, and its sum is not 1. With the two-dimensional amplitude nearly no
    velocity selectivity remains.
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
    excitation = _gaussian(params, params.sigma_excitation)
    inhibition = params.inhibition_strength * _gaussian(params, params.sigma_inhibition)
    undelayed = latency(params) < params.latency_one
    return np.where(undelayed, np.maximum(0, excitation - inhibition), 0)


def inhibition_kernels(params: DpcParams) -> tuple[Kernel, Kernel]:
    """Return W_I1 and W_I2 = a g_I where the delay is 1 and 2 (``docs/model.md``, section 2).

    With the default constants W_I1 has 64 pixels other than 0, with a sum of 6.103130, and W_I2
    has 100, with a sum of 5.555562.
    """
    inhibition = params.inhibition_strength * _gaussian(params, params.sigma_inhibition)
    tau = latency(params)
    late = tau > params.latency_two
    early = (tau >= params.latency_one) & ~late
    return np.where(early, inhibition, 0), np.where(late, inhibition, 0)


def direction_mask(params: DpcParams, direction: float) -> Kernel:
    """Return M_phi(d), the MDE mask on the inhibition kernel, eq. (mde), from 0 to 1.

    `direction` is phi, the direction of the motion that PASSES, in degrees, counter-clockwise, 0 =
    right, 90 = up. ``M_phi + M_(phi+180) = 1`` (``docs/model.md``, section 4).
    """
    x, y = _offsets(params.kernel_radius)
    phi = np.deg2rad(direction)
    along = x * np.cos(phi) - y * np.sin(phi)
    # This equals 1 / (1 + exp(sqrt(2) along)), but does not overflow for a large kernel.
    mask: Kernel = 0.5 - 0.5 * np.tanh(along / np.sqrt(2))
    return mask


def _trimmed(kernel: Kernel) -> Kernel:
    """Return the smallest square about a kernel's middle that has all values other than 0."""
    radius = len(kernel) // 2
    reach = int(np.abs(np.argwhere(kernel) - radius).max(initial=0))
    inner = slice(radius - reach, radius + reach + 1)
    return kernel[inner, inner]


def _offsets(radius: int) -> tuple[Kernel, Kernel]:
    """Return the offsets x and y of a kernel's pixels; y grows down."""
    y, x = np.mgrid[-radius : radius + 1, -radius : radius + 1].astype(np.float64)
    return x, y


# ---- The layers ----------------------------------------------------------------------------


def photoreceptors(luma: Map, before: Map) -> Map:
    """Return ``P(t) = |L(t) - L(t-1)|`` (``docs/model.md``, section 1)."""
    return np.asarray(cv2.absdiff(luma, before), np.float32)


def _convolved(values: Map, kernel: Kernel) -> Map:
    """Return ``W * P``, a true convolution in which P is 0 outside the frame."""
    # OpenCV's filter2D correlates; with a flipped kernel it convolves.
    flipped = kernel[::-1, ::-1].astype(np.float32)
    convolution = cv2.filter2D(values, cv2.CV_32F, flipped, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(convolution, np.float32)


def excitation(p: Sequence[Map], kernels: Kernels) -> Map:
    """Return ``E = W_E * P(t)``, eq. (E); `p` holds P(t), P(t-1) and P(t-2)."""
    return _convolved(p[0], kernels.excitation)


def inhibition(p: Sequence[Map], kernels: Kernels) -> Map:
    """Return ``I = W_I1 * P(t-1) + W_I2 * P(t-2)``, eq. (I)."""
    one, two = kernels.inhibition
    return _convolved(p[1], one) + _convolved(p[2], two)


def directional_inhibition(p: Sequence[Map], kernels: Kernels, axis: int) -> Map:
    """Return ``I_phi = (W_I1 M_phi) * P(t-1) + (W_I2 M_phi) * P(t-2)``, section 4.

    `axis` is the direction phi in degrees. ``I_phi + I_(phi+180) = I``, so that I_phi also gives
    the inhibition of the opposite pathway.
    """
    mask = kernels.odd_masks[axis] + 0.5
    one, two = kernels.inhibition
    return _convolved(p[1], one * mask) + _convolved(p[2], two * mask)


def rectified(excitation: Map, inhibition: Map) -> Map:
    """Return ``S = max(0, E - I)``, eq. (S)."""
    # OpenCV convolves large kernels by Fourier transform. By its rounding errors I can be a little
    # below 0, and S above E. S is limited to E, so that it is exactly 0 where nothing changed.
    return np.asarray(np.minimum(np.maximum(excitation - inhibition, 0), excitation), np.float32)


@dataclass(frozen=True, eq=False)
class PresynapticSums:
    """S of D-LGMD, and S_phi of the pathways by their direction phi in degrees.

    All are arrays of float32, shape (height, width), at least 0.
    """

    presynaptic: Map
    pathways: dict[int, Map]

    @classmethod
    def zeros(cls, shape: tuple[int, int], axes: tuple[int, ...]) -> PresynapticSums:
        """Return zeros, for both pathways of each axis."""
        directions = [*axes, *(phi + 180 for phi in axes)]
        # One array holds all maps. Separate arrays would begin at the same offset of a memory page,
        # and would displace each other from the processor's cache.
        presynaptic, *pathways = np.zeros((1 + len(directions), *shape), np.float32)
        return cls(presynaptic, dict(zip(directions, pathways, strict=True)))


@with_twin
def presynaptic_sums(p: Sequence[Map], kernels: Kernels, out: PresynapticSums) -> None:
    """Compute S and S_phi (``docs/model.md``, sections 2 and 4).

    Parameters
    ----------
    p : sequence of ndarray of float32, shape (height, width)
        P(t), P(t-1) and P(t-2), contiguous.
    kernels : Kernels
        The kernels, with the masks of no axis or of two axes at a right angle.
    out : PresynapticSums
        Filled with ``S = max(0, E - I)`` and ``S_phi = max(0, E - I_phi)``.
    """
    e, i = excitation(p, kernels), inhibition(p, kernels)
    out.presynaptic[:] = rectified(e, i)
    for axis in kernels.odd_masks:
        i_phi = directional_inhibition(p, kernels, axis)
        out.pathways[axis][:] = rectified(e, i_phi)
        out.pathways[axis + 180][:] = rectified(e, i - i_phi)


# ---- Other intervals -----------------------------------------------------------------------


_Values = TypeVar("_Values", float, "Map")


def referred(s: _Values, excitation: _Values, share: float, *, directional: bool) -> _Values:
    """Convert S measured over an interval of another length to S over the wanted interval.

    E is proportional to the displacement of an edge. Inhibition reduces E by the loss ``E - S``,
    which is constant if the edge moves by more than a few pixels. So S over the wanted interval is
    ``share E - (E - S)``. If the edge moves by less than 2 px, S of a pathway that passes the
    edge is about proportional to the square of the displacement, and becomes ``share^2 S``. The
    result is the larger of both values, for a share above 1 the smaller (measured in
    ``docs/time.md``).

    Parameters
    ----------
    s, excitation : float or ndarray of float32
        S and E, at least 0, summed or pooled over the area through which the edge moves.
    share : float
        Wanted interval divided by the actual interval, above 0.
    directional : bool
        Whether S is that of a pathway.
    """
    with_loss, squared = s - (1 - share) * excitation, share * share * s
    if share > 1:  # the actual interval is shorter than the wanted one
        result: _Values = np.minimum(with_loss, squared)
    else:
        result = np.maximum(with_loss, squared if directional else 0)
    return result


# ---- Frames --------------------------------------------------------------------------------


def check_frame(luma: Map, shape: tuple[int, int]) -> None:
    """Raise a FrameError unless an array is float32 of the given shape, with finite values."""
    given: object = luma  # a caller may give None, in spite of the type
    if not isinstance(given, np.ndarray):
        raise FrameError(f"a frame must be a float32 array of shape {shape}, not {given!r:.60}")
    if luma.shape != shape or luma.dtype != np.float32:
        raise FrameError(
            f"a frame must be a float32 array of shape {shape}, "
            f"not {luma.dtype} of shape {luma.shape}"
        )
    if not math.isfinite(cv2.sumElems(luma)[0]):
        raise FrameError("a frame holds luminance that is not finite (NaN or infinite)")


def grey_levels(luma: Map, shape: tuple[int, int]) -> NDArray[np.uint8]:
    """Return ``L8``, the luminance in integer grey levels, 0 to 255; errors as `check_frame`."""
    check_frame(luma, shape)
    return np.asarray(cv2.convertScaleAbs(luma, alpha=255.0), np.uint8)
