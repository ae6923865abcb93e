"""Video files and network streams, decoded by PyAV."""

from __future__ import annotations

import atexit
import errno
import math
from collections import deque
from dataclasses import replace
from fractions import Fraction
from functools import partial
from itertools import chain
from time import monotonic, perf_counter
from typing import TYPE_CHECKING, Any, TypeVar

import av
from av.codec.context import Flags
from av.video.frame import PictureType
from av.video.reformatter import ColorTrc

from oppload_cli.errors import SourceError, counted, reason_of, without_login
from oppload_cli.frame_times import seconds_of, ticks
from oppload_cli.processes import cores
from oppload_cli.video.arrivals import Arrivals
from oppload_cli.video.declared import (
    declared_bits,
    declared_end,
    declared_frames,
    declared_rate,
    hidden_frames,
    is_rate_assumed,
    orientation_of,
    video_streams,
)
from oppload_cli.video.demuxer import (
    decoder_limit,
    is_near,
    is_read_once,
    open_container,
    stored_bits,
    usual_rate,
    video_stream,
)
from oppload_cli.video.frames import (
    MAX_PIXELS,
    InputFacts,
    Picture,
    PictureSource,
    check_pixels,
    max_pixels,
    no_true_rate,
    too_large,
    turned,
)
from oppload_cli.video.inputs import is_address, is_real_time
from oppload_cli.video.planes import is_full_range, is_transparent, luma_plane

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from av.packet import Packet
    from av.video.frame import VideoFrame
    from numpy.typing import NDArray

    Decoded = tuple[VideoFrame, NDArray[Any], int]  # a frame, its luma, the bits of a sample


Value = TypeVar("Value")
_HDR: dict[int, str] = {ColorTrc.SMPTE2084: "PQ", ColorTrc.ARIB_STD_B67: "HLG"}
_LIVE_FORMAT = "mpjpeg"  # images that a network camera sends one by one over HTTP, without times
READ_TIMEOUT_S = 10.0
_MOST_DEMUX_ERRORS = 100  # most errors without a packet between them
# These decoders conceal damage without an error: VP8 with frame threads, because it predicts
# pictures from failed frames, and MPEG-1 and MPEG-2 with slice threads. The decoder of HEVC does
# so too, but for its large frames one thread would be too slow.
_SILENT_CODECS = {"vp8", "mpeg1video", "mpeg2video"}
# Slice threads decode parts of the same frame. With them these codecs give the same pixels for any
# number of threads. With frame threads the pixels differ, once an earlier frame has been lost.
_INDEPENDENT_SLICES = {"ffv1", "jpeg2000"}
# On two cores one thread decodes small frames of these codecs as fast as the detectors work.
_QUICK_CODECS = {"h264", "mpeg4"}
_SMALL_PIXELS = 1 << 20
_FEW_CORES = 2
_LONGEST_ERROR = 80  # characters
_JUMP_S = 1.0  # of the time where two transport streams were joined
# Packets of these containers have only decode times. From them FFmpeg computes presentation times,
# which are wrong for H.264 with B-frames or gaps. But each decoded frame also carries the decode
# time of the last packet that it needed. These times increase by the durations of the frames.
_DECODE_TIMES = {"asf", "avi", "mxf"}
# MPEG-4 does not code a picture that equals the one before, and gives no frame for its few bytes.
_NOT_CODED_BYTES = 19  # at most, as FFmpeg has it
# The clock of these streams has 33 bits. FFmpeg takes a step back by some time, as where streams
# were joined, for a clock that began anew, and adds 2^33.
_WRAPPING, _WRAP = {"mpegts", "mpeg"}, 1 << 33
_FINE_TICKS = 1000  # per second; from here on a tick has hardly ever a frame of its own
_HELD_BACK = 4  # most frames by which video codecs change the order of frames in practice
# Decoders that log errors for intact files too, with the beginnings of those errors that mean
# damage. H.264 logs errors for streams of cameras, but marks the frames that it conceals. MJPEG
# logs errors for data that cameras add to the picture.
_TALKATIVE = {"h264": (), "mjpeg": ("overread", "error", "sos", "mjpeg_decode")}

if av.logging.get_level() is None:  # PyAV counts the decoders' errors only if a level is set
    av.logging.set_level(av.logging.PANIC)  # this level prints no error
    # Otherwise threads of a decoder that was never closed would wait for the ended interpreter.
    atexit.register(av.logging.set_level, None)


class ContainerSource(PictureSource):
    """A source of pictures from a video file, or from a stream such as ``rtsp://host/stream``.

    If `threads` is 0, the codec, the size and the cores determine the number of decoder threads.
    With `true_rate`, the frames per second that the camera took, all times are scaled so that the
    declared rate becomes this rate. `number` counts video streams from 1; None reads the one that
    programs show. Raises SourceError if the input cannot be opened, has no video
    or declares too many pixels, if no frame can be decoded, or if it has no rate to be scaled.
    """

    def __init__(
        self,
        name: str,
        threads: int = 0,
        true_rate: Fraction | None = None,
        number: int | None = None,
    ) -> None:
        super().__init__()
        self.name = name
        self._errors = 0  # number of errors that decoders have logged in this process
        self._not_coded = 0  # number of declared frames without a picture of their own
        self._same_times = True  # whether all packets so far are presented when they are decoded
        self._reordered = False  # whether a picture has come that is shown before an earlier one
        self._wrapped = 0  # ticks of the file that FFmpeg has added to the times by mistake
        self._before: int | None = None  # time of the picture before in ticks of the file
        self._remote, self._read_once = is_address(name), is_read_once(name)
        self._arrived_s = 0.0  # when the latest packet came
        self._arrivals = Arrivals()
        self._threads = threads
        self._container = open_container(name, READ_TIMEOUT_S)
        try:
            self._stream = video_stream(name, self._container, number)
            self._number = video_streams(self._container).index(self._stream) + 1
            codec = self._stream.codec_context
            self._codec = codec.codec.canonical_name
            self._is_small = codec.width * codec.height <= _SMALL_PIXELS
            small_hevc = self._codec == "hevc" and self._is_small
            self._bits = declared_bits(name, self._container, self._stream) or 16
            careful_codecs = _SILENT_CODECS | _INDEPENDENT_SLICES
            # Careful decoding uses no frame threads; an input without a second pass needs it.
            self._careful = self._read_once or small_hevc or self._codec in careful_codecs
            self._prepare()
            frames = self._reproducibly_decoded()
            first = self._first_of(frames)
            self._first, self._frames = first[0], chain([first], frames)
            self._first_arrived_s = self._arrived_s
            self.decode.threads = self._stream.codec_context.thread_count
            self.facts = self._facts()
            self._rate, self._slowed = self.facts.frame_rate, Fraction(1)
            if true_rate is not None:
                self._take_rate(true_rate)
        except BaseException:
            self.close()
            raise
        self._last_time = self._latest_time = 0  # ticks
        self._longest_gap = 0

    def pictures(self) -> Iterator[Picture]:
        """Yield the decoded pictures; a damaged packet loses only its own frames."""
        size = (self._first.width, self._first.height)
        for frame, plane, bits in self._frames:
            index = self.decode.decoded
            self.decode.decoded += 1
            self.decode.corrupt += frame.is_corrupt
            time = self._time(frame, index)
            self._longest_gap = max(self._longest_gap, time - self._last_time)
            self._last_time = time
            self._latest_time = max(self._latest_time, time)
            if (frame.width, frame.height) != size:
                size = (frame.width, frame.height)
                self.decode.note(f"the size becomes {size[0]} x {size[1]} at frame {index}")
            full_range = is_full_range(frame, self._codec)
            yield Picture(index, round(time / self._slowed), plane, bits, full_range, frame)

    def finish(self) -> None:
        """Count the declared frames that never came."""
        if is_transparent(self._first):
            self.decode.note(
                "transparency is left out; draw the pictures on an opaque background first"
            )
        if self._first.interlaced_frame:
            self.decode.note(
                "the pictures are interlaced: moving edges look like combs, so that responses are "
                "low; deinterlace them first, as FFmpeg's filter yadif does"
            )
        if curve := _HDR.get(self._first.color_trc):
            self.decode.note(
                f"the pictures are HDR ({curve}), whose contrast as coded is low, and so are "
                "responses; convert them to SDR first"
            )
        turn = self._first.rotation
        if abs(turn - 90 * round(turn / 90)) > 1:
            self.decode.note(
                f"the file asks for a turn by {turn} degrees, which is left out: only quarter "
                "turns are made"
            )
        if hidden := hidden_frames(self._stream):
            verb = "is" if hidden == 1 else "are"
            self.decode.note(
                f"{counted(hidden, 'frame')} that an edit list of the file hides {verb} not read"
            )
        self.decode.missing = self._missing()
        if corrupt := self.decode.corrupt:
            verb = "is" if corrupt == 1 else "are"
            self.decode.note(f"{counted(corrupt, 'frame')} {verb} damaged")
        if missing := self.decode.missing:
            self.decode.note(f"{counted(missing, 'declared frame')} never came")

    def close(self) -> None:
        """Close the container; may be called twice."""
        # First let the decoder's threads end. They need Python's lock to log an error, and closing
        # the container holds this lock while it waits for them.
        if hasattr(self, "_stream"):
            self._stream.codec_context.flush_buffers()
        if hasattr(self, "_container"):
            self._container.close()

    __del__ = close

    def _missing(self) -> int:
        """Return how many declared frames never came, by their declared number or their end."""
        declared = declared_frames(self._stream) or self.facts.frames_declared
        if declared is not None:
            return max(0, declared - self._not_coded - self.decode.decoded)
        end = declared_end(self._container, self._stream)
        first, base = self._first.pts, self._stream.time_base
        if end is None or first is None or base is None:
            return 0
        latest_s = seconds_of(self._latest_time)
        # The declared rate may be far too high.
        measured = (self.decode.decoded - 1) / (latest_s or math.inf)
        stated = float(self._rate or measured)
        rate = min(stated, measured) or stated
        # Up to 1.5 frame durations may lack without damage: programs round durations, only some
        # programs count the last frame's duration, and at a variable rate it is unknown.
        lost = end - float(first * base) - latest_s
        if not rate or lost <= 1.5 * max(1 / rate, seconds_of(self._longest_gap)):
            return 0
        return max(1, round(lost * rate - 1))

    def _prepare(self) -> None:
        """Set the options of the decoder, and open it."""
        codec = self._stream.codec_context
        codec.thread_type = "SLICE" if self._careful else "AUTO"
        # Several threads conceal damage by other pixels than one thread does.
        several = not self._careful or self._remote or self._codec in _INDEPENDENT_SLICES
        codec.thread_count = (self._threads or self._decoder_threads()) if several else 1
        # An option of dav1d: decode one frame at a time.
        one_at_a_time = {"max_frame_delay": "1"} if self._careful else {}
        # PNG and HEVC decoders check checksums only with the option `err_detect`.
        codec.options = {"max_pixels": decoder_limit(), "err_detect": "crccheck", **one_at_a_time}
        # Frames with concealed damage are kept, and counted as corrupt: without them the video
        # would be shorter.
        codec.flags |= Flags.output_corrupt
        # Else decoders keep columns at the left that the stream crops: they cut only at addresses
        # that suit the processor.
        codec.flags |= Flags.unaligned
        try:
            codec.open(strict=False)
        except av.error.BlockingIOError:  # the system gives no further thread
            codec.thread_count = 1
        except av.error.FFmpegError:
            pass  # decoding raises the same error, and `_attempt` counts it

    def _decoder_threads(self) -> int:
        if cores() > _FEW_CORES:
            return 0  # the decoder chooses
        # On two cores flow and detectors already use both. Decoder threads that wait for each
        # other then cost an eighth of a run. If one thread is too slow, four are faster than the
        # three that the decoder would choose.
        if self._codec in _QUICK_CODECS and self._is_small:
            return 1
        return 4 if cores() == _FEW_CORES else 0

    def _reproducibly_decoded(self) -> Iterator[Decoded]:
        """Yield the frames so that damage has the same effect in every run.

        Several threads are fastest. But they report an error late, lose frames at the end, and
        conceal damage by pixels that depend on how far each thread has come. So at the first sign
        of damage one thread decodes the file again from its start, and this method skips the frames
        that it has yielded already. It always holds back a few frames, because a frame that depends
        on a damaged frame may come before that frame.
        """
        count = 0
        if not self._careful:
            held: deque[Decoded] = deque()
            damaged = False
            for decoded in self._decoded():
                damaged = self.decode.failures > 0 or decoded[0].is_corrupt
                if damaged:
                    break
                held.append(decoded)
                if len(held) > _HELD_BACK:
                    count += 1
                    yield held.popleft()
            damaged = damaged or self.decode.failures > 0
            while held and not damaged:
                count += 1
                yield held.popleft()
            if self.stopping or (count and not damaged and not self._missing()):
                return
            try:
                self._start_again()
            except SourceError:  # the file no longer exists, or was replaced
                self.decode.failed("it could not be opened again to be decoded by one thread")
                yield from held
                return
        for place, decoded in enumerate(self._decoded()):
            if place >= count:
                yield decoded
            else:  # this damaged frame was yielded before the damage was known
                self.decode.corrupt += decoded[0].is_corrupt

    def _start_again(self) -> None:
        container = open_container(self.name, READ_TIMEOUT_S)
        stream = video_stream(self.name, container, self._number)
        self.decode.failures = self.decode.corrupt = self._not_coded = 0
        self.decode.messages.clear()
        self._careful = True
        self.close()
        self._container, self._stream = container, stream
        self._prepare()

    def _first_of(self, frames: Iterator[Decoded]) -> Decoded:
        """Return the first frame; raise SourceError if there is none, or if it is too large."""
        first = next(frames, None)
        if first is None:
            reasons = "; ".join(self.decode.messages) or "it holds no frame"
            remedy = "check what the server sends" if self._remote else "check or convert the file"
            if self._read_once and not self._remote and "mp4" in self._container.format.name:
                remedy = (
                    "an MP4 with its index at its end cannot be read from a pipe: give the file "
                    "itself, or pipe Matroska"
                )
            # A decoder that refuses a picture because of its size says "invalid argument", and
            # often no longer knows the size.
            elif "invalid argument" in reasons or not self._stream.codec_context.width:
                reasons += (
                    f", or its pictures have more than {max_pixels()} pixels: see {MAX_PIXELS}"
                )
            raise SourceError(f"{self.name}: no frame could be decoded ({reasons}); {remedy}")
        frame = first[0]
        check_pixels(self.name, frame.width, frame.height, stored_bits(frame.format))
        return first

    def _decoded(self) -> Iterator[Decoded]:
        """Decode the packets once, and count failures; see `_reproducibly_decoded`."""
        self._errors = av.logging.get_last_error()[0]
        joinable = self._container.format.name == "mpegts" and not self._remote
        for packet, damaged in _with_damage(self._packets(), joinable=joinable):
            if damaged:
                self.decode.failed("a packet is cut or damaged")
            if self._careful:  # leave out the errors that the demuxer has logged
                self._errors = av.logging.get_last_error()[0]
            frames = self._attempt(partial(self._stream.decode, packet))
            logged = self._logged_error()
            if logged and frames is not None:
                self.decode.failed(logged)
            if frames == [] and self._codec == "mpeg4" and packet is not None:
                self._not_coded += 0 < packet.size <= _NOT_CODED_BYTES
            for frame in frames or ():
                luma = self._attempt(partial(_checked_luma, frame))
                if luma is not None:
                    yield frame, luma[0], min(luma[1], self._bits)

    def _attempt(self, decode: Callable[[], Value]) -> Value | None:
        """Return the result of a decoding step; if it fails, count a failure and return None."""
        try:
            return decode()
        except (av.error.FFmpegError, ValueError) as error:
            self.decode.failed(reason_of(error))
            return None

    def _logged_error(self) -> str | None:
        """Return the error, if any, that was logged since `_errors` was counted.

        Some decoders conceal damage without raising an error or marking the frame. The log belongs
        to the process: with several videos at a time, an error may be counted for the wrong video.
        """
        before, (self._errors, last) = self._errors, av.logging.get_last_error()
        if self._errors == before or last is None:
            return None
        # With several threads an H.264 frame may come before it is marked as damaged. Then every
        # logged error counts, and the file is decoded again.
        talkative = self._codec in _TALKATIVE and (self._careful or self._codec != "h264")
        if talkative and not last[2].startswith(_TALKATIVE[self._codec]):
            return None
        return f"the decoder reports an error ({reason_of(ValueError(last[2]))[:_LONGEST_ERROR]})"

    def _packets(self) -> Iterator[Packet[Any] | None]:
        """Yield the packets; None tells the decoder to give out the frames that it still holds."""
        packets = self._container.demux(self._stream)
        next_dts: int | None = None
        errors = 0
        while not self.stopping:
            asked_s = monotonic()
            try:
                packet = next(packets)
            except (StopIteration, IndexError):
                return  # IndexError comes from PyAV at the end, if a further stream began meanwhile
            except (av.error.FFmpegError, OSError) as error:
                end = self._is_end_without_length(error)
                if not end:
                    self._broke_off(reason_of(error), asked_s)
                errors += 1
                if end or errors > _MOST_DEMUX_ERRORS or self._remote:
                    yield None
                    return
                packets = self._container.demux(self._stream)
            else:
                errors = 0
                self._arrived_s = perf_counter()  # `monotonic` has steps of 16 ms on Windows
                stalled = self._stalled(asked_s)
                self._same_times &= not packet.size or packet.pts == packet.dts
                reordered = self._stream.codec_context.has_b_frames
                if packet.size and reordered and self._container.format.name in _DECODE_TIMES:
                    # FFmpeg leaves out some decode times of these packets, and repeats others.
                    known = [dts for dts in (packet.dts, next_dts) if dts is not None]
                    packet.dts = max(known, default=None)
                    next_dts = None if packet.dts is None else packet.dts + 1
                yield packet
                if stalled:  # at the time limit FFmpeg gives out the latest packet of RTSP
                    self._broke_off("", asked_s)
                    yield None
                    return

    def _is_end_without_length(self, error: Exception) -> bool:
        """Return whether an error is the end of an HTTP response without a stated length.

        FFmpeg reports the regular end of such a connection as a device error. `_missing` then finds
        out from the container whether all frames have come.
        """
        is_http = self.name.lower().startswith(("http://", "https://"))
        device_error = getattr(error, "errno", None) == errno.EIO
        return is_http and device_error and self._container.size < 0

    def _stalled(self, asked_s: float) -> bool:
        """Return whether a packet of a stream, asked for at `asked_s`, comes too late."""
        return self._remote and monotonic() - asked_s >= READ_TIMEOUT_S

    def _broke_off(self, reason: str, asked_s: float) -> None:
        """Count the end of a stream, or a fault of a file, in place of a packet."""
        if self._stalled(asked_s):
            reason = f"no picture came for {READ_TIMEOUT_S:g} s"
        self.decode.failed(f"the stream broke off ({reason})" if self._remote else reason)

    def _time(self, frame: VideoFrame, index: int) -> int:
        """Return the presentation time minus that of the first frame, in ticks."""
        if self._is_live:
            time_s = self._arrivals.step(self._arrived_s - self._first_arrived_s)
            self.decode.smoothed = self._arrivals.smoothed
            return ticks(time_s)
        self._reordered |= frame.pict_type == PictureType.B
        now, first = self._clock(frame), self._clock(self._first)
        if now is not None and first is not None and self._stream.time_base:
            if self._container.format.name in _WRAPPING and self._before is not None:
                self._wrapped += _WRAP * (now - self._wrapped - self._before > _WRAP // 2)
            self._before = now - self._wrapped
            return ticks((self._before - first) * self._stream.time_base)
        step = 1 / self._rate if self._rate else Fraction(1)
        # If only some frames have a time, each other frame comes one step after the frame before.
        return ticks(index * step) if first is None else self._last_time + ticks(step)

    @property
    def _is_live(self) -> bool:
        """Whether the time of a frame follows from its arrival, as there is no other."""
        return self._remote and self._container.format.name == _LIVE_FORMAT

    def _clock(self, frame: VideoFrame) -> int | None:
        """Return the time of a frame in ticks of the file; None if it has no time."""
        # Some programs write decode times as the presentation times of B-frames, too.
        only_decode_times = self._same_times and self._reordered
        if only_decode_times or self._container.format.name in _DECODE_TIMES:
            return frame.dts
        return frame.pts

    def _facts(self) -> InputFacts:
        frame, stream = self._first, self._stream
        mirrored, rotation = orientation_of(frame)
        width, height = turned(frame.width, frame.height, rotation)
        aspect = stream.sample_aspect_ratio
        return InputFacts(
            name=without_login(self.name),
            kind="stream" if self._remote else "container",
            width=width,
            height=height,
            frame_rate=None if self._is_live else self._declared_rate(),
            frames_declared=declared_frames(stream),
            mirrored=mirrored,
            rotation=rotation,
            codec=self._codec,
            pixel_format=frame.format.name,
            colour_range="full" if is_full_range(frame, self._codec) else "limited",
            pixel_aspect=Fraction(aspect) if aspect else None,
            bytes=None if self._remote else self._container.size,
            rate_assumed=is_rate_assumed(stream) and not self._is_live,
            tick_s=stream.time_base,
            video_stream=self._number,
            video_streams=len(video_streams(self._container)),
            real_time=self._is_live or is_real_time(self.name),
        )

    def _declared_rate(self) -> Fraction | None:
        """Return the rate that the file declares; None for a guess of FFmpeg that is wrong.

        For a file that declares no rate FFmpeg takes one frame per tick of its clock, or an average
        over pauses and dropped frames.
        """
        rate, base = declared_rate(self._stream), self._stream.time_base
        if rate is None or base is None:
            return rate
        guessed = rate * base == 1 or (
            self._container.format.name.startswith("mov") and rate != self._stream.guessed_rate
        )
        if not guessed:
            return rate
        if self._read_once:
            return rate if rate < _FINE_TICKS else None
        usual = usual_rate(self.name, self._number)
        return rate if usual is None or is_near(rate, usual) else None

    def _take_rate(self, true_rate: Fraction) -> None:
        """Scale the times so that the usual rate becomes `true_rate`.

        The declared rate is taken if it is near the usual one: it is exact, and the times of a file
        are rounded. FFmpeg's average is another one if frames were dropped, or after a pause.
        """
        facts = self.facts
        if facts.real_time and not facts.rate_assumed:
            raise no_true_rate(facts.name, "it has the times of a camera")
        usual = None if self._read_once else usual_rate(self.name, self._number)
        if usual and not (self._rate and is_near(self._rate, usual)):
            self._rate = usual
        if self._rate is None:
            raise no_true_rate(facts.name, "it states no rate")
        self._slowed = true_rate / self._rate
        self.facts = replace(
            facts,
            frame_rate=true_rate,
            rate_in_file=self._rate,
            rate_assumed=False,
            tick_s=facts.tick_s and facts.tick_s / self._slowed,
        )


def _with_damage(
    packets: Iterator[Packet[Any] | None], *, joinable: bool
) -> Iterator[tuple[Packet[Any] | None, bool]]:
    """Yield packets, and whether a mark of FFmpeg on this or an earlier packet means damage.

    Where transport streams were joined, the count of their packets jumps. For this FFmpeg marks one
    of the last two packets before the second stream, which begins with a key frame and a time of
    its own. So a mark in a `joinable` stream is judged at most two packets later.
    """
    since_mark = 0  # packets since a mark that is not judged yet, from 1; 0: there is none
    before_s = 0.0  # decode time of the packet before
    for packet in packets:
        marked = packet is not None and packet.is_corrupt
        if not joinable:
            yield packet, marked
            continue
        seam = False
        if packet is not None and packet.dts is not None and packet.time_base:
            time_s = float(packet.dts * packet.time_base)
            seam = packet.is_keyframe and not 0 < time_s - before_s < _JUMP_S
            before_s = time_s
        judged = packet is None or marked or since_mark == 2
        damaged = since_mark > 0 and judged and not seam
        if marked:
            since_mark = 1
        elif since_mark:
            since_mark = 0 if seam or damaged else 2
        yield packet, damaged


def _checked_luma(frame: VideoFrame) -> tuple[NDArray[Any], int]:
    """Return the luma of a frame and its bits; raise ValueError if the frame is too large.

    The decoder's own limit is higher, and a later frame may be larger than the first frame.
    """
    if too_large(frame.width, frame.height, stored_bits(frame.format)):
        raise ValueError(
            f"a frame of {frame.width} x {frame.height} pixels is too large; set {MAX_PIXELS} "
            f"higher if that is right"
        )
    return luma_plane(frame)
