"""Finds faults of video files that FFmpeg does not report, such as a missing end.

Each check reads the structure of one kind of container. A check reads the content only if a
checksum covers it.
"""

from __future__ import annotations

import errno
import os
import struct
import zlib
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import IO, TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

CUT = "the file ends too early"
WRONG = "a checksum of the file is wrong"
BROKEN = "the structure of the file is damaged"
FURTHER = "a further video begins after the end of the first one, and is not read"
_PIECE = 1 << 20  # bytes that are read at a time
MOST_PARTS = 2_000_000  # read in some seconds; hours of video have fewer parts


@dataclass
class _Reading:
    """A file that has been demuxed to its end."""

    file: IO[bytes]
    size: int  # bytes
    read_to: int  # position of the byte after the last video packet; 0 if it is not known
    stream: int  # identifier of the video in the container, such as a transport stream's PID
    _parts: int = 0

    def at(self, position: int, count: int) -> bytes:
        """Return `count` bytes, or fewer at the end of the file.

        Raises OSError after `MOST_PARTS` calls, because a hostile file could make a check endless.
        """
        self._parts += 1
        if self._parts > MOST_PARTS:
            raise OSError(errno.EFBIG, "too many parts")
        self.file.seek(position)
        return self.file.read(count)


def fault_of(path: str, container: str, *, read_to: int = 0, stream: int = 0) -> str | None:
    """Return the first fault in the structure of a file, as a sentence; None if it finds none.

    `container` is the name of FFmpeg's demuxer; some containers have no check. See
    :class:`_Reading` for `read_to` and `stream`.
    """
    check = _CHECKS.get(container)
    if check is None:
        return None
    # A file that no longer exists, or is too short for the check, counts as without fault.
    with suppress(OSError, struct.error, IndexError), Path(path).open("rb") as file:
        size = file.seek(0, os.SEEK_END)
        return check(_Reading(file, size, read_to, stream))
    return None


_EBML, _SEGMENT = 0x1A45DFA3, 0x18538067
_CHECKSUM = b"\xbf\x84"  # an EBML element with a checksum begins with these bytes


def _matroska(reading: _Reading) -> str | None:
    """Go through the elements of the segment, and of each element of unknown length."""
    position = 0
    while position < reading.size:
        head = reading.at(position, 12)
        if not head[0]:  # no identifier begins with 0; a file may end with zeros
            return BROKEN if any(reading.at(position, _PIECE)) else None
        id_length = 9 - head[0].bit_length()
        if id_length > 4 or len(head) < id_length + 1 or not head[id_length]:
            return CUT if len(head) < 12 else BROKEN
        length = 9 - head[id_length].bit_length()
        field = head[id_length : id_length + length]
        unknown = (1 << 7 * length) - 1  # this number means that the length is unknown
        content_length = int.from_bytes(field) & unknown
        identifier = int.from_bytes(head[:id_length])
        position += id_length + length
        if content_length != unknown and position + content_length > reading.size:
            return CUT
        if identifier == _SEGMENT or content_length == unknown:
            continue
        if identifier != _EBML and _wrong_checksum(reading, position, content_length):
            return WRONG
        position += content_length
    return CUT if position > reading.size else None


def _wrong_checksum(reading: _Reading, position: int, length: int) -> bool:
    if length < 6 or reading.at(position, 2) != _CHECKSUM:
        return False
    declared = int.from_bytes(reading.file.read(4), "little")
    checksum, rest = 0, length - 6
    while rest > 0 and (piece := reading.file.read(min(_PIECE, rest))):
        checksum = zlib.crc32(piece, checksum)
        rest -= len(piece)
    return declared != checksum


def _boxes(reading: _Reading) -> str | None:
    """Go through the boxes of MP4 and MOV; the data of a fragment must follow its index.

    A file without fragments has one index (moov), unless two files were joined.
    """
    position, kind = 0, b""
    kinds: Counter[bytes] = Counter()
    while position + 8 <= reading.size:
        head = reading.at(position, 16)
        length, kind = int.from_bytes(head[:4]), head[4:8]
        kinds[kind] += 1
        if length == 1:
            length = int.from_bytes(head[8:16])
        if length == 0 or not kind.isalnum():
            return None  # the box reaches to the end of the file, or it is no box
        position += max(length, 8)
    if position > reading.size or kind == b"moof":
        return CUT
    return FURTHER if kinds[b"moov"] > 1 and not kinds[b"moof"] else None


def _gif(reading: _Reading) -> str | None:
    """Go through the blocks up to the mark of the end."""
    head = reading.at(0, 13)
    position = 13 + _palette_bytes(head[10])
    while block := reading.at(position, 10):
        if block[0] == ord(";"):
            return None
        if block[0] == ord("!"):
            position += 2
        elif block[0] == ord(","):
            position += 11 + _palette_bytes(block[9])
        elif block[0] == 0:
            position += 1
            continue
        else:
            return BROKEN
        # The parts of a block begin with their lengths; a part of length 0 is the last one.
        while length := reading.at(position, 1):
            position += 1 + length[0]
            if not length[0]:
                break
    return CUT


def _palette_bytes(flags: int) -> int:
    return 3 << (flags & 7) + 1 if flags & 0x80 else 0


def _flv(reading: _Reading) -> str | None:
    """Go through the tags; after each tag follows its size."""
    position = int.from_bytes(reading.at(5, 4)) + 4
    total = 0
    head = reading.at(position, 11)
    while head:
        if head.startswith(b"FLV"):
            return FURTHER
        size = 11 + int.from_bytes(head[1:4])
        total += size
        position += size + 4
        if len(head) < 11 or position > reading.size:
            return CUT
        after = reading.at(position - 4, 15)  # the size, and the head of the next tag
        # Some programs leave out a byte or the head, or write the size of all tags so far.
        if int.from_bytes(after[:4]) not in {size, size - 1, size - 11, total}:
            return BROKEN
        head = after[4:]
    return None


def _mjpeg(reading: _Reading) -> str | None:
    return None if _last_bytes(reading).rstrip(b"\0\r\n").endswith(b"\xff\xd9") else CUT


def _apng(reading: _Reading) -> str | None:
    return None if b"IEND\xaeB`\x82" in _last_bytes(reading) else CUT


def _last_bytes(reading: _Reading) -> bytes:
    return reading.at(max(0, reading.size - 64), 64)


def _y4m(reading: _Reading, head: int = 0) -> str | None:
    """Check that nothing follows the last packet; the demuxer leaves out a truncated frame.

    `head` is the number of bytes before each packet that the position of the packet leaves out.
    """
    return CUT if 0 < reading.read_to < reading.size - head else None


_NUT_INDEX = bytes.fromhex("4e58dd672f23e64e")


def _nut(reading: _Reading) -> str | None:
    """Check that the file ends with its index, whose length and checksum are its last 12 bytes."""
    length = int.from_bytes(reading.at(max(0, reading.size - 12), 8))
    return None if reading.at(max(0, reading.size - length), 8) == _NUT_INDEX else CUT


_LAST_PAGE = 4


def _ogg(reading: _Reading) -> str | None:
    """Go through the pages; the last page of a stream must have the flag of the end."""
    position, flags = 0, 0
    while head := reading.at(position, 27):
        if len(head) < 27:
            return CUT
        if not head.startswith(b"OggS"):
            return BROKEN
        lengths = reading.file.read(head[26])
        content = lengths + reading.file.read(sum(lengths))
        position += 27 + len(lengths) + sum(lengths)
        if position > reading.size:
            return CUT
        if _ogg_checksum(head[:22] + bytes(4) + head[26:] + content) != head[22:26]:
            return WRONG
        flags = head[5]
    return None if flags & _LAST_PAGE else CUT


_REVERSED = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))


def _ogg_checksum(page: bytes) -> bytes:
    """Return the checksum of a page: that of zlib with the bits of each byte in reverse order."""
    checksum = zlib.crc32(page.translate(_REVERSED), 0xFFFFFFFF) ^ 0xFFFFFFFF
    return checksum.to_bytes(4).translate(_REVERSED)


_DELIMITER = 2  # type of the unit (OBU) before each picture


def _av1(reading: _Reading) -> str | None:
    """Go through the units (OBUs) of AV1, each of which has a length."""
    position = kind = 0
    while head := reading.at(position, 10):
        if head[0] & 0x83 != 0x02:
            return None  # units without lengths, or with reserved bits, cannot be checked
        start = 2 if head[0] & 4 else 1
        length = shift = 0
        for byte in head[start:]:
            start += 1
            length |= (byte & 127) << shift
            shift += 7
            if byte < 128:
                break
        else:
            return CUT
        position += start + length
        kind = head[0] >> 3
    return CUT if position > reading.size or kind == _DELIMITER else None


def _mxf(reading: _Reading) -> str | None:
    """Check that the file has its last partition; the first partition states the position."""
    head = reading.at(0, 64)
    length = 1 if head[16] < 128 else 1 + (head[16] & 127)
    (last,) = struct.unpack_from(">Q", head, 16 + length + 24)
    return CUT if last >= reading.size else None


_ASF_PROPERTIES = bytes.fromhex("a1dcab8c47a9cf118ee400c00c205365")


def _asf(reading: _Reading) -> str | None:
    """Compare the size of the file with the size in its head; a broadcast states 0."""
    head = reading.at(0, _PIECE)
    position = head.find(_ASF_PROPERTIES)
    if position < 0:
        return None
    (declared,) = struct.unpack_from("<Q", head, position + 40)
    return CUT if declared > reading.size else None


# Position of the mark in packets by their size: plain, with error correction, with time codes.
_TS_PACKETS = {188: 0, 204: 0, 192: 4}
_TS_MARK, _TS_BYTES, _PIECE_PACKETS = 0x47, 188, 8192
_HAS_ADAPTATION, _HAS_PAYLOAD, _BEGINS_PICTURE, _HAS_ERROR = 0x20, 0x10, 0x40, 0x80  # flags
# Two flags of the adaptation field allow a jump of the packet count: an intended jump, and a key
# frame. Each part of joined broadcasts begins with a key frame.
_MAY_JUMP = 0xC0


def _transport_stream(reading: _Reading) -> str | None:
    """Check the mark of each packet, and the heads and the count of the video's packets."""
    layout = _layout(reading)
    if layout is None:
        return None
    start, mark, step = layout
    if (reading.size - start) % step:
        return CUT
    last: int | None = None
    earlier: set[int] = set()  # other videos that begin before the end of the first one
    later: set[int] = set()
    for packets in _pieces(reading, start, mark, step):
        head = packets[:, :6].astype(np.int64)
        if (head[:, 0] != _TS_MARK).any() or (head[:, 1] & _HAS_ERROR).any():
            return BROKEN
        stream = (head[:, 1] & 0x1F) << 8 | head[:, 2]
        video = stream == reading.stream
        if video.any():
            end = np.flatnonzero(video)[-1] + 1
            earlier |= later | _videos_that_begin(packets[:end], stream[:end])
            later = _videos_that_begin(packets[end:], stream[end:])
        else:
            later |= _videos_that_begin(packets, stream)
        head = head[video]
        if (_beginnings(packets[video], 3)[1] != (0, 0, 1)).any():  # so each picture must begin
            return BROKEN
        counted = head[(head[:, 3] & _HAS_PAYLOAD) != 0]
        if len(counted):
            if _packets_missing(counted, last):
                return BROKEN
            last = int(counted[-1, 3]) & 15
    return FURTHER if later - earlier else None


def _videos_that_begin(packets: NDArray[np.uint8], stream: NDArray[np.int64]) -> set[int]:
    """Return the streams of which a packet begins with the head of a picture."""
    begins, prefix = _beginnings(packets, 4)
    is_video = (prefix[:, :3] == (0, 0, 1)).all(axis=1) & (prefix[:, 3] & 0xF0 == 0xE0)
    return set(map(int, stream[begins[is_video]]))


def _beginnings(
    packets: NDArray[np.uint8], count: int
) -> tuple[NDArray[np.intp], NDArray[np.uint8]]:
    """Return the rows of packets with the beginning of a picture, and its first `count` bytes."""
    adapted = (packets[:, 3] & _HAS_ADAPTATION) != 0
    first = np.where(adapted, 5 + packets[:, 4].astype(np.int64), 4)
    begun = (packets[:, 1] & _BEGINS_PICTURE) != 0
    rows = np.flatnonzero(begun & (first <= _TS_BYTES - count))
    return rows, packets[rows[:, None], first[rows, None] + np.arange(count)]


def _packets_missing(head: NDArray[np.int64], last: int | None) -> bool:
    """Return whether the packet count jumps; a packet may be sent twice."""
    count = head[:, 3] & 15
    steps = np.diff(count, prepend=count[0] - 1 if last is None else last) % 16
    adapted = ((head[:, 3] & _HAS_ADAPTATION) != 0) & (head[:, 4] > 0)
    allowed = adapted & ((head[:, 5] & _MAY_JUMP) != 0)
    return bool(((steps > 1) & ~allowed).any())


def _layout(reading: _Reading) -> tuple[int, int, int] | None:
    """Return the start of the first packet, the mark's position in it, and the packet size."""
    head = reading.at(0, 5 * max(_TS_PACKETS))
    for step, mark in _TS_PACKETS.items():
        for start in range(step):
            marks = head[start + mark :: step]
            if len(marks) >= 4 and set(marks) == {_TS_MARK}:
                return start, mark, step
    return None


def _pieces(reading: _Reading, start: int, mark: int, step: int) -> Iterator[NDArray[np.uint8]]:
    """Yield packets as rows of bytes that begin with the mark."""
    reading.file.seek(start)
    while piece := reading.file.read(step * _PIECE_PACKETS):
        rows = np.frombuffer(piece, np.uint8, len(piece) // step * step).reshape(-1, step)
        yield rows[:, mark : mark + _TS_BYTES]


_CHECKS: dict[str, Callable[[_Reading], str | None]] = {
    "matroska,webm": _matroska,
    "mov,mp4,m4a,3gp,3g2,mj2": _boxes,
    "flv": _flv,
    "gif": _gif,
    "mjpeg": _mjpeg,
    "jpeg_pipe": _mjpeg,
    "mpegts": _transport_stream,
    "yuv4mpegpipe": _y4m,
    "ivf": partial(_y4m, head=12),
    "apng": _apng,
    "nut": _nut,
    "ogg": _ogg,
    "obu": _av1,
    "mxf": _mxf,
    "asf": _asf,
}
