"""The functions that the models of Fu and colleagues share.

These models use grey levels from 0 to 255 and their signed change. They count time in frames, whose
duration is an integer number of milliseconds. Source: ``docs/detectors.md``.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import TYPE_CHECKING, Any, ClassVar

import cv2
import numpy as np

from oppload_cli.models.detector import Detector
from oppload_cli.models.dpc import grey_levels

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from oppload_cli.models.detector import Response
    from oppload_cli.models.dpc import Map

    Plane = NDArray[np.floating[Any]]  # one value per pixel

EDGE, ZERO, MIRROR = cv2.BORDER_REPLICATE, cv2.BORDER_CONSTANT, cv2.BORDER_REFLECT_101
_MOST_EXACT = 2**24  # single precision represents every integer up to this one
USUAL_RATE = 30.0  # frames per second, used if the rate is not known
DECAY = 0.1  # share of ON and OFF that remains in the next frame


class ChangeDetector(Detector):
    """A detector that works on the signed change of grey levels between two frames.

    A subclass defines `_respond` and `_forget`.

    Attributes
    ----------
    precision : type
        Precision of the maps, as in the authors' programs: single in C#, double in MATLAB.
    ti : int
        Duration of every frame in ms, cut to an integer of at least 1 as in the authors' programs:
        33 at 30 frames per second. A frame that comes late has this duration too.
    """

    evaluated = False
    precision: ClassVar[type[np.floating[Any]]] = np.float32

    def __init__(self, shape: tuple[int, int], params: Any = None, **others: Any) -> None:
        super().__init__(shape, params, **others)
        # 1000 / (1000 / 30) is less than 30 by a rounding error, which the cut must not see.
        self.ti = max(1, math.floor(1000 / (self.frame_rate or USUAL_RATE) + 1e-9))
        self.pixels = shape[0] * shape[1]
        self.reset()

    def reset(self) -> None:
        """Forget all frames: the next frame is frame 0."""
        self._before: NDArray[np.uint8] | None = None
        self._forget()

    def step(self, luma: Map) -> Response | None:
        """Take the next frame."""
        now = grey_levels(luma, self.shape)
        before, self._before = self._before, now
        if before is None:
            return self._first_response()
        depth = cv2.CV_32F if self.precision is np.float32 else cv2.CV_64F
        return self._respond(np.asarray(cv2.subtract(now, before, dtype=depth)))

    def _first_response(self) -> Response | None:
        return None if self.warm_up else self.responses(0.0)

    def _zeros(self) -> Plane:
        return np.zeros(self.shape, self.precision)

    @abstractmethod
    def _respond(self, p: Plane) -> Response | None:
        """Respond to ``P(t) = L8(t) - L8(t-1)``, -255 to 255; this method may overwrite `p`."""

    @abstractmethod
    def _forget(self) -> None:
        """Set all values that last from frame to frame to those before frame 0."""


def mean_change(p: Plane) -> float:
    """Return the mean of the absolute change over the frame, in grey levels."""
    summed = float(cv2.norm(p, cv2.NORM_L1))
    if summed >= _MOST_EXACT:
        # The authors sum in single precision, which is not exact above this value.
        summed = float(np.cumsum(np.abs(p), dtype=np.float32)[-1])
    return summed / p.size


def k3(centre: float, nearest: float, diagonal: float) -> Plane:
    """Return the kernel K3: its centre, its four nearest neighbours and its diagonals."""
    rows = (diagonal, nearest, diagonal), (nearest, centre, nearest)
    return np.array([*rows, rows[0]], np.float64)


def spread(values: Plane, kernel: Plane, border: int = EDGE) -> Plane:
    """Return a map convolved with a symmetric kernel."""
    return np.asarray(cv2.filter2D(values, -1, kernel, borderType=border))


def averaged(values: Plane, border: int = EDGE) -> Plane:
    """Return ``A3 * values``, the mean over 3 x 3 pixels."""
    return np.asarray(cv2.blur(values, (3, 3), borderType=border))


def at_least(values: Plane, least: float) -> Plane:
    """Return a map in which values below the threshold `least` (above 0) are replaced by 0."""
    # OpenCV keeps only values above its threshold, so that this must be just below `least`.
    below = float(np.nextafter(values.dtype.type(least), values.dtype.type(-np.inf)))
    return np.asarray(cv2.threshold(values, below, 0, cv2.THRESH_TOZERO)[1])


def positive(values: Plane) -> Plane:
    """Return ``max(values, 0)``."""
    return np.asarray(cv2.threshold(values, 0, 0, cv2.THRESH_TOZERO)[1])


def radial_gaussian(shape: tuple[int, int], s: float) -> Plane:
    """Return ``exp(-4.5 (y'^2 + x'^2)) / (2 pi s (h/w) s)``.

    y' and x' run from -1 to 1 over the height h and the width w of the frame.
    """
    y, x = ((np.arange(side) - side // 2) / max(1, side // 2) for side in shape)
    scale = 2 * math.pi * s * (shape[0] / shape[1]) * s
    return np.asarray(np.exp(-4.5 * (y[:, None] ** 2 + x**2)) / scale, np.float64)


def sigmoid(value: float) -> float:
    """Return ``sig(u) = 1 / (1 + exp(-u))``."""
    return 1 / (1 + math.exp(-value)) if value > -700 else 0.0


def low_pass_share(ti: float, tau: float) -> float:
    """Return ``ti / (ti + tau)``, the weight of the latest value in a low-pass."""
    return ti / (ti + tau)


def low_passed(now: float, before: float, ti: float, tau: float) -> float:
    """Return a low-passed value, given the low-passed value of the frame before."""
    share = low_pass_share(ti, tau)
    return share * now + (1 - share) * before


class DelayedSpread:
    """``ST``: a K3 kernel whose centre, nearest and diagonal taps are low-passed differently.

    `weights` and time constants `taus` are those of the centre, of the nearest neighbours and of
    the diagonals; times are in ms. The low-pass of Fu's models, ``l x(t) + (1 - l) x(t-1)``, uses
    the *input* of the frame before, not the former result. So one kernel is enough for each of the
    two frames.
    """

    def __init__(
        self, weights: tuple[float, float, float], taus: tuple[float, float, float], ti: float
    ) -> None:
        pairs = [(w, low_pass_share(ti, tau)) for w, tau in zip(weights, taus, strict=True)]
        self._now = k3(*(weight * share for weight, share in pairs))
        self._before = k3(*(weight * (1 - share) for weight, share in pairs))

    def __call__(self, now: Plane, before: Plane) -> Plane:
        """Return ST of a map, given the map one frame before."""
        return np.asarray(cv2.add(spread(now, self._now), spread(before, self._before)))


def split(p: Plane, on_before: Plane, off_before: Plane) -> tuple[Plane, Plane]:
    """Return ON and OFF: brightening and darkening, plus a tenth of ON and OFF one frame before.

    ``ON(t) = max(P, 0) + 0.1 ON(t-1)`` and ``OFF(t) = max(-P, 0) + 0.1 OFF(t-1)``. In the authors'
    code P counts as ON if it is at least 0.1, which is the same for integer grey levels.
    """
    on = positive(p)
    off = on - p
    return (
        np.asarray(cv2.scaleAdd(on_before, DECAY, on, dst=on)),
        np.asarray(cv2.scaleAdd(off_before, DECAY, off, dst=off)),
    )


def total(values: Plane) -> float:
    """Return the sum of a map; OpenCV's sum would depend on the map's address in memory."""
    return float(values.sum(dtype=np.float64))


def grouped(s: Plane, coefficient: float, offset: float, border: int) -> tuple[Plane, float]:
    """Return ``S Ce / w`` and w, where ``Ce = A3 * S`` and ``w = max|Ce| / coefficient + offset``.

    An isolated pixel has a small Ce and is weakened, an edge is not.
    """
    ce = averaged(s, border)
    w = float(cv2.norm(ce, cv2.NORM_INF)) / coefficient + offset
    return np.asarray(cv2.multiply(s, ce, dst=ce, scale=1 / w)), w


class Adaptation:
    """Spike-frequency adaptation: the adapted potential follows rises, and decays without them.

    `tau`, the time constant, and `ti`, the time per frame, are in ms.
    """

    def __init__(self, tau: float, ti: float) -> None:
        self._share = tau / (tau + ti)
        self.potential = self.adapted = 0.0

    def step(self, potential: float) -> float:
        """Take the potential of a frame, 0.5 to 1; return the adapted one, 0.5 to 1."""
        rise = potential - self.potential
        kept = self.adapted + rise if rise <= 0.003 else potential
        self.potential = potential
        self.adapted = max(self._share * kept, 0.5)
        return self.adapted


def spikes(adapted: float, gain: float, threshold: float) -> int:
    """Return the number of spikes of a frame, ``floor(exp(gain (adapted - threshold)))``."""
    return math.floor(math.exp(gain * (adapted - threshold)))
