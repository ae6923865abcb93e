"""Parts of the work on one frame, side by side on the cores that there are."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

import cv2

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from concurrent.futures import ThreadPoolExecutor

BAND = 120  # rows that one thread works on at a time: what they need stays in the cache
LARGE = 1 << 18  # pixels: below, handing work over costs more than it saves


def is_large(shape: tuple[int, int]) -> bool:
    """Tell whether more than one thread is of use.

    Parameters
    ----------
    shape : tuple of int
        Height and width of the frames.

    Returns
    -------
    bool
    """
    return shape[0] * shape[1] >= LARGE


def bands_of(shape: tuple[int, int]) -> list[tuple[int, int]]:
    """Cut the rows of a frame into bands, where more than one thread is of use.

    Parameters
    ----------
    shape : tuple of int
        Height and width of the frames.

    Returns
    -------
    list of (int, int)
        First row of each band, and the one after its last.
    """
    height = shape[0]
    band = BAND if is_large(shape) else height
    return [(first, min(first + band, height)) for first in range(0, height, band)]


class Crew:
    """Runs parts that do not depend on each other at once, where frames are large.

    It has as many threads as OpenCV, which takes its number from the affinity mask
    or from ``cv2.setNumThreads``. Each part is done by one thread, whatever their
    number: the results are the same bytes.

    Parameters
    ----------
    shape : tuple of int
        Height and width of the frames.
    """

    def __init__(self, shape: tuple[int, int]) -> None:
        self._threads = cv2.getNumThreads() if is_large(shape) else 1

    def __call__(self, *parts: Callable[[], object]) -> None:
        """Run the parts, and return when all are done.

        Parameters
        ----------
        *parts : callable
            Each takes nothing.
        """
        left = iter(parts)  # for all: whoever is done takes the next part
        if self._threads == 1 or len(parts) == 1:
            _work(left)
            return
        helpers = min(self._threads, len(parts)) - 1
        helped = [_pool(helpers).submit(_work, left) for _ in range(helpers)]
        _work(left)
        for done in helped:
            done.result()


def _work(parts: Iterator[Callable[[], object]]) -> None:
    for part in parts:
        part()


@cache
def _pool(threads: int) -> ThreadPoolExecutor:
    from concurrent.futures import ThreadPoolExecutor  # noqa: PLC0415 - for large frames alone

    return ThreadPoolExecutor(threads, "oppload-models")
