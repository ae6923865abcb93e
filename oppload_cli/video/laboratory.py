"""Reads the uncompressed videos of laboratories: FlyMovieFormat, micro FlyMovieFormat, Norpix.

Each function opens one format and returns a :class:`Stack`, whose pictures are read one by one.

Sources: the specification of ``.fmf`` and the reader of ``.ufmf`` of the motmot project
(Straw & Dickinson 2009), Branson's description of ``.ufmf`` version 4, and the header of Norpix's
StreamPix as PIMS reads it.
"""

from __future__ import annotations

import struct
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np

from oppload_cli.errors import SourceError
from oppload_cli.video.frames import check_pixels

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from numpy.typing import NDArray


@dataclass(frozen=True)
class Stack:
    """Pictures of one file, in order.

    Attributes
    ----------
    pictures : iterator of (float or None, ndarray)
        The time of each picture in seconds, if the file has it, and its values: uint8, uint16 or
        float, shape (rows, columns), or with a last axis of red, green and blue.
    count : int or None
        The number of pictures that the file declares; None if it declares none.
    rate : Fraction or None
        The frames per second that the file declares.
    bits : int or None
        The bits that a sample uses; None if all.
    close : callable
        Closes the file; may be called twice.
    """

    pictures: Iterator[tuple[float | None, NDArray[Any]]]
    count: int | None
    rate: Fraction | None
    bits: int | None
    close: Callable[[], object]


class DamagedError(Exception):
    """A picture cannot be read: its file ends within it, or contradicts itself."""


_LONGEST_CODING = 64  # bytes of the word for the kind of pictures


def open_fmf(path: Path) -> Stack:
    """Open a file of FlyMovieFormat, version 1 or 3, with grey pictures of 8 bits."""
    with _head_of(path) as file:
        (version,) = _unpack(file, "<I")
        coding = b"MONO8"
        if version == 3:
            coding = _read(file, min(_unpack(file, "<I")[0], _LONGEST_CODING))
            _unpack(file, "<I")  # bits per pixel, as the coding says
        elif version != 1:
            raise SourceError(f"{path}: is no FlyMovieFormat of version 1 or 3; check the file")
        if coding.upper() not in {b"MONO8", b"RAW8"}:
            raise SourceError(
                f"{path}: has pictures of the kind {coding.decode('ascii', 'replace')}, and only "
                "MONO8 can be read; convert the file to an uncompressed video"
            )
        rows, columns, _, count = _unpack(file, "<IIQQ")

    def pictures() -> Iterator[tuple[float, NDArray[Any]]]:
        while (head := file.read(8)) != b"":
            (time_s,) = struct.unpack("<d", _complete(head, 8))
            yield time_s, _plane(file, rows, columns)

    return Stack(pictures(), count or None, None, None, file.close)


_KEYFRAME, _FRAME = 0, 1  # chunks of micro FlyMovieFormat; the index after them is not needed


def open_ufmf(path: Path) -> Stack:
    """Open a file of micro FlyMovieFormat, version 2 to 4, of grey pictures.

    It stores a background now and then, and for each picture only the boxes that differ from it.
    """
    with _head_of(path) as file:
        magic, version = _unpack(file, "<4sI")
        if magic != b"ufmf" or version not in {2, 3, 4}:
            raise SourceError(
                f"{path}: is no micro FlyMovieFormat of version 2 to 4; convert it with any2ufmf"
            )
        _unpack(file, "<IHH" if version == 2 else "<QHH")  # place of the index, largest box
        fixed = version == 4 and _unpack(file, "<B")[0]
        coding = _read(file, _unpack(file, "<B")[0])
        if fixed or coding.upper() != b"MONO8":
            kind = "boxes of one size" if fixed else coding.decode("ascii", "replace")
            raise SourceError(
                f"{path}: has {kind}, which cannot be read; convert it to an uncompressed video"
            )

    def pictures() -> Iterator[tuple[float, NDArray[Any]]]:
        background: NDArray[Any] | None = None
        while (chunk := file.read(1)) != b"":
            if chunk[0] == _KEYFRAME:
                kind = _read(file, _unpack(file, "<B")[0])
                values, columns, rows, _ = _unpack(file, "<cHHd")
                image = _plane(file, rows, columns, "<f4" if values == b"f" else "u1")
                if kind == b"mean" or background is None:
                    background = np.clip(np.nan_to_num(image), 0, 255).astype(np.uint8)
            elif chunk[0] == _FRAME and background is not None:
                time_s, boxes = _unpack(file, "<dI" if version == 4 else "<dH")
                picture = background.copy()
                for _ in range(boxes):
                    x, y, columns, rows = _unpack(file, "<HHHH")
                    box = _plane(file, rows, columns)
                    if x + columns > picture.shape[1] or y + rows > picture.shape[0]:
                        raise DamagedError("a box reaches beyond the picture")
                    picture[y : y + rows, x : x + columns] = box
                yield time_s, picture
            else:
                return  # the index

    return Stack(pictures(), None, None, None, file.close)


_NORPIX, _MONO = 0xFEED, 100
_HEADS = {True: 8192, False: 1024}  # bytes, from version 5 on, and before


def open_norpix(path: Path) -> Stack:
    """Open a sequence of Norpix's StreamPix with uncompressed grey pictures of 8 or 16 bits."""
    with _head_of(path) as file:
        head = _read(file, 592)
        magic, version = struct.unpack_from("<I24xi", head)
        if magic != _NORPIX:
            raise SourceError(f"{path}: is no sequence of Norpix; convert it to a video")
        columns, rows, stored, used, size, kind, _, _, step = struct.unpack_from("<9I", head, 548)
        (rate,) = struct.unpack_from("<d", head, 584)
        if kind != _MONO or stored not in {8, 16} or step < size + 6:
            raise SourceError(
                f"{path}: has pictures in colour or compressed ones; export the sequence from "
                "StreamPix as an uncompressed AVI"
            )
    fine = version >= 5
    first, end = _HEADS[fine], path.stat().st_size
    values = "u1" if stored == 8 else "<u2"

    def pictures() -> Iterator[tuple[float, NDArray[Any]]]:
        for place in range(first, end, step):
            file.seek(place)
            plane = _plane(file, rows, columns, values)
            seconds, *parts = _unpack(file, "<IHH" if fine else "<IH")
            yield seconds + sum(part / 1000**power for power, part in enumerate(parts, 1)), plane

    declared = Fraction(rate).limit_denominator(1001) if 0 < rate < 1e6 else None
    bits = used if 8 < used < 16 and stored == 16 else None
    return Stack(pictures(), max(0, -(-(end - first) // step)), declared, bits, file.close)


@contextmanager
def _head_of(path: Path) -> Iterator[BinaryIO]:
    """Open a file whose head the caller reads; close it if that fails."""
    file = path.open("rb")
    try:
        yield file
    except DamagedError as error:
        file.close()
        raise SourceError(f"{path}: ends within its head; copy it again") from error
    except BaseException:
        file.close()
        raise


def _unpack(file: BinaryIO, layout: str) -> tuple[Any, ...]:
    return struct.unpack(layout, _read(file, struct.calcsize(layout)))


def _read(file: BinaryIO, size: int) -> bytes:
    return _complete(file.read(size), size)


def _complete(content: bytes, size: int) -> bytes:
    if len(content) != size:
        raise DamagedError("the file ends within a picture")
    return content


def _plane(file: BinaryIO, rows: int, columns: int, kind: str = "u1") -> NDArray[Any]:
    if 0 in {rows, columns}:
        raise DamagedError("its size is 0")
    check_pixels(file.name, columns, rows)
    content = _read(file, rows * columns * np.dtype(kind).itemsize)
    return np.frombuffer(content, kind).reshape(rows, columns)
