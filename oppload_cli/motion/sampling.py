"""What surrounds the search for flow: frames reduced for it, its result on a grid of cells.

By compiled loops where they were built, with the same bits as by OpenCV.
"""

from __future__ import annotations

import ctypes
from typing import TYPE_CHECKING, NamedTuple

import cv2
import numpy as np

from oppload_cli.motion.vectors import length
from oppload_cli.native.library import address, compiled, library

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from oppload_cli.motion.parameters import RmoParams

    Grey = NDArray[np.uint8]
    Points = NDArray[np.float64]  # shape (..., 2): x, y

CHANNELS = 4  # of what is averaged over a cell: x, y, change and nothing


class MotionVectors(NamedTuple):
    """Motion vectors of one frame, in px of the working frame, y down.

    Attributes
    ----------
    starts : ndarray of float, shape (n, 2)
        Where each vector starts (x, y): the centre of its grid cell.
    vectors : ndarray of float, shape (n, 2)
        Motion since the frame before (x, y), px/frame.
    """

    starts: Points
    vectors: Points


class Cells(NamedTuple):
    """A grid of cells over a part of the frame.

    Attributes
    ----------
    rows, columns : int
        How many, at least 1.
    reduction : int
        Pixels per sample of the reduced part.
    left, top : int
        Of the part, in pixels.
    """

    rows: int
    columns: int
    reduction: int
    left: int
    top: int


class _Job(ctypes.Structure):
    """``struct sampling`` of flow.c."""

    _fields_ = (
        ("before", ctypes.c_void_p),
        ("now", ctypes.c_void_p),
        ("flow", ctypes.c_void_p),
        ("rows", ctypes.c_int),
        ("columns", ctypes.c_int),
        ("cell_rows", ctypes.c_int),
        ("cell_columns", ctypes.c_int),
        ("reduction", ctypes.c_int),
        ("left", ctypes.c_double),
        ("top", ctypes.c_double),
        ("minimum_speed", ctypes.c_double),
        ("minimum_change", ctypes.c_double),
        ("starts", ctypes.c_void_p),
        ("vectors", ctypes.c_void_p),
        ("kept", ctypes.c_int),
    )


def reduce(frame: Grey, reduction: int, out: Grey) -> None:
    """Average squares of pixels.

    Parameters
    ----------
    frame : ndarray of uint8, shape (rows * reduction, columns * reduction)
        Its rows may stand apart.
    reduction : int
        Side of a square: 1, 2 or 4 pixels.
    out : ndarray of uint8, shape (rows, columns)
        Takes the means, rounded as OpenCV does it.
    """
    rows, columns = out.shape
    if reduction > 1 and library():
        line = np.empty(reduction * columns, np.uint16)
        compiled().reduce(
            *(address(frame), frame.strides[0], reduction, rows, columns),
            *(address(out), address(line)),
        )
    else:
        cv2.resize(frame, (columns, rows), dst=out, interpolation=cv2.INTER_AREA)


def sampled(
    before: Grey, now: Grey, flow: NDArray[np.float32], cells: Cells, params: RmoParams
) -> MotionVectors:
    """Average flow over cells, and keep the vectors of those that move and change enough.

    Parameters
    ----------
    before, now : ndarray of uint8, shape (h, w)
        Reduced frames.
    flow : ndarray of float32, shape (h, w, 2)
        From the one to the other (x, y), in their pixels.
    cells : Cells
        The grid.
    params : RmoParams
        Gives minimum speed and change.

    Returns
    -------
    MotionVectors
        In pixels of the working frame.
    """
    sides = now.shape[0] / cells.rows, now.shape[1] / cells.columns  # of a cell, in samples
    # OpenCV goes other ways where they are whole, and where cells are smaller than samples.
    alike = min(sides) >= 1 and not all(side.is_integer() for side in sides)
    return (_compiled if alike and library() else _portable)(before, now, flow, cells, params)


def _compiled(
    before: Grey, now: Grey, flow: NDArray[np.float32], cells: Cells, params: RmoParams
) -> MotionVectors:
    rows, columns = now.shape
    starts, vectors = np.empty((2, cells.rows * cells.columns, 2))
    shares = np.empty((2 * (rows + columns + cells.rows + cells.columns), 2))
    means = np.empty((2 * cells.columns, CHANNELS), np.float32)
    job = _Job(
        *(address(before), address(now), address(flow), rows, columns, *cells),
        *(params.minimum_speed, 255.0 * params.minimum_change),
        *(address(starts), address(vectors)),
    )
    compiled().sample(ctypes.addressof(job), address(shares), address(means))
    return MotionVectors(starts[: job.kept], vectors[: job.kept])


def _portable(
    before: Grey, now: Grey, flow: NDArray[np.float32], cells: Cells, params: RmoParams
) -> MotionVectors:
    starts = _centres(now.shape[0] * cells.reduction, now.shape[1] * cells.reduction, cells)
    vectors = _means(flow, cells) * cells.reduction
    change = _means(cv2.absdiff(before, now).astype(np.float32), cells)
    kept = length(vectors) >= params.minimum_speed
    kept &= change >= 255.0 * params.minimum_change
    return MotionVectors(starts[kept], vectors[kept])


def _centres(height: int, width: int, cells: Cells) -> Points:
    x = (np.arange(cells.columns) + 0.5) * width / cells.columns - 0.5 + cells.left
    y = (np.arange(cells.rows) + 0.5) * height / cells.rows - 0.5 + cells.top
    return np.stack(np.meshgrid(x, y), axis=-1)


def _means(image: NDArray[np.float32], cells: Cells) -> NDArray[np.float64]:
    size = cells.columns, cells.rows
    return cv2.resize(image, size, interpolation=cv2.INTER_AREA).astype(np.float64)
