"""Writers of single pictures and of NumPy archives."""

from __future__ import annotations

import io
import struct
import zipfile
import zlib
from typing import TYPE_CHECKING

import numpy as np

from oppload_cli.video.atomic import remove
from oppload_cli.video.writer_base import Writer

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Grey = NDArray[np.uint8]


class PngWriter(Writer):
    """Writes a folder of ``frame_00000.png``, ..."""

    def _open(self) -> None:
        remove(self.part)
        self.part.mkdir()

    def _write(self, grey: Grey) -> None:
        (self.part / f"frame_{self.frames:05d}.png").write_bytes(png_bytes(grey))

    def _close(self) -> None:
        """Do nothing: every frame is on the disk already."""


class NpzWriter(Writer):
    """Writes ``grey`` (uint8, frames x h x w), ``time_s`` and ``frame_rate`` as one archive.

    The frames are streamed, so that the clip is never in memory as a whole.
    """

    def _open(self) -> None:
        self._archive = zipfile.ZipFile(self.part, "w", zipfile.ZIP_DEFLATED, compresslevel=4)
        # the default date, not today's: the same frames give the same bytes
        self._stream = self._archive.open(_entry("grey.npy"), "w", force_zip64=True)
        shape = (self.count, self.height, self.width)
        description = {"descr": "|u1", "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(self._stream, description)

    def _write(self, grey: Grey) -> None:
        self._stream.write(grey.tobytes())

    def _close(self) -> None:
        self._stream.close()
        times = np.array([float(index / self.frame_rate) for index in range(self.count)])
        ratio = np.array([self.frame_rate.numerator, self.frame_rate.denominator])
        for name, values in (("time_s", times), ("frame_rate", ratio)):
            data = io.BytesIO()
            np.lib.format.write_array(data, values)
            self._archive.writestr(_entry(f"{name}.npy"), data.getvalue())
        self._archive.close()

    def _abandon(self) -> None:
        for name in ("_stream", "_archive"):
            try:
                if hasattr(self, name):
                    getattr(self, name).close()
            except (OSError, ValueError):
                continue
        super()._abandon()


def png_bytes(grey: Grey) -> bytes:
    """Return a grey picture as a PNG file.

    Parameters
    ----------
    grey : ndarray
        uint8 (h, w).

    Returns
    -------
    bytes
        The same for the same picture.
    """
    height, width = grey.shape
    # each row differs from the one above by little: filter 2 stores the difference
    above = np.vstack([np.zeros((1, width), np.uint8), grey[:-1]])
    rows = np.hstack([np.full((height, 1), 2, np.uint8), grey - above])
    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    chunks = ((b"IHDR", header), (b"IDAT", zlib.compress(rows.tobytes(), 6)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + tag + data + struct.pack(">I", zlib.crc32(tag + data))
        for tag, data in chunks
    )


def _entry(name: str) -> zipfile.ZipInfo:
    entry = zipfile.ZipInfo(name)
    entry.compress_type = zipfile.ZIP_DEFLATED
    return entry
