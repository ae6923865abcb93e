"""Exact repeats of a frame."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from oppload_cli.video.parameters import RepeatParams

SOME_ROWS = 16  # every so many


class Repeats:
    """Tells copies that a converter made from a scene that stands still.

    Content of 10 frames/s in a file of 30 repeats each frame twice: fed to the
    models it would stand still, and then jump. So a few exact repeats in a row are
    passed over. A longer run is a still scene, which the models must see.

    Parameters
    ----------
    params : RepeatParams
    """

    def __init__(self, params: RepeatParams) -> None:
        self._most = params.most
        self._run = 0
        self._last: NDArray[np.float32] | None = None
        self.count = 0

    def step(self, luma: NDArray[np.float32]) -> tuple[bool, bool]:
        """Take the next frame.

        Parameters
        ----------
        luma : ndarray of float32, shape (height, width)
            Luminance at the working size; kept, not copied.

        Returns
        -------
        repeat : bool
            Whether it equals the frame before.
        passed_over : bool
            Whether the models shall not see it.
        """
        repeat = self._last is not None and _equal(luma, self._last)
        self._last = luma
        self._run = self._run + 1 if repeat else 0
        self.count += repeat
        return repeat, repeat and self._run <= self._most


def _equal(one: NDArray[np.float32], other: NDArray[np.float32]) -> bool:
    """Compare frames; a few rows tell most of them apart."""
    return np.array_equal(one[::SOME_ROWS], other[::SOME_ROWS]) and np.array_equal(one, other)
