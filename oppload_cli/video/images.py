"""Images, read by Pillow, and cameras, read by OpenCV, as sources of pictures."""

from __future__ import annotations

import math
import re
import stat
import statistics
import time
import warnings
from collections import Counter
from contextlib import ExitStack, contextmanager, suppress
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
from PIL import Image, ImageOps, UnidentifiedImageError

from oppload_cli.errors import SourceError, reason_of
from oppload_cli.frame_times import USUAL_RATE, ticks
from oppload_cli.video.arrivals import Arrivals
from oppload_cli.video.frames import (
    MAX_PIXELS,
    DecodeFacts,
    InputFacts,
    Picture,
    PictureSource,
    check_pixels,
    max_pixels,
)
from oppload_cli.video.inputs import bytes_of, image_paths, rate_beside
from oppload_cli.video.laboratory import Stack

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from typing import Any

    from numpy.typing import NDArray

    Bgr = NDArray[np.uint8]  # rows x columns x 3: blue, green, red
    Luma = NDArray[np.uint8] | NDArray[np.uint16]  # rows x columns


_FORMATS = ("PNG", "JPEG", "BMP", "PPM", "TIFF", "WEBP")  # Pillow's names
# An image file has at most `_PIXEL_BYTES` bytes per pixel, and `_OTHER_BYTES` more.
_PIXEL_BYTES, _OTHER_BYTES = 8, 1 << 24
_LAST_NUMBER = re.compile("[0-9]+(?=[^0-9]*$)")
_GAP = 1.5  # images are missing if a step between two numbers is at least 1.5 usual steps
# A camera may fail once, for example if USB loses a packet; so its reading is tried again.
_RETRY_S, _PAUSE_S = 1.0, 0.01  # in all, and between two readings
_MOST_LATE_S = 1.0  # a time of the driver further from that of arrival is no time of the picture
_DEEP_GREY = {"I", "I;16", "I;16L", "I;16B", "I;16N"}  # Pillow's modes with 16 bits


class ImageSource(PictureSource):
    """A sequence of images, in the order of the numbers in their names.

    `name` is a folder, or a pattern such as ``frames_%04d.png``. `frame_rate` None takes the rate
    of the ground truth beside the folder, or assumes 30 frames/s. Raises SourceError if no image
    exists, or none can be read.
    """

    def __init__(self, name: str, frame_rate: Fraction | None) -> None:
        super().__init__()
        stated = frame_rate or rate_beside(name)
        self._rate = stated or USUAL_RATE
        self._paths = image_paths(name)
        self._brightest = 0  # value of all 16-bit images so far
        height, width = self._size_of_first()
        self.facts = InputFacts(
            name=name,
            kind="images",
            width=width,
            height=height,
            frame_rate=self._rate,
            rate_assumed=stated is None,
            frames_declared=len(self._paths),
            codec=self._paths[0].suffix.lower().lstrip("."),
            pixel_format="gray",
            bytes=bytes_of(name),
        )

    def pictures(self) -> Iterator[Picture]:
        """Yield the images that can be read; count each other image as a failure."""
        size = (self.facts.height, self.facts.width)
        if remark := _several_series(self._paths) or _gap(self._paths):
            self.decode.note(remark)
        for index, path in enumerate(self._paths):
            if self.stopping:
                return
            image = self._image(path)
            if image is None:
                continue
            luma, colour = image
            self.decode.decoded += 1
            if luma.dtype == np.uint16:
                self._brightest = max(self._brightest, int(luma.max()))
            if luma.shape != size:
                size = luma.shape
                self.decode.note(f"the size becomes {size[1]} x {size[0]} at {path.name}")
            time, bits = ticks(index / self._rate), 8 * luma.itemsize
            yield Picture(index, time, luma, bits, original=colour)

    def finish(self) -> None:
        """Note that images of 16 bits use few of them."""
        self.decode.note_few_bits(self._brightest)

    def _size_of_first(self) -> tuple[int, ...]:
        """Return the rows and columns of the first image that can be read."""
        for path in self._paths:
            image = self._image(path)
            if image is not None:
                self.decode = DecodeFacts()  # `pictures` reads and counts these images again
                return image[0].shape
        raise SourceError(
            f"{self._paths[0]}: none of these images can be read ({self.decode.messages[0]}); "
            f"check or convert them"
        )

    def _image(self, path: Path) -> tuple[Luma, Bgr] | None:
        """Return the luma and the colours of an image.

        If it cannot be read, count a failure and return None.
        """
        try:
            with _opened(path) as image:
                # "MPO" is a photograph in JPEG with further pictures, such as a preview.
                several = image.format != "MPO" and getattr(image, "is_animated", False)
                decoded, opacity = _decoded(image), _opacity(image)
        except SourceError as error:
            self.decode.failed(f"{path.name} is not an image that can be read ({error})")
            return None
        if several:
            self.decode.failed(
                f"{path.name} holds several pictures, of which only the first is read; "
                f"convert it to a video or to single images"
            )
        if opacity is not None and (opacity < np.uint8(255)).any():
            self.decode.note(
                "transparency is left out; draw the images on an opaque background first"
            )
        return decoded


def opened_stack(path: Path) -> Stack:
    """Open an image file of several pictures, as TIFF, WebP and APNG may hold.

    The pictures of WebP and APNG last as long as the file says; a TIFF has no times. Raises
    SourceError if the file is not an image, or has one picture.
    """
    with ExitStack() as on_failure:
        try:
            image = on_failure.enter_context(_opened(path, several=True))
        except SourceError as error:
            raise SourceError(f"{path}: {error}; check or convert it") from error
        count = getattr(image, "n_frames", 1)
        if count == 1:
            raise SourceError(
                f"{path}: a single image shows no motion; give its folder, or a pattern such as "
                f"frame_%03d{path.suffix}"
            )
        timed = image.format != "TIFF"
        closing = on_failure.pop_all()

    def pictures() -> Iterator[tuple[float | None, NDArray[Any]]]:
        time_s = 0.0
        for place in range(count):
            try:
                image.seek(place)
                luma, colour = _decoded(image)
            except Exception as error:  # damaged files raise errors of many kinds
                raise ValueError(reason_of(error)) from error
            grey = image.mode in {"1", "L", "P", *_DEEP_GREY}
            yield (time_s if timed else None), luma if grey else colour[..., ::-1]
            time_s += float(image.info.get("duration", 0)) / 1000

    return Stack(pictures(), count, None, None, closing.close)


def _several_series(paths: Sequence[Path]) -> str:
    """Return a sentence if images belong to series of different names, else an empty text."""
    numbered = [path for path in paths if _LAST_NUMBER.search(path.stem)]
    names = [re.sub("[0-9]+", "", path.stem) for path in numbered]
    series = [name for name, count in Counter(names).items() if count > 1]
    if len(series) < 2:
        return ""
    first = numbered[names.index(series[0])]
    pattern = _LAST_NUMBER.sub(lambda number: f"%0{len(number[0])}d", first.stem) + first.suffix
    return (
        f"these are {len(series)} series of images, which are taken for one; give one of them, "
        f"such as {pattern}"
    )


def _gap(paths: Sequence[Path]) -> str:
    """Return a sentence if numbers are missing in a sequence of images, else an empty text."""
    parts = [re.fullmatch(r"(.*?)([0-9]+)", path.stem, re.DOTALL) for path in paths]
    numbers = [int(part[2]) for part in parts if part]
    beginnings = {part and part[1] for part in parts}
    if len(paths) < 3 or len(beginnings) > 1 or not numbers:
        return ""
    steps = [after - before for before, after in pairwise(numbers)]
    # The usual step is 1, or 2 if only every second frame was kept, or a duration if the names hold
    # times.
    usual = statistics.median_low([step for step in steps if step] or [1])
    gaps = [path for path, step in zip(paths, steps, strict=False) if step >= _GAP * usual]
    if not gaps:
        return ""
    places = "" if len(gaps) == 1 else f"in {len(gaps)} places, first "
    return (
        f"numbers are missing {places}after {gaps[0].name}; the images are taken as if they "
        f"followed each other"
    )


def read_transparent(name: str) -> tuple[NDArray[np.float32], NDArray[np.float32] | None]:
    """Return the luminance and the opacity of an image file, 0 to 1, of shape (height, width).

    Luminance has the weights of Rec. 601; the opacity is None for an image without transparency.
    Raises SourceError if the file is not an image, or is damaged or too large.
    """
    with _opened(Path(name)) as image:
        (luma, _), opacity = _decoded(image), _opacity(image)
    luminance = luma.astype(np.float32) / np.float32(np.iinfo(luma.dtype).max)
    return luminance, None if opacity is None else opacity.astype(np.float32) / np.float32(255)


def _opacity(image: Image.Image) -> NDArray[np.uint8] | None:
    """Return the opacity of an image after `_decoded` turned it upright; None if it has none."""
    if not ("A" in image.getbands() or "transparency" in image.info):
        return None
    return np.asarray(image.convert("RGBA").getchannel("A"), np.uint8)


@contextmanager
def _opened(path: Path, *, several: bool = False) -> Iterator[Image.Image]:
    """Open an image; raise SourceError if the file is not an image, or is damaged or too large.

    The checks of size come before Pillow decodes, so that neither a small file with a large image
    nor a large file can fill the memory; only a file of `several` pictures may be large.
    """
    most_pixels = max_pixels()  # outside `try`: a wrong setting is no fault of the file
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):
            raise SourceError("not a regular file")
        if not several:
            _check_bytes(path, status.st_size, most_pixels)
        with _without_pillow_limits(), Image.open(path, formats=_FORMATS) as image:
            check_pixels(path.name, *image.size)
            if not several:
                _check_bytes(path, status.st_size, image.width * image.height)
            yield image
    except SourceError:
        raise
    except UnidentifiedImageError as error:
        raise SourceError("not a PNG, JPEG, BMP, PNM, TIFF or WebP image, or truncated") from error
    except Exception as error:  # damaged files raise errors of many kinds
        raise SourceError(reason_of(error)) from error


def _check_bytes(path: Path, size: int, pixels: int) -> None:
    if size > _PIXEL_BYTES * pixels + _OTHER_BYTES:
        raise SourceError(
            f"{path.name}: has {size} bytes, too many for an image; set {MAX_PIXELS} higher "
            f"if that is right"
        )


@contextmanager
def _without_pillow_limits() -> Iterator[None]:
    """Switch off Pillow's warnings and its limit of pixels, which may be below oppload's limit."""
    limit, Image.MAX_IMAGE_PIXELS = Image.MAX_IMAGE_PIXELS, None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        Image.MAX_IMAGE_PIXELS = limit


def _decoded(image: Image.Image) -> tuple[Luma, Bgr]:
    """Decode an image without its transparency, and turn it upright; return luma and colours.

    The luma has 16 bits for a grey image of more than 8 bits; the colours always have 8.
    """
    if image.mode == "F" or (image.mode == "I" and image.format == "TIFF"):
        raise SourceError("its samples have 32 bits; convert it to 8 or 16")
    deep = image.mode in _DEEP_GREY
    image.load()
    with suppress(Exception):  # an image with damaged EXIF data stays as it is
        ImageOps.exif_transpose(image, in_place=True)
    if deep:
        luma = np.asarray(image).astype(np.uint16)
        grey = np.asarray(luma >> 8, np.uint8)
        return luma, np.asarray(cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR), np.uint8)
    rgb = np.asarray(image if image.mode == "RGB" else image.convert("RGB"), np.uint8)
    colour = np.asarray(cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR), np.uint8)
    return _grey(colour), colour


class CameraSource(PictureSource):
    """A camera of this computer, such as ``camera:0``; it gives pictures until closed.

    Raises SourceError if the name has no number, or if the camera gives no picture.
    """

    def __init__(self, name: str) -> None:
        number = name.partition(":")[2]
        if not re.fullmatch("[0-9]{1,9}", number):
            raise SourceError(
                f"{name}: is not the name of a camera; write camera:0, camera:1 and so on"
            )
        super().__init__()
        self._capture = cv2.VideoCapture(int(number))
        first = self._picture()
        if first is None:
            self._capture.release()
            raise SourceError(
                f"{name}: this camera gives no picture; check that it is there and not in use"
            )
        self._first_read_s, self._first_taken_s = time.perf_counter(), self._taken_s()
        rate = self._capture.get(cv2.CAP_PROP_FPS)  # a driver may divide by 0
        exact = Fraction(rate).limit_denominator(1001) if 0 < rate < math.inf else None
        self.facts = InputFacts(
            name=name,
            kind="camera",
            width=first.shape[1],
            height=first.shape[0],
            frame_rate=exact or None,
            frames_declared=None,
            codec="raw",
            pixel_format="bgr24",
            real_time=True,
        )
        self._first = first

    def pictures(self) -> Iterator[Picture]:
        """Yield pictures as they come.

        The time of a picture is when the driver took it, or else follows from its arrival.
        """
        arrivals = Arrivals()
        start = time.perf_counter()  # `monotonic` has steps of 16 ms on Windows
        taken_s = self._first_taken_s
        colour: Bgr | None = self._first
        while colour is not None and not self.stopping:
            index = self.decode.decoded
            self.decode.decoded += 1
            now_s, before_s, taken_s = time.perf_counter(), taken_s, self._taken_s()
            time_s = arrivals.step(now_s - start if index else 0.0)
            # Pictures that waited in the driver arrive late, several at a time. But a driver may
            # have no clock, or one with another unit.
            since_first_s = taken_s - self._first_taken_s
            late_s = now_s - self._first_read_s - since_first_s
            if taken_s > before_s and abs(late_s) < _MOST_LATE_S:
                time_s = since_first_s
            else:
                self.decode.smoothed = arrivals.smoothed
            yield Picture(index, ticks(time_s), _grey(colour), original=colour)
            colour = self._picture()
            if colour is None and (colour := self._picture_after_failure()) is not None:
                self.decode.failed("the camera failed, and went on")

    def finish(self) -> None:
        """Count a failure: the camera stopped before the user stopped it."""
        self.decode.failed("the camera stopped")

    def close(self) -> None:
        """Release the camera; may be called twice."""
        self._capture.release()

    def _picture_after_failure(self) -> Bgr | None:
        """Return the next picture of a camera that has just failed; None if it fails for 1 s."""
        end = time.monotonic() + _RETRY_S
        while not self.stopping and time.monotonic() < end:
            colour = self._picture()
            if colour is not None:
                return colour
            time.sleep(_PAUSE_S)
        return None

    def _taken_s(self) -> float:
        """Return when the driver took the latest picture, by its own clock."""
        return float(self._capture.get(cv2.CAP_PROP_POS_MSEC)) / 1000

    def _picture(self) -> Bgr | None:
        read, colour = self._capture.read()
        return np.asarray(colour, np.uint8) if read else None


def _grey(colour: Bgr) -> NDArray[np.uint8]:
    """Return the luma by Rec. 601."""
    return np.asarray(cv2.cvtColor(colour, cv2.COLOR_BGR2GRAY), np.uint8)
