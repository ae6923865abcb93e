"""The annotated video of one run, drawn and encoded beside it."""

from __future__ import annotations

import queue
import threading
from collections import deque
from contextlib import suppress
from typing import TYPE_CHECKING

import cv2
import numpy as np

from oppload_cli.annotation.boxes import draw_detections
from oppload_cli.annotation.history import History
from oppload_cli.annotation.layout import layout_of
from oppload_cli.annotation.strip import draw_ground, draw_strip
from oppload_cli.errors import OpploadError
from oppload_cli.palette import INK, bgr
from oppload_cli.results.table import naming
from oppload_cli.video.recording import Recording

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from oppload_cli.results.record import FrameRecord
    from oppload_cli.video.colour import Bgr
    from oppload_cli.video.frames import Frame, InputFacts
    from oppload_cli.video.source import Video
    from oppload_cli.video.working import WorkingSize

AHEAD = 4  # frames that wait to be drawn


class Painter:
    """Draws annotated frames.

    Parameters
    ----------
    facts : InputFacts
        Of the input.
    models : sequence of str
        Whose responses are shown.
    """

    def __init__(self, facts: InputFacts, models: Sequence[str]) -> None:
        self.layout = layout_of(facts)
        self._blank = np.empty((self.layout.height, self.layout.width, 3), np.uint8)
        self._blank[:] = bgr(INK)
        draw_ground(self._blank, self.layout)
        rate, count = facts.frame_rate, facts.frames_declared
        self._history = History(models, float(count / rate) if rate and count else None)

    def draw(self, picture: Bgr, record: FrameRecord) -> Bgr:
        """Return the next frame, annotated.

        Parameters
        ----------
        picture : ndarray of uint8, shape (rows, columns, 3)
            The frame in colour, of the size of :func:`oppload_cli.video.colour.colour_size`.
        record : FrameRecord
            What is known of it.

        Returns
        -------
        ndarray of uint8, shape (height, width, 3)
            Of the layout's size.
        """
        layout = self.layout
        canvas = self._blank.copy()
        size = (layout.picture.width, layout.picture.height)
        # Enlarged by a whole number, if at all.
        canvas[layout.picture.slices] = (
            picture
            if picture.shape[1::-1] == size
            else cv2.resize(picture, size, interpolation=cv2.INTER_LINEAR)
        )
        draw_detections(canvas, layout, record.detections)
        self._history.add(record)
        draw_strip(canvas, layout, self._history, record)
        return canvas


class Shown:
    """Frames on their way to the models; their pictures are kept until they are asked for.

    Parameters
    ----------
    video : Video
        Opened with ``colour=True``.
    """

    def __init__(self, video: Video) -> None:
        self._video = video
        self._waiting: deque[Frame] = deque()

    @property
    def facts(self) -> InputFacts:
        """What is known of the input."""
        return self._video.facts

    @property
    def working(self) -> WorkingSize:
        """Size at which the models see them."""
        return self._video.working

    def __iter__(self) -> Iterator[Frame]:
        for frame in self._video:
            self._waiting.append(frame)
            yield frame

    def picture(self, index: int) -> Bgr | None:
        """Return a frame's picture; those before it are forgotten.

        Parameters
        ----------
        index : int
            Of a frame that has been yielded and not asked for.

        Returns
        -------
        ndarray of uint8, shape (rows, columns, 3), or None
        """
        frame = self._waiting.popleft()
        while frame.index < index:
            frame = self._waiting.popleft()
        return frame.colour


class AnnotatedVideo:
    """Draws and encodes in a thread of its own, a few frames behind the models.

    Parameters
    ----------
    path, part : Path
        Its final name, and the one that it has while it is written.
    video : Video
        Opened with ``colour=True``.
    models : sequence of str
        Whose responses are shown.

    Attributes
    ----------
    frames : Shown
        What the models shall take their frames from.

    Raises
    ------
    OutputError
        If the file cannot be written, or there is no encoder; also by `write`,
        `finish` and `commit`.
    """

    def __init__(self, path: Path, part: Path, video: Video, models: Sequence[str]) -> None:
        self.frames = Shown(video)
        self._path, self._part = path, part
        self._painter = Painter(video.facts, models)
        size = (self._painter.layout.width, self._painter.layout.height)
        with naming(path):
            self._recording = Recording(part, *size, video.facts.frame_rate)
        self._queue: queue.Queue[tuple[Bgr, FrameRecord] | None] = queue.Queue(AHEAD)
        self._error: BaseException | None = None
        self._finished = False
        self._thread = threading.Thread(target=self._run, name="oppload-annotate", daemon=True)
        self._thread.start()

    def write(self, record: FrameRecord) -> None:
        """Take the next frame.

        Parameters
        ----------
        record : FrameRecord
            What is known of it.
        """
        self._check()
        picture = self.frames.picture(record.frame)
        if picture is not None:
            self._queue.put((picture, record))

    def finish(self) -> None:
        """Wait until every frame is encoded, and finish the file; may be called twice."""
        self._end()
        self._check()
        if not self._finished:
            with naming(self._path):
                self._recording.finish()
        self._finished = True

    def commit(self) -> None:
        """Give the finished file its name; a video without a frame is none."""
        with naming(self._path):
            if self._recording.frames:
                self._part.replace(self._path)
            else:
                self._part.unlink()
                self._path.unlink(missing_ok=True)

    def keep(self) -> None:
        """Leave the file as its ``.part``, finished, so that it can be played; else remove it."""
        try:
            self.finish()
        except OpploadError:
            self.discard()

    def discard(self) -> None:
        """Stop, and remove the file."""
        self._error = self._error or InterruptedError("given up")
        self._end()
        self._recording.abandon()
        with suppress(OSError):
            self._part.unlink()

    def _end(self) -> None:
        """Wait until the thread has done what waits; may be called twice."""
        if self._thread.is_alive():
            self._queue.put(None)
        while self._thread.is_alive():
            self._thread.join(0.1)  # without a limit it could not be interrupted everywhere

    def _check(self) -> None:
        if self._error is not None:
            with naming(self._path):
                raise self._error

    def _run(self) -> None:
        # After an error the queue is still emptied: nobody shall wait for a place in it.
        while (item := self._queue.get()) is not None:
            if self._error is None:
                try:
                    picture, record = item
                    self._recording.write(self._painter.draw(picture, record), record.time_s)
                except BaseException as error:
                    self._error = error
