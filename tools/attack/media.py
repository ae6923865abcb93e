"""Intact files of every container and codec that the encoder can make, and damage to them."""

from __future__ import annotations

import io
import json
import os
import struct
from fractions import Fraction
from itertools import product
from typing import TYPE_CHECKING, Any

import av
import numpy as np
from PIL import Image

from tests.robustness import damage
from tests.robustness.inputs import AV1, VP9, X264, X265, Kind, frame_of, make

if TYPE_CHECKING:
    from pathlib import Path
    from random import Random

_CONTAINERS = (
    *("mp4", "mov", "mkv", "webm", "avi", "ts", "flv", "nut", "ivf", "mxf", "asf", "gif", "y4m"),
    *("mpg", "obu", "h264", "hevc", "mjpeg", "m2v", "m4v", "3gp", "apng", "ogv", "vob", "wtv"),
    *("swf", "f4v", "ismv", "dv", "gxf", "rm", "amv", "webp", "jp2"),
)
_OPTIONS = {
    "libx264": X264,
    "libx265": X265,
    "libvpx": VP9,
    "libvpx-vp9": VP9,
    "libsvtav1": AV1,
    "ffv1": {"level": "3"},
}
_CODECS = (
    *(*_OPTIONS, "mpeg4", "mpeg2video", "mpeg1video", "mjpeg", "prores_ks", "gif", "huffyuv"),
    *("ffvhuff", "utvideo", "rawvideo", "png", "wmv2", "flv", "h263p", "jpeg2000", "dnxhd"),
    *("apng", "qtrle", "zmbv", "snow", "msmpeg4", "magicyuv", "cfhd", "vc2", "ljpeg", "jpegls"),
    *("svq1", "cinepak", "asv2", "flashsv", "libwebp_anim", "targa", "wrapped_avframe"),
)
_FRAMES = 10
# Pixel formats that no codec above prefers, with a codec and a container that have them.
_PIXELS = {
    "yuv420p10le": ("libx265", "mov"),
    "yuvj420p": ("libx264", "mov"),
    "yuva444p10le": ("prores_ks", "mov"),
    "gbrap12le": ("ffv1", "mkv"),
    "rgb565be": ("rawvideo", "mov"),
    "ya8": ("png", "mov"),
}
_ORIENTATION = 0x0112  # a number of EXIF
WAYS = (*damage.WAYS, "grow", "size", "insert", "remove", "double", "noise", "empty")
_SIZES = (0, 1, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 0x00FFFFFF, 0x10000)


def intact(folder: Path) -> dict[str, Path]:
    """Return a file of each pair of container and codec that PyAV can write, by ``CODEC.SUFFIX``.

    Some more files have unusual pixels, pictures that change, EXIF, sound or a second video. The
    first call makes the files; a later call with the same `folder` finds them.
    """
    index = folder / "index.json"
    if not index.exists():
        folder.mkdir(parents=True, exist_ok=True)
        os.environ["SVT_LOG"] = "0"  # the AV1 encoder has its own log
        level = av.logging.get_level()
        av.logging.set_level(None)
        names = []
        for suffix, codec in product(_CONTAINERS, _CODECS):
            name = f"{codec}.{suffix}"
            if _is_made(folder / name, codec, suffix):
                names.append(name)
            else:
                (folder / name).unlink(missing_ok=True)
        names += _make_unusual(folder)
        av.logging.set_level(level)  # the package counts the errors that decoders log
        part = index.with_suffix(".part")
        part.write_text(json.dumps(names))
        part.replace(index)
    return {name: folder / name for name in json.loads(index.read_text())}


def _is_made(path: Path, codec: str, suffix: str) -> bool:
    """Make a file; return whether it can be read again."""
    formats = [each.name for each in av.codec.Codec(codec, "w").video_formats or ()]
    pixel_format = "yuv420p" if "yuv420p" in formats or not formats else formats[0]
    width, height, frames = (1280, 720, 2) if codec == "dnxhd" else (96, 64, _FRAMES)
    kind = Kind(
        suffix,
        codec,
        pixel_format,
        width=width,
        height=height,
        frames=frames,
        rate=Fraction(25),
        options=_OPTIONS.get(codec, {}),
    )
    try:
        make(path, kind)
        # Some containers can be written with a codec with which they cannot be read.
        with av.open(str(path)) as container:
            return len(list(container.decode(video=0))) * 2 >= frames
    except (av.error.FFmpegError, ValueError, TypeError, OSError, IndexError, AttributeError):
        return False


def _make_unusual(folder: Path) -> list[str]:
    """Make files that differ from the others in more than their codec; return their names."""
    names = []
    for pixel_format, (codec, suffix) in _PIXELS.items():
        names.append(f"{pixel_format}.{suffix}")
        kind = Kind(suffix, codec, pixel_format, frames=_FRAMES, options=_OPTIONS.get(codec, {}))
        make(folder / names[-1], kind)
    for name, sizes, modes in (
        ("exif.mjpeg", (64,), ("RGB",)),
        ("changing.mjpeg", (64, 48, 80), ("L", "RGB", "CMYK")),
    ):
        (folder / name).write_bytes(
            b"".join(
                jpeg(index, sizes[index % len(sizes)], modes[index % len(modes)])
                for index in range(_FRAMES)
            )
        )
        names.append(name)
    parts = [folder / f"part{width}.ts" for width in (96, 160)]
    for path, width in zip(parts, (96, 160), strict=True):
        make(path, Kind("ts", "libx264", width=width, frames=_FRAMES, options=X264))
    (folder / "joined.ts").write_bytes(b"".join(path.read_bytes() for path in parts))
    names.append("joined.ts")
    for suffix in ("mp4", "mkv", "avi", "ts", "nut", "flv"):
        names.append(f"several.{suffix}")
        _make_several(folder / names[-1])
    return names


def jpeg(index: int, height: int = 64, mode: str = "L") -> bytes:
    """Return an image with EXIF: each has another grey level and another orientation."""
    exif = Image.Exif()
    exif[_ORIENTATION] = index % 8 + 1
    image = Image.fromarray(np.full((height, 96), 20 * index % 256, np.uint8)).convert(mode)
    with io.BytesIO() as file:
        image.save(file, "jpeg", exif=exif.tobytes())
        return file.getvalue()


def _make_several(path: Path) -> None:
    """Make a file with a turned video, a second video where the container allows it, and sound."""
    flash = path.suffix == ".flv"
    with av.open(str(path), "w") as container:
        videos: list[Any] = []
        for _ in range(1 if flash else 2):
            videos.append(container.add_stream("flv" if flash else "mpeg4", rate=25))
            videos[-1].width, videos[-1].height, videos[-1].pix_fmt = 96, 64, "yuv420p"
        videos[0].set_display_rotation(90)
        sound: Any = container.add_stream("mp3", rate=44100)
        for index in range(_FRAMES):
            for video in videos:
                container.mux(video.encode(frame_of(Kind("", ""), index)))
        for start in range(0, 44100, 1152):
            samples = av.AudioFrame.from_ndarray(np.zeros((1, 1152), np.float32), "fltp", "mono")
            samples.sample_rate, samples.pts = 44100, start
            container.mux(sound.encode(samples))
        for stream in (*videos, sound):
            container.mux(stream.encode())


def damaged(data: bytes, way: str, random: Random) -> bytes:
    """Return a copy of a file, damaged in one of the `WAYS`."""
    if way in damage.WAYS:
        return damage.damaged(data, way, random)
    result, place = bytearray(data), random.randrange(len(data))
    amount = random.choice((1, 4, 100, 5000))
    if way == "grow":
        result += random.choice((bytes(amount), random.randbytes(amount), data[place:]))
    elif way == "size":  # replace four bytes, which may be the size of a part of the file
        for _ in range(random.choice((1, 2, 8))):
            start = random.randrange(min(len(data), random.choice((64, 1000, len(data)))))
            number = struct.pack(random.choice("<>") + "I", random.choice(_SIZES))
            result[start : start + 4] = number
    elif way == "insert":
        result[place:place] = random.randbytes(amount)
    elif way == "remove":
        del result[place : place + amount]
    elif way == "double":
        result[place:place] = data[random.randrange(len(data)) :][: 10 * amount]
    elif way == "noise":
        result[place : place + amount] = random.randbytes(amount)
    else:
        result = bytearray(random.choice((b"", b"\0", data[:1], bytes(4096), os.linesep.encode())))
    return bytes(result)
