"""Contact sheets: a stimulus at a glance."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    Grey = NDArray[np.uint8]

FRAMES = 8
BORDER = 128


def sheet_frames(count: int, shown: int = FRAMES) -> list[int]:
    """Choose evenly spaced frames, the first and the last among them.

    Parameters
    ----------
    count : int
        Frames of the stimulus.
    shown : int
        How many to show at most.

    Returns
    -------
    list of int
        Rising, without repeats.
    """
    if count == 1 or shown == 1:
        return [0]
    return sorted({round(index * (count - 1) / (shown - 1)) for index in range(shown)})


def contact_sheet(pictures: Sequence[Grey], side: int = 160, columns: int = 4) -> Grey:
    """Put pictures side by side.

    Parameters
    ----------
    pictures : sequence of ndarray
        uint8 (h, w), all of one size.
    side : int
        Longer side of each in the sheet, in pixels.
    columns : int
        How many to a row.

    Returns
    -------
    ndarray
        uint8, on a mid-grey ground, in reading order.
    """
    small = [_reduced(picture, side) for picture in pictures]
    height, width = small[0].shape
    columns = min(columns, len(small))
    rows = math.ceil(len(small) / columns)
    sheet = np.full((rows * (height + 2) + 2, columns * (width + 2) + 2), BORDER, dtype=np.uint8)
    for index, picture in enumerate(small):
        top = 2 + index // columns * (height + 2)
        left = 2 + index % columns * (width + 2)
        sheet[top : top + height, left : left + width] = picture
    return sheet


def _reduced(picture: Grey, side: int) -> Grey:
    """Average over areas, which need not be whole pixels."""
    scale = side / max(picture.shape)
    if scale >= 1:
        return picture
    rows, columns = (_averaging(size, max(1, round(size * scale))) for size in picture.shape)
    return np.asarray(np.rint(rows @ picture @ columns.T), dtype=np.uint8)


def _averaging(size: int, reduced: int) -> NDArray[np.float64]:
    """Matrix whose rows average neighbouring samples: (reduced, size)."""
    borders = np.arange(reduced + 1) * (size / reduced)
    cells = np.arange(size)
    overlap = np.minimum(borders[1:, None], cells + 1) - np.maximum(borders[:-1, None], cells)
    return np.asarray(np.clip(overlap, 0, None) * (reduced / size))
