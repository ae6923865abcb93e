"""Whether a file stops before its own end, seen from its first and last bytes.

Decoding does not tell: a file that is cut ends like one that is whole.
"""

from __future__ import annotations

import os
import struct
from contextlib import suppress
from pathlib import Path
from typing import IO

TS_PACKETS = (188, 192, 204)  # plain, with time codes, with error correction
EBML, SEGMENT = 0x1A45DFA3, 0x18538067


def is_cut_short(path: str, container: str) -> bool:
    """Tell whether a file has lost its end.

    Parameters
    ----------
    path : str
        A file.
    container : str
        Name of its demuxer, such as ``matroska,webm``.

    Returns
    -------
    bool
        False also where the container has no end that could be recognised.
    """
    check = CHECKS.get(container)
    if check is None:
        return False
    # What has vanished, or is too short to tell, is not called cut.
    with suppress(OSError, struct.error), Path(path).open("rb") as file:
        return check(file, file.seek(0, os.SEEK_END))
    return False


def _matroska(file: IO[bytes], size: int) -> bool:
    # The segment says how long it is, unless it was written to a pipe.
    position = 0
    for wanted in (EBML, SEGMENT):
        file.seek(position)
        head = file.read(12)
        (element,) = struct.unpack_from(">I", head)
        if element != wanted:
            return False
        length = 9 - head[4].bit_length()
        content = int.from_bytes(head[4 : 4 + length]) & ((1 << 7 * length) - 1)
        if content == (1 << 7 * length) - 1:
            return False  # unknown
        position += 4 + length + content
    return position > size


def _flv(file: IO[bytes], size: int) -> bool:
    # Each tag is followed by its size: the last four bytes lead to a tag's head.
    file.seek(size - 4)
    (tag,) = struct.unpack(">I", file.read(4))
    if not 11 <= tag <= size - 4:
        return True
    file.seek(size - 4 - tag + 1)
    return bool(int.from_bytes(file.read(3)) != tag - 11)


def _gif(file: IO[bytes], size: int) -> bool:
    file.seek(max(0, size - 64))
    return not file.read().rstrip(b"\0\r\n").endswith(b";")


def _mjpeg(file: IO[bytes], size: int) -> bool:
    file.seek(max(0, size - 64))
    return not file.read().rstrip(b"\0\r\n").endswith(b"\xff\xd9")


def _transport_stream(_file: IO[bytes], size: int) -> bool:
    return all(size % packet for packet in TS_PACKETS)


CHECKS = {
    "matroska,webm": _matroska,
    "flv": _flv,
    "gif": _gif,
    "mjpeg": _mjpeg,
    "mpegts": _transport_stream,
}
