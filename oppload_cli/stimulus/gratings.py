"""Gratings and plaids, averaged exactly over each pixel."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]

# below this a pixel is flat along that direction, and the average over it is the value
FLAT = 1e-6


def square_wave(phase: Floats, width: Floats, depth: Floats) -> Floats:
    """Return a square wave averaged over pixels.

    A pixel, seen along the grating's axis, is a trapezoid: two boxes convolved. The
    average is therefore a second difference of the wave's second integral.

    Parameters
    ----------
    phase : ndarray
        Phase at the pixels' centres, in cycles; +1 in the first half of a cycle.
    width, depth : ndarray
        Widths of the two boxes in cycles: how much the phase changes across the pixel
        along x and along y. They broadcast against `phase`.

    Returns
    -------
    ndarray
        -1 to 1.
    """
    width, depth = np.broadcast_arrays(np.abs(width), np.abs(depth))
    long, short = np.maximum(width, depth), np.minimum(width, depth)
    if np.max(short) < FLAT:
        return _box(phase, np.maximum(long, FLAT))
    short = np.maximum(short, FLAT)
    # a FLAT by FLAT difference would be all rounding error
    long = np.maximum(long, 1e-4)
    outer, inner = (long + short) / 2, (long - short) / 2
    second = (
        _twice_integrated(phase + outer)
        - _twice_integrated(phase + inner)
        - _twice_integrated(phase - inner)
        + _twice_integrated(phase - outer)
    )
    return np.asarray(np.clip(second / (long * short), -1.0, 1.0))


def sine_wave(phase: Floats, width: Floats, depth: Floats) -> Floats:
    """Return a sine wave averaged over pixels.

    Parameters
    ----------
    phase, width, depth : ndarray
        As for :func:`square_wave`.

    Returns
    -------
    ndarray
        -1 to 1.
    """
    return np.asarray(np.sin(2 * np.pi * phase) * np.sinc(width) * np.sinc(depth))


def _box(phase: Floats, width: Floats) -> Floats:
    return (_integrated(phase + width / 2) - _integrated(phase - width / 2)) / width


def _integrated(phase: Floats) -> Floats:
    """Integral of the square wave: a triangle from 0 to 1/2, periodic."""
    cycle = phase - np.floor(phase)
    return 0.5 - np.abs(cycle - 0.5)


def _twice_integrated(phase: Floats) -> Floats:
    """Integral of the triangle less its mean 1/4, periodic; that mean cancels."""
    cycle = phase - np.floor(phase)
    late = cycle - 0.5
    return np.where(cycle < 0.5, cycle * (cycle / 2 - 0.25), late * (0.25 - late / 2))
