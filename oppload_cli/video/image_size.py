"""The size that an image file declares, read from its header alone."""

from __future__ import annotations

import re
import struct

PNM = re.compile(rb"P[1-6](?:\s+|#[^\n]*\n)+(\d{1,9})(?:\s+|#[^\n]*\n)+(\d{1,9})\s")
TIFF_WIDTH, TIFF_HEIGHT = 256, 257
JPEG_WITHOUT_SIZE = {0xC4, 0xC8, 0xCC}  # tables that share the numbers of the frame headers


def declared_size(data: bytes) -> tuple[int, int] | None:  # noqa: PLR0911 - one per format
    """Return the width and height that an image declares.

    Decoders take memory by this, so it is looked at first.

    Parameters
    ----------
    data : bytes
        The whole file.

    Returns
    -------
    tuple of int, or None
        None where it is no PNG, JPEG, BMP, PNM, TIFF or WebP image, or is damaged.
    """
    try:
        if data.startswith(b"\x89PNG\r\n\x1a\n"):
            return _unpacked(">II", data, 16)
        if data.startswith(b"\xff\xd8"):
            return _jpeg(data)
        if data.startswith(b"BM"):
            width, height = _unpacked("<ii", data, 18)
            return abs(width), abs(height)
        if data.startswith((b"II*\0", b"MM\0*")):
            return _tiff(data)
        if data.startswith(b"RIFF") and data[8:12] == b"WEBP":
            return _webp(data)
    except struct.error:  # the header is cut
        return None
    found = PNM.match(data)
    return (int(found[1]), int(found[2])) if found else None


def _unpacked(form: str, data: bytes, offset: int) -> tuple[int, int]:
    first, second = struct.unpack_from(form, data, offset)
    return int(first), int(second)


def _jpeg(data: bytes) -> tuple[int, int] | None:
    offset = 2
    while True:
        mark, kind = struct.unpack_from("BB", data, offset)
        if mark != 0xFF:
            return None
        if 0xC0 <= kind <= 0xCF and kind not in JPEG_WITHOUT_SIZE:
            height, width = _unpacked(">HH", data, offset + 5)
            return width, height
        if kind == 0xFF:  # padding
            offset += 1
        elif kind == 0x01 or 0xD0 <= kind <= 0xD7:  # marks without a length
            offset += 2
        else:
            offset += 2 + max(2, struct.unpack_from(">H", data, offset + 2)[0])


def _tiff(data: bytes) -> tuple[int, int] | None:
    order = "<" if data.startswith(b"II") else ">"
    (start,) = struct.unpack_from(f"{order}I", data, 4)
    (entries,) = struct.unpack_from(f"{order}H", data, start)
    sizes: dict[int, int] = {}
    for entry in range(start + 2, start + 2 + 12 * entries, 12):
        tag, kind = struct.unpack_from(f"{order}HH", data, entry)
        if tag in (TIFF_WIDTH, TIFF_HEIGHT):
            (sizes[tag],) = struct.unpack_from(order + ("H" if kind == 3 else "I"), data, entry + 8)
    if len(sizes) < 2:
        return None
    return sizes[TIFF_WIDTH], sizes[TIFF_HEIGHT]


def _webp(data: bytes) -> tuple[int, int] | None:
    kind = data[12:16]
    if kind == b"VP8 ":
        width, height = _unpacked("<HH", data, 26)
        return width & 0x3FFF, height & 0x3FFF
    if kind == b"VP8L":
        (bits,) = struct.unpack_from("<I", data, 21)
        return (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1
    if kind == b"VP8X":
        low, high = struct.unpack_from("<IH", data, 24)
        return (low & 0xFFFFFF) + 1, (low >> 24 | high << 8) + 1
    return None
