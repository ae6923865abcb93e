"""Folders and patterns of images as a source of pictures."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from oppload_cli.errors import SourceError
from oppload_cli.video.frames import DecodeFacts, InputFacts, Picture
from oppload_cli.video.image_size import declared_size
from oppload_cli.video.inputs import IMAGE_SUFFIXES
from oppload_cli.video.limits import check_pixels

if TYPE_CHECKING:
    from collections.abc import Iterator
    from fractions import Fraction

    from numpy.typing import NDArray

NUMBER = re.compile(r"%0?(\d*)d")


class ImageSource:
    """A sequence of images, in the order of the numbers in their names.

    Parameters
    ----------
    name : str
        A folder, or a pattern such as ``frames_%04d.png``.
    frame_rate : Fraction
        Frames per second: images carry no times.

    Raises
    ------
    SourceError
        If there is no image, or the first cannot be read.
    """

    def __init__(self, name: str, frame_rate: Fraction) -> None:
        self.decode = DecodeFacts()
        self.stopping = False
        self._rate = frame_rate
        self._paths = image_paths(name)
        first = self._first_readable()
        height, width = first.shape[:2]
        self.facts = InputFacts(
            name=name,
            kind="images",
            width=width,
            height=height,
            frame_rate=frame_rate,
            frames_declared=len(self._paths),
            codec=self._paths[0].suffix.lower().lstrip("."),
            pixel_format="gray",
            bytes=sum(map(_bytes, self._paths)),
        )

    def pictures(self) -> Iterator[Picture]:
        """Yield the images that can be read; the others are counted as failures.

        Yields
        ------
        Picture
            Its index and time are those of its place in the sequence.
        """
        size = (self.facts.height, self.facts.width)
        for index, path in enumerate(self._paths):
            if self.stopping:
                return
            colour = self._image(path)
            if colour is None:
                continue
            self.decode.decoded += 1
            if colour.shape[:2] != size:
                size = (colour.shape[0], colour.shape[1])
                self.decode.note(f"the size becomes {size[1]} x {size[0]} at {path.name}")
            # Grey by the Rec. 601 weights.
            plane = np.asarray(cv2.cvtColor(colour, cv2.COLOR_BGR2GRAY), np.uint8)
            yield Picture(index, float(index / self._rate), plane, original=colour)

    def finish(self) -> None:
        """Nothing is missing that has not failed."""

    def close(self) -> None:
        """Nothing is held open."""

    def _first_readable(self) -> NDArray[np.uint8]:
        for path in self._paths:
            colour = self._image(path)
            if colour is not None:
                self.decode = DecodeFacts()  # they are read, and counted, once more
                return colour
        raise SourceError(
            f"{self._paths[0]}: none of these images can be read ({self.decode.messages[0]}); "
            f"check or convert them"
        )

    def _image(self, path: Path) -> NDArray[np.uint8] | None:
        """Return an image, or None, counted, if it cannot be read."""
        try:
            return _read(path)
        except (OSError, SourceError, cv2.error) as error:
            reason = f" ({error})" if isinstance(error, SourceError) else ""
            self.decode.failed(f"{path.name} is not an image that can be read{reason}")
            return None


def image_paths(name: str) -> list[Path]:
    """Return the images of a folder or a pattern, in the order of their numbers.

    Parameters
    ----------
    name : str
        A folder, or a pattern with one ``%d`` or ``%04d`` in its file name.

    Returns
    -------
    list of Path

    Raises
    ------
    SourceError
        If there is none.
    """
    folder, accepted = Path(name), re.compile(r".*", re.DOTALL)
    pattern = NUMBER.search(folder.name)
    if pattern and not folder.exists():
        accepted = _pattern(folder.name, pattern)
        folder = folder.parent
    try:
        paths = [
            path
            for path in folder.iterdir()
            if path.suffix.lower() in IMAGE_SUFFIXES and accepted.fullmatch(path.name)
        ]
    except (FileNotFoundError, NotADirectoryError) as error:
        raise SourceError(f"{name}: no such folder; check the path") from error
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise SourceError(f"{name}: cannot be read ({reason}); check the path") from error
    if not paths:
        raise SourceError(f"{name}: no image there; give a folder or a pattern of images")
    return sorted(paths, key=numerical_order)


def numerical_order(path: Path) -> tuple[list[tuple[int, str]], str]:
    """Return a key that sorts ``f2`` before ``f10``.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    tuple
        To compare with another file's.
    """
    parts = re.split(r"(\d+)", path.name)
    return [(int(part), "") if part.isdigit() else (-1, part) for part in parts], path.name


def _pattern(name: str, number: re.Match[str]) -> re.Pattern[str]:
    width = number.group(1)
    digits = rf"\d{{{width},}}" if width else r"\d+"
    return re.compile(re.escape(name[: number.start()]) + digits + re.escape(name[number.end() :]))


def _read(path: Path) -> NDArray[np.uint8]:
    """Return an image, 8 bits of blue, green and red."""
    data = path.read_bytes()
    size = declared_size(data)
    if size is None:
        raise SourceError("neither PNG, JPEG, BMP, PNM, TIFF nor WebP, or cut")
    check_pixels(path.name, *size)
    colour = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    if colour is None:
        raise SourceError("damaged")
    return np.asarray(colour, np.uint8)


def _bytes(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError:  # it has vanished, or is a link to nothing: reading it will say so
        return 0
