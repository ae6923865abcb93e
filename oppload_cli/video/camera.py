"""Cameras, through OpenCV."""

from __future__ import annotations

import time
from fractions import Fraction
from typing import TYPE_CHECKING

import cv2
import numpy as np

from oppload_cli.errors import SourceError
from oppload_cli.video.frames import DecodeFacts, InputFacts, Picture

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray


class CameraSource:
    """A camera of this computer, ``camera:0``, until it is closed or fails.

    Parameters
    ----------
    name : str
        ``camera:`` and the camera's number.

    Raises
    ------
    SourceError
        If the number is none, or the camera gives no picture.
    """

    def __init__(self, name: str) -> None:
        number = name.partition(":")[2]
        if not number.isdigit():
            raise SourceError(f"{name}: no camera's name; write camera:0, camera:1 and so on")
        self.decode = DecodeFacts()
        self.stopping = False
        self._capture = cv2.VideoCapture(int(number))
        first = self._read()
        if first is None:
            self._capture.release()
            raise SourceError(
                f"{name}: this camera gives no picture; check that it is there and not in use"
            )
        height, width = first.shape[:2]
        rate = self._capture.get(cv2.CAP_PROP_FPS)
        self.facts = InputFacts(
            name=name,
            kind="camera",
            width=width,
            height=height,
            frame_rate=Fraction(rate).limit_denominator(1001) if rate > 0 else None,
            frames_declared=None,
            codec="raw",
            pixel_format="bgr24",
        )
        self._first: NDArray[np.uint8] | None = first

    def pictures(self) -> Iterator[Picture]:
        """Yield pictures as they come; the time is that of their arrival.

        Yields
        ------
        Picture
        """
        start = time.monotonic()
        colour = self._first
        while colour is not None and not self.stopping:
            index = self.decode.decoded
            self.decode.decoded += 1
            time_s = time.monotonic() - start if index else 0.0
            plane = np.asarray(cv2.cvtColor(colour, cv2.COLOR_BGR2GRAY), np.uint8)
            yield Picture(index, time_s, plane, original=colour)
            colour = self._read()

    def finish(self) -> None:
        """Count a failure: a camera that stops by itself has failed."""
        self.decode.failed("the camera stopped")

    def close(self) -> None:
        """Release the camera; may be called twice."""
        self._capture.release()

    def _read(self) -> NDArray[np.uint8] | None:
        read, colour = self._capture.read()
        return np.asarray(colour, np.uint8) if read else None
