"""Opens video files and network streams with FFmpeg, and says why one cannot be opened."""

from __future__ import annotations

import re
from contextlib import suppress
from fractions import Fraction
from itertools import islice
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any

import av
from av.stream import Disposition

from oppload_cli.errors import SourceError, cannot_read, reason_of
from oppload_cli.files.reading import is_file
from oppload_cli.frame_times import FrameTimes, ticks
from oppload_cli.video.declared import video_streams
from oppload_cli.video.frames import USUAL_BITS, check_pixels, max_pixels
from oppload_cli.video.inputs import is_address

if TYPE_CHECKING:
    from av.container import InputContainer
    from av.video.format import VideoFormat
    from av.video.stream import VideoStream

_OPEN_TIMEOUT_S = 10.0
_SAMPLED_PACKETS = 300  # from which the usual rate is taken
_NEAR = 0.1  # largest relative difference between a declared rate and the usual one
_CAMERA = re.compile(r"(camera)?[0-9]")  # as users of other programs may name one
_LFS_POINTER = b"version https://git-lfs"  # such a file stands for one that was not fetched
_MICROSCOPE = "is a file of a microscope; export its pictures as TIFF, for example with Fiji"
# Formats that laboratories use and nothing here reads, with the way out.
_UNREAD = {
    ".mat": "holds arrays of MATLAB; save the pictures as .npy, or as HDF5 with h5create",
    ".mraw": "is a raw video of Photron; export it as TIFF or as an uncompressed AVI",
    ".sbfmf": "is a compressed movie of Ctrax; convert it to .ufmf with any2ufmf",
    **dict.fromkeys((".czi", ".lif", ".nd2", ".oib"), _MICROSCOPE),
}
_RTP_ADVICE = (
    "try ffmpeg -protocol_whitelist file,rtp,udp -i FILE.sdp -c copy -f matroska - | "
    "oppload run /dev/stdin"
)
_TABLE_ADVICE = "'oppload plot' draws a result, and --files-from takes a list of inputs"
# These formats list other files; oppload opens only the file that the user named.
_PLAYLISTS = {"hls", "concat", "dash", "imf", "sdp", "webm_dash_manifest"}


def is_read_once(name: str) -> bool:
    """Return whether an input cannot be read again, such as a stream or a pipe."""
    return is_address(name) or not is_file(name)


def open_container(name: str, read_timeout_s: float) -> InputContainer:
    """Open a file or a stream; a stream may take `read_timeout_s` seconds for each packet.

    Raises SourceError if there is no such file, or FFmpeg cannot read it as a video.
    """
    remote = is_address(name)
    if not remote:
        _check_file(name)
    most_pixels = decoder_limit()  # outside `try`: a wrong setting is no fault of the file
    began_s = monotonic()
    try:
        return av.open(
            # Without the prefix FFmpeg would take a name such as "a:b.mp4" for an address.
            name if remote else f"file:{name}",
            timeout=(_OPEN_TIMEOUT_S, read_timeout_s) if remote else None,
            metadata_errors="replace",
            options={"max_pixels": most_pixels},
        )
    except (av.error.FFmpegError, OSError, ValueError) as error:
        advice = "check the address" if remote else "check the file, or convert it"
        reason, log = reason_of(error), str(getattr(error, "log", None))
        # At the time limit FFmpeg gives ExitError, or for RTSP another error.
        if remote and monotonic() - began_s >= _OPEN_TIMEOUT_S:
            reason = f"no video came within {_OPEN_TIMEOUT_S:g} s"
        elif "moov atom not found" in log:
            reason = "it lacks the index of an MP4, as after an unfinished recording or copy"
        elif "SDP file" in log or "'rtp' not on whitelist" in log:
            reason, advice = "RTP needs an SDP file and a pipe", _RTP_ADVICE
        elif Path(name).suffix.lower() == ".csv" and not remote:
            reason, advice = "it is a table", _TABLE_ADVICE
        raise SourceError(f"{name}: not a video that can be read ({reason}); {advice}") from error


def _check_file(name: str) -> None:
    path = Path(name)
    try:
        size = path.stat().st_size
    except (FileNotFoundError, ValueError) as error:  # a text that can be no file's name
        reason = "no such file; check the path"
        if name == "-":
            reason = "give /dev/stdin to read from standard input"
        elif _CAMERA.fullmatch(name):
            reason = f"no such file; write camera:{name[-1]} for a camera"
        elif path.is_symlink():
            reason = "is a link to a file that does not exist; fetch or restore that file"
        raise SourceError(f"{name}: {reason}") from error
    except OSError as error:
        raise cannot_read(name, error) from error
    if not path.is_file():
        return
    if size == 0:
        raise SourceError(f"{name}: the file is empty; copy or record it again")
    if path.suffix.lower() in _UNREAD:
        raise SourceError(f"{name}: {_UNREAD[path.suffix.lower()]}")
    # If the file cannot be read, opening the video raises the error.
    with suppress(OSError), path.open("rb") as file:
        if file.read(len(_LFS_POINTER)) == _LFS_POINTER:
            raise SourceError(
                f"{name}: is a pointer of Git LFS, not the video itself; fetch the video with "
                "git lfs pull"
            )


def video_stream(name: str, container: InputContainer, number: int | None) -> VideoStream:
    """Return the video stream `number` of an open container, counted from 1.

    If `number` is None, it is the one that programs show, as FFmpeg chooses it.
    A stream of several frames comes before a still, such as a thumbnail or the first picture of an
    animated AVIF; then one with the default flag, then the largest, then the first. Raises
    SourceError if there is none, its codec is unknown, or it declares too many pixels.
    """
    if not is_address(name) and container.format.name in _PLAYLISTS:
        raise SourceError(f"{name}: only names other files; give those files instead")
    streams = video_streams(container)
    if not streams:
        raise SourceError(
            f"{name}: holds no video stream; give a file with pictures, or a complete copy of it"
        )
    if number is not None and number > len(streams):
        held = "1 video stream" if len(streams) == 1 else f"{len(streams)} video streams"
        raise SourceError(f"{name}: holds {held}; there is no stream {number}")
    chosen = _shown(name, streams) if number is None else streams[number - 1]
    # PyAV's type stubs promise a codec, but a stream with an unknown codec has none.
    codec: Any = chosen.codec_context
    if codec is None:
        raise SourceError(f"{name}: FFmpeg does not know its codec; convert it, e.g. to H.264")
    check_pixels(name, codec.width, codec.height, stored_bits(codec.format))
    return chosen


def _shown(name: str, streams: list[VideoStream]) -> VideoStream:
    frames = [stream.frames for stream in streams]  # 0 if unknown
    if len(streams) > 1 and 0 in frames and not is_read_once(name):
        frames = _sampled_frames(name, streams)
    ranks = [
        (count != 1, Disposition.default in stream.disposition, _pixels(stream))
        for stream, count in zip(streams, frames, strict=True)
    ]
    return streams[ranks.index(max(ranks))]


def _sampled_frames(name: str, streams: list[VideoStream]) -> list[int]:
    """Return how many of the first packets of a file belong to each of its streams."""
    found = dict.fromkeys((stream.index for stream in streams), 0)
    with open_container(name, 0) as container, suppress(av.error.FFmpegError, OSError, IndexError):
        for packet in islice(container.demux(video_streams(container)), _SAMPLED_PACKETS):
            found[packet.stream.index] += packet.size > 0
    return list(found.values())


def _pixels(stream: VideoStream) -> int:
    codec: Any = stream.codec_context
    return 0 if codec is None else codec.width * codec.height


def stored_bits(pixel_format: VideoFormat | None) -> int:
    """Return the bits of memory that a decoder needs per pixel; the usual number if unknown."""
    return pixel_format.padded_bits_per_pixel if pixel_format else USUAL_BITS


def decoder_limit() -> str:
    """Return the value of FFmpeg's option ``max_pixels``.

    It is higher than :func:`max_pixels`, because decoders round sizes up and add margins before
    they compare. The limit stops a stream whose pictures are larger than its container declares.
    """
    return str(min(2 * max_pixels() + (1 << 16), (1 << 31) - 1))


def usual_rate(name: str, number: int) -> Fraction | None:
    """Return the usual number of frames per second of a stream, by the times of its first packets.

    None if they have no times, or are hours apart. Source:
    :attr:`oppload_cli.frame_times.FrameTimes.rate`.
    """
    with open_container(name, 0) as container:
        stream = video_stream(name, container, number)
        given = []
        with suppress(av.error.FFmpegError, OSError, IndexError):  # of a damaged file the start
            for packet in islice(container.demux(stream), _SAMPLED_PACKETS):
                given += [] if packet.pts is None else [packet.pts]
        times = FrameTimes(None, stream.time_base)
        for pts in sorted(given):
            times.step(ticks(pts * (stream.time_base or 0)))
    return Fraction(str(round(times.rate or 0, 3))) or None


def is_near(rate: Fraction, other: Fraction) -> bool:
    """Return whether two rates differ by at most a tenth."""
    return abs(rate / other - 1) <= _NEAR
