"""The working size, and planes brought to it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from oppload_cli.errors import ParameterError

if TYPE_CHECKING:
    from av.video.reformatter import VideoReformatter
    from numpy.typing import NDArray

    Plane = NDArray[Any]  # of uint8 or uint16

    from oppload_cli.video.frames import InputFacts

WELL_ABOVE = 1.5  # times: from here on swscale's averages are as good as OpenCV's
AREA_EXACTLY = 0x20 | 0x40000 | 0x80000  # SWS_AREA, SWS_ACCURATE_RND, SWS_BITEXACT
MOST_PIXELS = 1 << 25  # of a working frame: the models need about 100 bytes for each


class WorkingSize(NamedTuple):
    """The size at which the models see an input.

    Attributes
    ----------
    width, height : int
        In working pixels.
    scale_x, scale_y : float
        Source pixels per working pixel.
    """

    width: int
    height: int
    scale_x: float
    scale_y: float

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width, as arrays have it."""
        return self.height, self.width


def working_size(facts: InputFacts, height: int | None) -> WorkingSize:
    """Return the working size of an input.

    Parameters
    ----------
    facts : InputFacts
        Gives the displayed size.
    height : int or None
        Working height in pixels, at least 1; the width follows. None keeps the
        native size.

    Returns
    -------
    WorkingSize

    Raises
    ------
    ParameterError
        If the working frame would be too large.
    """
    if height is None:
        size = WorkingSize(facts.width, facts.height, 1.0, 1.0)
    else:
        width = max(1, round(facts.width * height / facts.height))
        size = WorkingSize(width, height, facts.width / width, facts.height / height)
    if size.width * size.height > MOST_PIXELS:
        raise ParameterError(
            f"{facts.name}: a working size of {size.width} x {size.height} is too large; "
            f"choose a smaller --height"
        )
    return size


class Resizing:
    """Brings planes to the working size by area averaging, as they are coded: not turned.

    Parameters
    ----------
    size : WorkingSize
        The target, as displayed.
    rotation : int
        Counter-clockwise turn that is still to come, in degrees.
    """

    def __init__(self, size: WorkingSize, rotation: int) -> None:
        sideways = rotation in (90, 270)
        self._coded = (size.height, size.width) if sideways else (size.width, size.height)
        self._scaler: VideoReformatter | None = None

    def __call__(self, plane: Plane) -> Plane:
        """Return a plane at the working size.

        Parameters
        ----------
        plane : ndarray of uint8 or uint16, shape (rows, columns)
            Of any size; one of the working size is returned as it is.

        Returns
        -------
        ndarray of the same dtype, shape (height, width) before it is turned
            Lasts until the next one.
        """
        rows, columns = plane.shape
        width, height = self._coded
        if (columns, rows) == (width, height):
            return plane
        if columns >= WELL_ABOVE * width and rows >= WELL_ABOVE * height:
            return self._averaged(plane)
        shrinks = width <= columns and height <= rows
        import cv2  # noqa: PLC0415 - as below

        method = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
        return np.asarray(cv2.resize(plane, self._coded, interpolation=method), plane.dtype)

    def _averaged(self, plane: Plane) -> Plane:
        """Average areas by swscale: within 0.7 of a code of the exact mean, 7 times as fast."""
        # Who decodes has no use for OpenCV otherwise, and who is given small planes none for PyAV.
        import av  # noqa: PLC0415
        from av.video.reformatter import VideoReformatter  # noqa: PLC0415

        self._scaler = self._scaler or VideoReformatter()
        kind = "gray" if plane.dtype == np.uint8 else "gray16le"
        frame = av.VideoFrame.from_numpy_buffer(np.ascontiguousarray(plane), kind)
        small = self._scaler.reformat(
            frame, *self._coded, kind, interpolation=AREA_EXACTLY, threads=1
        )
        samples = small.planes[0].line_size // plane.itemsize
        rows = np.frombuffer(memoryview(small.planes[0]), plane.dtype).reshape(-1, samples)
        view: Plane = rows[: self._coded[1], : self._coded[0]]
        return view
