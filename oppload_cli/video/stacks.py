"""Files that hold pictures one after the other: stacks of arrays, of images, of laboratories."""

from __future__ import annotations

from fractions import Fraction
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from oppload_cli.errors import OpploadError, SourceError, cannot_read, reason_of
from oppload_cli.frame_times import USUAL_RATE, ticks
from oppload_cli.video.frames import (
    InputFacts,
    Picture,
    PictureSource,
    check_pixels,
    no_true_rate,
)
from oppload_cli.video.inputs import bytes_of, rate_beside, stack_and_key
from oppload_cli.video.laboratory import DamagedError, Stack, open_fmf, open_norpix, open_ufmf

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from oppload_cli.video.span import Reading


_LONGEST_S = 1e9  # 30 years: from there on a time is damage


class StackSource(PictureSource):
    """The pictures of a file that holds a stack of arrays or images, or a laboratory's video.

    A stack without times takes the rate that the user states, that of the ground truth beside it,
    or 30 frames/s. Raises SourceError if the file is none, or holds no pictures.
    """

    def __init__(self, name: str, reading: Reading) -> None:
        super().__init__()
        file, key = stack_and_key(name)
        path = Path(file)
        try:
            self._stack = _opened(path, key)
            self._first = self._first_picture(name)
        except OpploadError:
            raise
        except OSError as error:
            raise cannot_read(name, error) from error
        except Exception as error:  # damaged files raise errors of many kinds
            raise SourceError(
                f"{name}: its pictures cannot be read ({reason_of(error)}); check the file"
            ) from error
        time_s, values = self._first
        if time_s is not None and reading.true_rate is not None:
            self._stack.close()
            raise no_true_rate(name, "it has the times of its camera")
        rate = self._stack.rate
        if time_s is None:
            rate = reading.image_rate or reading.true_rate or rate_beside(name)
        assumed = time_s is None and rate is None
        self._rate = USUAL_RATE if assumed else rate
        self._brightest = 0
        self.facts = InputFacts(
            name=name,
            kind="images" if time_s is None else "container",
            width=values.shape[1],
            height=values.shape[0],
            frame_rate=self._rate,
            rate_assumed=assumed,
            frames_declared=self._stack.count,
            codec=path.suffix.lower().lstrip("."),
            pixel_format=f"{'rgb' if values.ndim == 3 else 'gray'}, {values.dtype}",
            bytes=bytes_of(file),
        )

    def _first_picture(self, name: str) -> tuple[float | None, NDArray[Any]]:
        """Return the first picture; close the file if there is none, or if it cannot be read."""
        try:
            for first in self._stack.pictures:
                return first
            raise SourceError(f"{name}: holds no picture; check the file")
        except BaseException:
            self._stack.close()
            raise

    def pictures(self) -> Iterator[Picture]:
        """Yield the pictures; a picture that cannot be read ends them."""
        try:
            for index, (time_s, values) in enumerate(chain([self._first], self._stack.pictures)):
                if self.stopping:
                    return
                time = self._time(index, time_s)
                luma, colour = _luma_and_colour(values, f"{self.facts.name}: picture {index}")
                bits = self._stack.bits or 8 * luma.itemsize
                if bits == 16:
                    self._brightest = max(self._brightest, int(luma.max()))
                self.decode.decoded += 1
                yield Picture(index, time, luma, bits, original=colour)
        except OpploadError:
            raise
        except Exception as error:  # damaged files raise errors of many kinds
            count = self.decode.decoded
            self.decode.failed(f"frame {count} cannot be read ({reason_of(error)})")

    def _time(self, index: int, time_s: float | None) -> int:
        start_s = self._first[0]
        if time_s is None or start_s is None:
            return ticks(Fraction(index) / (self._rate or USUAL_RATE))
        if not abs(time_s - start_s) < _LONGEST_S:  # also if one of them is not a number
            raise DamagedError(f"its time is {time_s:g} s")
        return ticks(time_s - start_s)

    def finish(self) -> None:
        """Count the declared pictures that never came, and note that 16 bits are hardly used."""
        self.decode.note_few_bits(self._brightest)
        self.decode.missing = max(0, (self._stack.count or 0) - self.decode.decoded)

    def close(self) -> None:
        """Close the file; may be called twice."""
        self._stack.close()


def _opened(path: Path, key: str) -> Stack:
    suffix = path.suffix.lower()
    if suffix == ".npy":
        return _of_array(path, np.load(path, mmap_mode="r", allow_pickle=False))
    if suffix == ".npz":
        return _open_npz(path, key)
    if suffix in {".h5", ".hdf5"}:
        return _open_hdf5(path, key)
    if suffix in _LABORATORY:
        return _LABORATORY[suffix](path)
    from oppload_cli.video.images import opened_stack  # imports Pillow

    return opened_stack(path)


_LABORATORY: dict[str, Callable[[Path], Stack]] = {
    ".fmf": open_fmf,
    ".ufmf": open_ufmf,
    ".seq": open_norpix,
}


def _of_array(path: Path, frames: Any, close: Callable[[], object] = lambda: None) -> Stack:
    """Return the stack of an array, of which each picture is read when it is needed."""
    shape = frames.shape
    if not (len(shape) == 3 or (len(shape) == 4 and shape[3] == 3)):
        raise SourceError(
            f"{path}: its shape is {tuple(shape)}; a stack has the shape (frames, height, width), "
            "or a last axis of red, green and blue"
        )
    if 0 not in shape:
        check_pixels(str(path), shape[2], shape[1])
    pictures = ((None, np.asarray(frames[index])) for index in range(shape[0] * (0 not in shape)))
    return Stack(pictures, shape[0], None, None, close)


def _open_npz(path: Path, key: str) -> Stack:
    with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
        found = {name: values for name in arrays.files if (values := arrays[name]).ndim >= 3}
        return _of_array(path, found[_chosen(path, key.strip("/"), list(found))])


def _open_hdf5(path: Path, key: str) -> Stack:
    try:
        import h5py
    except ImportError as error:
        raise SourceError(
            f"{path}: is a file of HDF5, which needs h5py; pip install 'oppload[hdf5]'"
        ) from error
    file = h5py.File(path, "r")
    try:
        found: list[str] = []
        file.visititems(
            lambda name, item: (
                found.append(name) if isinstance(item, h5py.Dataset) and item.ndim >= 3 else None
            )
        )
        return _of_array(path, file[_chosen(path, key.strip("/"), found)], file.close)
    except BaseException:
        file.close()
        raise


def _chosen(path: Path, key: str, names: list[str]) -> str:
    """Return the array that the user names, or the only one of a file."""
    if key in names or (not key and len(names) == 1):
        return key or names[0]
    if not names:
        raise SourceError(f"{path}: holds no array of pictures; check the file")
    listed = ", ".join(f"{path.name}:/{name}" for name in names[:5])
    wrong = f"holds no array '{key}' of pictures" if key else f"holds {len(names)} arrays"
    raise SourceError(f"{path}: {wrong}; give one of {listed}")


def _luma_and_colour(
    values: NDArray[Any], name: str
) -> tuple[NDArray[np.uint8] | NDArray[np.uint16], NDArray[np.uint8]]:
    """Return the luma of a picture, of 8 or 16 bits, and its colours, of 8.

    Floating values from 0 to 1 are rounded to 16 bits. Raises SourceError for other values.
    """
    values = values.astype(values.dtype.newbyteorder("="), copy=False)
    if values.dtype.kind == "f":
        if not (np.isfinite(values).all() and values.min() >= 0 and values.max() <= 1):
            raise SourceError(
                f"{name} holds values that are not from 0 to 1; scale the stack, or save it as "
                "uint8 or uint16"
            )
        values = np.round(values * 65535).astype(np.uint16)
    if values.dtype not in {np.dtype(np.uint8), np.dtype(np.uint16)}:
        raise SourceError(
            f"{name} has values of the type {values.dtype}; save the stack as uint8 or uint16 over "
            "their full range, or as float from 0 to 1"
        )
    values = np.ascontiguousarray(values)
    luma: Any = cv2.cvtColor(values, cv2.COLOR_RGB2GRAY) if values.ndim == 3 else values
    eight = values if values.dtype == np.uint8 else (values >> 8).astype(np.uint8)
    code = cv2.COLOR_RGB2BGR if values.ndim == 3 else cv2.COLOR_GRAY2BGR
    return luma, np.asarray(cv2.cvtColor(eight, code), np.uint8)
