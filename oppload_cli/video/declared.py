"""What a container declares about its video: streams, rate, number of frames, end, orientation."""

from __future__ import annotations

import re
import struct
from contextlib import suppress
from fractions import Fraction
from itertools import islice, pairwise
from pathlib import Path
from statistics import median_low
from typing import TYPE_CHECKING, Any

import av
import numpy as np

if TYPE_CHECKING:
    from av.container import InputContainer
    from av.video.frame import VideoFrame
    from av.video.stream import VideoStream


_COVER_PICTURE = 0x400  # AV_DISPOSITION_ATTACHED_PIC
_GIF_TICKS = 100  # per second; FFmpeg guesses this rate if the times are uneven
_NO_TIMES = 0x80  # AVFMT_NOTIMESTAMPS of FFmpeg: a raw stream, which has no times
_SAMPLED_ENTRIES = 1000  # most entries of an index from which the usual step is taken
_DURATION = re.compile(r"([0-9]{1,9}):([0-9]{1,2}):([0-9]{1,2}(?:\.[0-9]+)?)(?![0-9])")
# Programs that write to a pipe cannot go back to the head, so that these counts remain there.
_AVI_TO_A_PIPE, _IVF_TO_A_PIPE = 1 << 30, 0xFFFFFFFF


def video_streams(container: InputContainer) -> list[VideoStream]:
    """Return the video streams except cover pictures, which are stored as video streams too."""
    return [
        stream
        for stream in container.streams.video
        if not stream.disposition.value & _COVER_PICTURE
    ]


def declared_rate(stream: VideoStream) -> Fraction | None:
    """Return the frames per second that a container declares; None if it declares no rate."""
    rates = [stream.average_rate, stream.guessed_rate, stream.base_rate]
    kind = stream.container.format.name
    # FFmpeg's average for GIF is that of the first few frames, and for raw DV the ticks per second.
    if kind == "dv" or (kind == "gif" and stream.guessed_rate != _GIF_TICKS):
        rates.insert(0, stream.guessed_rate)
    if stream.container.format.flags & _NO_TIMES:  # FFmpeg assumes 25; the codec may know better
        rates.insert(0, stream.codec_context.framerate)
    steps, usual = _steps(stream), _ticks_per_frame(stream)
    if usual > 1 and stream.time_base:
        near = [step for step in steps if abs(step - usual) <= usual / 2]
        rates.insert(0, len(near) / (sum(near) * stream.time_base))
    return next((Fraction(rate) for rate in rates if rate), None)


def is_rate_assumed(stream: VideoStream) -> bool:
    """Return whether FFmpeg assumes the rate, because a raw stream states neither rate nor times.

    It takes images one after the other in a pipe for such a stream too.
    """
    kind = stream.container.format
    raw = bool(kind.flags & _NO_TIMES) or kind.name.endswith("_pipe")
    return raw and not stream.codec_context.framerate


def _steps(stream: VideoStream) -> list[int]:
    """Return the ticks between the first frames of an AVI file; none for other files."""
    if stream.container.format.name != "avi":
        return []
    times = [entry.timestamp for entry in islice(stream.index_entries, _SAMPLED_ENTRIES)]
    return [after - before for before, after in pairwise(times)]


def _ticks_per_frame(stream: VideoStream) -> int:
    """Return the usual number of ticks between two frames of an AVI file; 1 for other files.

    AVI files count in ticks. In most files each tick has a frame. But a program that copies a video
    from another container may keep that container's fine ticks, and most of these have no frame.
    """
    return max(1, median_low(_steps(stream) or [1]))


def declared_frames(stream: VideoStream) -> int | None:
    """Return the number of frames that a container declares; None if it is unknown or unreliable.

    The count in the head of MP4 or AVI includes samples that are never shown: those that an edit
    list hides, and the empty samples with which AVI fills gaps. The index does not count them. The
    count of IVF is one of ticks.
    """
    kind = stream.container.format.name
    entries = stream.index_entries
    if kind.startswith("mov") and len(entries):
        return sum(not entry.is_discard for entry in entries)
    if kind == "avi":
        ticks = _ticks_per_frame(stream)
        # The index of a truncated file is missing, or FFmpeg made it from the frames read so far.
        if len(entries) and entries[-1].timestamp + 2 * ticks >= stream.frames:
            return len(entries)
        return None if stream.frames >= _AVI_TO_A_PIPE else -(-stream.frames // ticks) or None
    if kind == "mxf" and stream.time_base == 1 / (declared_rate(stream) or 1):
        return stream.duration
    return (stream.frames or None) if kind.startswith(("mov", "gif", "apng")) else None


def hidden_frames(stream: VideoStream) -> int:
    """Return the number of frames that an edit list of an MP4 or MOV file hides."""
    if not stream.container.format.name.startswith("mov"):
        return 0
    return sum(entry.is_discard for entry in stream.index_entries)


def declared_end(container: InputContainer, stream: VideoStream) -> float | None:
    """Return the declared end of a stream in seconds, on the clock of its frames.

    None if the container declares no end, or perhaps only the end of the sound.
    """
    if not container.format.name.startswith(("matroska", "ivf")):
        return None  # for other containers FFmpeg only guesses the end
    tag = _DURATION.match(stream.metadata.get("DURATION", ""))
    if tag:
        hours, minutes, seconds = tag.groups()
        return int(hours) * 3600 + int(minutes) * 60 + float(seconds)
    if container.format.name == "ivf" and stream.duration == _IVF_TO_A_PIPE:
        return None
    if len(container.streams) == 1 and container.duration is not None:
        return container.duration / av.time_base
    return None


def declared_bits(name: str, container: InputContainer, stream: VideoStream) -> int | None:
    """Return how many of their 16 bits the samples of a ``.cine`` file use; None if it has others.

    FFmpeg widens samples whose bits the setup of the Phantom camera states. Files without them may
    state the number of grey levels in the head of the pictures (``biClrUsed``, ``biClrImportant``).
    """
    if container.format.name != "cine" or stream.codec_context.bits_per_coded_sample:
        return None
    with suppress(OSError, struct.error), Path(name).open("rb") as file:
        file.seek(24)  # where the offset of this head stands
        file.seek(struct.unpack("<I", file.read(4))[0] + 32)
        bits = max(struct.unpack("<II", file.read(8))).bit_length() - 1
        return bits if 8 < bits < 16 else None
    return None


def orientation_of(frame: VideoFrame) -> tuple[bool, int]:
    """Return whether a frame must be mirrored, and its turn after that in degrees."""
    # PyAV's rotation is that of the first axis, which has the opposite direction if mirrored.
    matrix: Any = None
    # PyAV raises this error for a frame that also has data of a newer kind, such as EXIF of a JPEG.
    with suppress(ValueError):
        matrix = frame.side_data.get("DISPLAYMATRIX")
    terms = np.zeros(9) if matrix is None else np.frombuffer(matrix, np.int32).astype(float)
    mirrored = bool(terms[0] * terms[4] < terms[1] * terms[3])
    nearest = 90 * round(frame.rotation / 90)
    is_quarter = abs(frame.rotation - nearest) <= 1  # PyAV says 89 for 89.99
    return mirrored, (nearest + 180 * mirrored) % 360 if is_quarter else 0
