"""Opens inputs of all kinds, with :func:`open_video`."""

from __future__ import annotations

import os
import re
from pathlib import Path
from time import perf_counter, time
from typing import TYPE_CHECKING, Any, Self

from oppload_cli.errors import ParameterError, SourceError
from oppload_cli.files.reading import is_folder, is_there
from oppload_cli.frame_times import FrameTimes
from oppload_cli.processes.threads import Call, Prefetch
from oppload_cli.schema import is_integer
from oppload_cli.video.frames import (
    MOST_WAITING,
    WORKING_HEIGHT,
    Frame,
    WorkingSize,
    frames_ahead,
    no_true_rate,
    other_sizes,
    sizes_in_words,
)
from oppload_cli.video.inputs import NUMBER, checked_rate, is_camera, is_image_file, is_stack
from oppload_cli.video.luminance import Luminance
from oppload_cli.video.span import Reading, Span

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from fractions import Fraction

    from oppload_cli.video.frames import DecodeFacts, InputFacts, PictureSource
    from oppload_cli.video.writers import Colour


_DEVICE = re.compile("/dev/video([0-9]+)")  # of a camera on Linux, also at the end of a link


class Video:
    """An open input. A loop over it yields each :class:`Frame` at the working size, once.

    A further loop raises a SourceError if the caller has had all frames. A `Video` is a context
    manager. `close` ends the decoding thread. :func:`open_video` makes a `Video` and explains its
    parameters. If `ahead` is True, a thread decodes pictures before the caller asks for them.

    Attributes
    ----------
    working : WorkingSize
        Size of the frames, and of their pixels in source pixels.
    others : list of WorkingSize
        Further sizes that each frame has.
    times : FrameTimes
        The times of the frames so far.

    Examples
    --------
    >>> import pathlib, tempfile
    >>> import oppload_cli as oppload
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     protocol = oppload.stimulus.load("controls/looming-perspective")
    ...     path = oppload.stimulus.write(protocol, pathlib.Path(folder)).video
    ...     with oppload.open_video(path) as video:
    ...         count = sum(1 for frame in video)
    >>> count, video.decode.complete
    (102, True)
    """

    def __init__(
        self,
        source: PictureSource,
        height: int | None,
        span: Span,
        *,
        others: Sequence[int] = (),
        colour: bool = False,
        ahead: bool = True,
    ) -> None:
        self._source, self._span, self._ahead = source, span, ahead
        self._prefetch: Prefetch[Frame] | None = None
        self._iterator: Iterator[Frame] | None = None
        try:
            self.working = WorkingSize.of(source.facts, height)
            self.others = other_sizes(source.facts, self.working, others)
        except BaseException:
            source.close()
            raise
        self.times = FrameTimes(source.facts.rate_declared, source.facts.tick_s)
        self._luminance = Luminance(self.working, source.facts)
        self._others = {size.shape: Luminance(size, source.facts) for size in self.others}
        self._colour: Colour | None = None
        if colour:
            from oppload_cli.video.writers import Colour  # only for annotated videos

            self._colour = Colour(source.facts)

    @property
    def facts(self) -> InputFacts:
        """The facts that the input declares about itself."""
        return self._source.facts

    @property
    def decode(self) -> DecodeFacts:
        """The result of decoding; final once the iteration has ended."""
        return self._source.decode

    def __repr__(self) -> str:
        return f"Video({self.facts.name!r}, {sizes_in_words(self.facts, self.working)})"

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def __iter__(self) -> Iterator[Frame]:
        if self._prefetch and self._prefetch.used_up:
            raise SourceError(
                f"{self.facts.name}: has no frame left, as an open video gives each frame once; "
                "open it again"
            )
        return self.begin()

    def begin(self) -> Iterator[Frame]:
        """Begin to decode, and return the iterator over the frames; there is only one."""
        if self._iterator is None:
            if self._source.stopping:
                raise _closed(self._source)
            self._iterator = self._frames()
            if self._ahead:
                ahead = frames_ahead(self.facts, self.working, colour=self._colour is not None)
                on_drop = None
                if self.facts.real_time:
                    ahead, on_drop = MOST_WAITING, self._count_dropped
                self._iterator = self._prefetch = Prefetch(self._iterator, ahead, on_drop)
        return self._iterator

    def _count_dropped(self) -> None:
        self.decode.dropped += 1

    def close(self) -> None:
        """Stop the decoding thread, wait for its end, and close the input; may be called twice.

        A loop over the frames that has not ended, for example in another thread, gets a
        SourceError.
        """
        stop(self._source, self._prefetch)

    def _frames(self) -> Iterator[Frame]:
        set_by_s = time() - perf_counter()  # once, as somebody may set the clock during the run
        for picture in self._span.within(self._source):
            colour = self._colour(picture) if self._colour else None
            time_of = self.times.step(picture.time, corrected=picture.corrected)
            if self.facts.live:
                self.times.arrived(set_by_s + perf_counter())
            luma = self._luminance(picture)
            others = {shape: convert(picture) for shape, convert in self._others.items()}
            yield Frame(picture.index, time_of, luma, colour, others)


def open_video(
    name: str | Path,
    *,
    height: int | None = WORKING_HEIGHT,
    others: Sequence[int] = (),
    span: Span | None = None,
    image_rate: float | Fraction | None = None,
    true_rate: float | Fraction | None = None,
    stream: int | None = None,
    threads: int = 0,
    colour: bool = False,
) -> Video:
    """Open an input of any kind.

    Parameters
    ----------
    name : str or Path
        A video file, a folder or pattern of images (``frames_%04d.png``), ``camera:0`` (a file of
        this name is written ``./camera:0``), or the address of a stream.
    height : int or None
        Working height in pixels, at least 1; the width is in proportion. None keeps the native
        size.
    others : sequence of int
        Further working heights in pixels: each frame also has its luminance at these.
    span : Span, optional
        The part of the input to read.
    image_rate : float or Fraction, optional
        Frames per second of images, which have no times; if left out, that of the ground truth
        beside their folder, or 30.
    true_rate : float or Fraction, optional
        Frames per second at which the camera took the frames, if a video plays in slow motion, or
        is a raw stream without a rate. All times are then scaled, so that the declared rate becomes
        this rate. Images take this rate too, unless `image_rate` is given.
    stream : int, optional
        The number of the video stream that is read, from 1, in a file of several; if left out, the
        one that programs show: not a still, the default one, the largest.
    threads : int
        Number of decoder threads; 0 chooses a number by the codec, the size and the cores.
    colour : bool
        Whether the frames also have their picture in colour.

    Raises
    ------
    SourceError
        If nothing can be read from the input, or if it has no rate that `true_rate` could replace,
        as a camera.
    ParameterError
        If the height is not a whole number of at least 1, the working size is too large, a rate is
        not a number above 0 and at most 100000, or the number of a stream or of threads is no
        whole number.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> oppload.open_video("missing.mp4")  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    ...
    oppload_cli.errors.SourceError: missing.mp4: ...
    """
    if not isinstance(span, Span | None):
        raise ParameterError(
            f"span must be a Span, e.g. Span(start=Position(seconds=1.5)), not {span!r:.60}"
        )
    if not is_integer(threads, 0):
        raise ParameterError(f"threads must be a whole number of at least 0, not {threads!r:.60}")
    rates = checked_rate(image_rate, "image_rate"), checked_rate(true_rate, "true_rate")
    if stream is not None and not is_integer(stream, 1):
        raise ParameterError(f"stream must be a whole number of at least 1, not {stream!r:.60}")
    # A thread opens the input, because Ctrl-C has no effect while a library call blocks.
    source = Call(lambda: source_of(str(name), Reading(*rates, stream), threads)).result()
    return Video(source, height, span or Span(), others=others, colour=colour)


def stop(source: PictureSource, ahead: Prefetch[Any] | None) -> None:
    """Stop decoding, wait for the decoding thread to end, and close the source.

    `ahead` is the thread that takes the pictures, if there is one. May be called twice.
    """
    source.stopping = True
    # A caller in another thread would take StopIteration for the end of the video. If the thread
    # does not end, because it waits for a device or a network, the source stays open.
    if ahead is None or ahead.close(_closed(source)):
        source.close()


def _closed(source: PictureSource) -> SourceError:
    return SourceError(f"{source.facts.name}: was closed before its last frame; open it again")


def source_of(name: str, reading: Reading, threads: int = 0) -> PictureSource:
    """Return the source of an input's pictures; arguments and errors as for :func:`open_video`."""
    image_rate, true_rate, stream = reading
    device = _DEVICE.fullmatch(os.path.realpath(name)) if name.startswith("/dev/") else None
    if device:
        raise SourceError(f"{name}: is the device of a camera; write camera:{device[1]}")
    # Each kind of input needs other libraries: Pillow and OpenCV, or PyAV. Import no others.
    camera, path = is_camera(name), Path(name)
    pattern = NUMBER.search(path.name) and not is_there(name)
    sequence = pattern or is_folder(name)
    stack = is_stack(name) or is_image_file(name)
    if stream is not None and (camera or sequence or stack):
        kind = "a camera" if camera else "a sequence of pictures"
        raise SourceError(f"{name}: is {kind}, which has no streams; leave --stream out")
    if camera or sequence:
        from oppload_cli.video.images import CameraSource, ImageSource

        if not camera:
            return ImageSource(name, image_rate or true_rate)
        if true_rate is not None:
            raise no_true_rate(name, "it is a camera")
        return CameraSource(name)
    if stack:
        from oppload_cli.video.stacks import StackSource

        return StackSource(name, reading)
    from oppload_cli.video.container import ContainerSource

    return ContainerSource(name, threads, true_rate, stream)
