"""Video files and network streams, decoded by PyAV."""

from __future__ import annotations

from collections import deque
from fractions import Fraction
from functools import partial
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import av
from av.codec.context import Flags

from oppload_cli.environment import cores
from oppload_cli.errors import SourceError
from oppload_cli.video.declared import declared_end, declared_frames
from oppload_cli.video.ending import is_cut_short
from oppload_cli.video.frames import DecodeFacts, InputFacts, Picture
from oppload_cli.video.limits import VARIABLE, check_pixels, decoder_limit, most_pixels
from oppload_cli.video.luma import is_full_range, luma_plane

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from av.container import InputContainer
    from av.video.frame import VideoFrame
    from av.video.stream import VideoStream
    from numpy.typing import NDArray

    Shown = tuple[VideoFrame, NDArray[Any], int]  # with its luma and the bits of a sample

Value = TypeVar("Value")
OPEN_TIMEOUT_S, READ_TIMEOUT_S = 10.0, 10.0
MOST_DEMUX_ERRORS = 100  # in a row, without a packet between them
SILENT_CODECS = {"vp8"}  # with frame threads it predicts from what failed, without a word
# What one thread decodes as fast as the models follow.
QUICK_CODECS, QUICK_PIXELS = {"h264", "mpeg4", "mpeg2video"}, 1 << 20
FEW_CORES = 2
HELD_BACK = 4  # frames: as far as video codecs reorder them in practice
COVER_PICTURE = 0x400  # AV_DISPOSITION_ATTACHED_PIC
# Lists of other files: nothing but the file that the user named is ever opened.
PLAYLISTS = {"hls", "concat", "dash", "imf", "sdp", "webm_dash_manifest"}


class ContainerSource:
    """A video file, or a stream's address, as a source of pictures.

    Parameters
    ----------
    name : str
        A path or an address such as ``rtsp://host/stream``.
    threads : int
        Decoder threads; 0 chooses by the codec, the size and the cores.

    Raises
    ------
    SourceError
        If it cannot be opened, or holds no video, or no frame can be decoded, or
        it declares too many pixels.
    """

    def __init__(self, name: str, threads: int = 0) -> None:
        self.name = name
        self.decode = DecodeFacts()
        self.stopping = False
        self._remote = "://" in name
        self._careful = self._remote  # a stream cannot be read again
        self._threads = threads
        self._container = self._opened()
        try:
            self._stream = self._video_stream()
            self._codec = self._stream.codec_context.codec.canonical_name
            self._careful = self._careful or self._codec in SILENT_CODECS
            self._prepare()
            self._shown = self._steadily()
            self._first_shown = self._first_of_all()
            self._first = self._first_shown[0]
            self.decode.threads = self._stream.codec_context.thread_count
            self.facts = self._facts()
        except BaseException:
            self.close()
            raise
        self._last_time = 0.0
        self._longest_gap = 0.0

    def pictures(self) -> Iterator[Picture]:
        """Yield the decoded pictures; a damaged packet loses only its own frames.

        Yields
        ------
        Picture
            Its plane is a view that lives as long as the picture.
        """
        size = (self._first.width, self._first.height)
        for frame, plane, bits in chain([self._first_shown], self._shown):
            index = self.decode.decoded
            self.decode.decoded += 1
            self.decode.corrupt += frame.is_corrupt
            time = self._time(frame, index)
            self._longest_gap = max(self._longest_gap, time - self._last_time)
            self._last_time = time
            if (frame.width, frame.height) != size:
                size = (frame.width, frame.height)
                self.decode.note(f"the size becomes {size[0]} x {size[1]} at frame {index}")
            yield Picture(index, time, plane, bits, is_full_range(frame, self._codec), frame)

    def finish(self) -> None:
        """Count the frames that the container declared and that never came."""
        self.decode.missing = self._missing()
        if self.decode.corrupt:
            self.decode.note(f"{self.decode.corrupt} frames are damaged")
        if self.decode.missing:
            self.decode.note(f"{self.decode.missing} declared frames never came")
        if not self._remote and is_cut_short(self.name, self._container.format.name):
            self.decode.failed("the file ends too early")

    def close(self) -> None:
        """Close the container; may be called twice."""
        self._container.close()

    def _missing(self) -> int:
        declared = declared_frames(self._container, self._stream) or self.facts.frames_declared
        if declared is not None:
            return max(0, declared - self.decode.decoded)
        rate = self.facts.frame_rate
        return self._missing_at_the_end(float(rate)) if rate else 0

    def _missing_at_the_end(self, rate: float) -> int:
        end = declared_end(self._container, self._stream)
        if end is None or self._first.pts is None:
            return 0
        # Durations are rounded, some writers count the last frame's and some do not, and
        # how long the last frame of a variable rate lasts cannot be known.
        lost = end - self._first.time - self._last_time
        return round(lost * rate - 1) if lost > 1.5 * max(1 / rate, self._longest_gap) else 0

    def _opened(self) -> InputContainer:
        if not self._remote:
            self._check_file()
        try:
            return av.open(
                # The prefix keeps a name such as "a:b.mp4" from being taken for an address.
                self.name if self._remote else f"file:{self.name}",
                timeout=(OPEN_TIMEOUT_S, READ_TIMEOUT_S) if self._remote else None,
                metadata_errors="replace",
                options={"max_pixels": decoder_limit()},
            )
        except (av.error.FFmpegError, OSError, ValueError) as error:
            raise SourceError(
                f"{self.name}: not a video that can be read ({_reason(error)}); "
                f"check the file, or convert it"
            ) from error

    def _check_file(self) -> None:
        path = Path(self.name)
        try:
            size = path.stat().st_size
        except FileNotFoundError as error:
            raise SourceError(f"{self.name}: no such file; check the path") from error
        except OSError as error:
            raise SourceError(
                f"{self.name}: cannot be read ({_reason(error)}); check the path"
            ) from error
        if path.is_file() and size == 0:
            raise SourceError(f"{self.name}: the file is empty; copy or record it again")

    def _video_stream(self) -> VideoStream:
        if not self._remote and self._container.format.name in PLAYLISTS:
            raise SourceError(f"{self.name}: only names other files; give these instead")
        # A cover picture is a video stream to the container, and not to anybody else.
        streams = [
            stream
            for stream in self._container.streams.video
            if not stream.disposition.value & COVER_PICTURE
        ]
        if not streams:
            raise SourceError(f"{self.name}: holds no video stream; give a file with pictures")
        # The stubs promise a codec; a stream of an unknown one has none.
        codec: Any = streams[0].codec_context
        if codec is None:
            raise SourceError(f"{self.name}: its codec is unknown here; convert it, e.g. to H.264")
        check_pixels(self.name, codec.width, codec.height)
        return streams[0]

    def _prepare(self) -> None:
        codec = self._stream.codec_context
        codec.thread_type = "SLICE" if self._careful else "AUTO"
        # What is made of damage depends on the number of threads.
        alone = self._careful and not self._remote
        codec.thread_count = 1 if alone else self._threads or self._decoder_threads()
        one_under_way = {"max_frame_delay": "1"} if self._careful else {}  # of dav1d
        codec.options = {"max_pixels": decoder_limit(), **one_under_way}
        # Concealed frames are wanted, and counted as corrupt: leaving them out would
        # shorten the video without a word.
        codec.flags |= Flags.output_corrupt

    def _decoder_threads(self) -> int:
        """Return how many threads decode; 0 leaves the choice to the decoder."""
        codec = self._stream.codec_context
        quick = self._codec in QUICK_CODECS and codec.width * codec.height <= QUICK_PIXELS
        # On two cores flow and models leave none idle, and threads that wait for each
        # other cost an eighth of a run. Where one does not do, those that have to wait
        # for a core are evened out by one more than the decoder would choose.
        if quick and cores() <= FEW_CORES:
            return 1
        return 4 if cores() == FEW_CORES else 0

    def _steadily(self) -> Iterator[Shown]:
        """Yield the frames so that damage has the same effect at every run.

        Decoding several frames at once is fastest. But it reports an error late, loses
        what is under way when it comes in the end, and conceals damage by whatever the
        other threads have done so far. So at its first sign the file is decoded again
        by one thread, and what has been yielded is passed over. A few frames are held
        back: one that refers to a damaged one may come before it.
        """
        count = 0
        if not self._careful:
            held: deque[Shown] = deque()
            damaged = False
            for shown in self._decoded():
                damaged = self.decode.failures > 0 or shown[0].is_corrupt
                if damaged:
                    break
                held.append(shown)
                if len(held) > HELD_BACK:
                    count += 1
                    yield held.popleft()
            damaged = damaged or self.decode.failures > 0
            while held and not damaged:
                count += 1
                yield held.popleft()
            if self.stopping or (count and not damaged and not self._missing()):
                return
            self._start_again()
        for place, shown in enumerate(self._decoded()):
            if place >= count:
                yield shown
            else:  # several threads may have passed it on before they knew
                self.decode.corrupt += shown[0].is_corrupt

    def _start_again(self) -> None:
        self.decode.failures = self.decode.corrupt = 0
        self.decode.messages.clear()
        self._careful = True
        self._container.close()
        self._container = self._opened()
        self._stream = self._video_stream()
        self._prepare()

    def _first_of_all(self) -> Shown:
        first = next(self._shown, None)
        if first is None:
            reasons = "; ".join(self.decode.messages) or "it holds no frame"
            # So a decoder refuses a picture for its size; often it then forgets that size.
            if "invalid argument" in reasons or not self._stream.codec_context.width:
                reasons += (
                    f", or its pictures have more than {most_pixels()} pixels: see {VARIABLE}"
                )
            raise SourceError(
                f"{self.name}: no frame could be decoded ({reasons}); check or convert the file"
            )
        check_pixels(self.name, first[0].width, first[0].height)
        return first

    def _decoded(self) -> Iterator[Shown]:
        for packet in self._packets():
            if packet.is_corrupt:
                self.decode.failed("a packet is cut or damaged")
            for frame in self._attempt(packet.decode) or ():
                shown = self._attempt(partial(luma_plane, frame))
                if shown is not None:
                    yield frame, *shown

    def _attempt(self, decode: Callable[[], Value]) -> Value | None:
        """Return what a step of decoding gives; where it fails, count that and go on."""
        try:
            return decode()
        except (av.error.FFmpegError, ValueError) as error:
            self.decode.failed(_reason(error))
            return None

    def _packets(self) -> Iterator[Any]:
        packets = self._container.demux(self._stream)
        errors = 0
        while not self.stopping:
            try:
                packet = next(packets)
            except StopIteration:
                return
            except (av.error.FFmpegError, OSError) as error:
                self.decode.failed(_reason(error))
                errors += 1
                if errors > MOST_DEMUX_ERRORS or self._remote:
                    yield av.Packet()  # empty: the decoder gives what it still holds
                    return
                packets = self._container.demux(self._stream)
            else:
                errors = 0
                yield packet

    def _time(self, frame: VideoFrame, index: int) -> float:
        """Return the presentation time minus that of the first frame, in seconds."""
        if frame.pts is not None and self._first.pts is not None and self._stream.time_base:
            base = self._stream.time_base  # a fraction: its terms give the nearest float too
            return (frame.pts - self._first.pts) * base.numerator / base.denominator
        rate = self.facts.frame_rate
        step = 1 / rate if rate else Fraction(1)
        # Where only some frames carry a time, the others follow the one before.
        return float(index * step) if self._first.pts is None else self._last_time + float(step)

    def _facts(self) -> InputFacts:
        frame, stream = self._first, self._stream
        rotation = int(frame.rotation) % 360
        rotation = rotation if rotation % 90 == 0 else 0
        sideways = rotation in (90, 270)
        aspect = stream.sample_aspect_ratio
        return InputFacts(
            name=self.name,
            kind="stream" if self._remote else "container",
            width=frame.height if sideways else frame.width,
            height=frame.width if sideways else frame.height,
            frame_rate=_rate(stream),
            frames_declared=declared_frames(self._container, stream),
            rotation=rotation,
            codec=self._codec,
            pixel_format=frame.format.name,
            colour_range="full" if is_full_range(frame, self._codec) else "limited",
            pixel_aspect=Fraction(aspect) if aspect else None,
            bytes=None if self._remote else self._container.size,
        )


def _rate(stream: VideoStream) -> Fraction | None:
    for rate in (stream.average_rate, stream.guessed_rate, stream.base_rate):
        if rate:
            return Fraction(rate)
    return None


def _reason(error: BaseException) -> str:
    return str(getattr(error, "strerror", None) or error).strip().rstrip(".").lower() or "unknown"
