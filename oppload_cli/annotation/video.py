"""The annotated video of a run; a thread draws and encodes it while the run goes on."""

from __future__ import annotations

from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TYPE_CHECKING, cast

import cv2
import numpy as np

from oppload_cli.annotation.frame import DARK, Layout, Strip, draw_detections
from oppload_cli.errors import OpploadError
from oppload_cli.files.atomic import PartFile, output_errors
from oppload_cli.models.registry import placing_detector
from oppload_cli.video.writers import Recording

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from oppload_cli.results.record import FrameRecord
    from oppload_cli.video.frames import Frame
    from oppload_cli.video.source import Video
    from oppload_cli.video.writers import Bgr


class _Frames:
    """Passes the frames of a video on to the detectors, and keeps their pictures."""

    def __init__(self, video: Video) -> None:
        self.facts, self.working, self._video = video.facts, video.working, video
        self._waiting: deque[Frame] = deque()

    def __iter__(self) -> Iterator[Frame]:
        for frame in self._video:
            self._waiting.append(frame)
            yield frame

    def picture(self) -> Bgr:
        """Return the picture of the earliest frame that has not been asked for yet."""
        return cast("Bgr", self._waiting.popleft().colour)


class AnnotatedVideo:
    """Draws and encodes an annotated video in a thread, a few frames behind the detectors.

    Parameters
    ----------
    path : Path
        Final name of the video.
    video : Video
        The input, opened with ``colour=True``. The detectors must take the frames from the
        attribute `frames`.
    detectors : sequence of str
        The detectors whose responses are shown.
    boxes : str
        Objects with a box: ``alarm`` for those that cause an alarm; ``all``; or ``none``.

    Raises
    ------
    OutputError
        If the file cannot be written, or no encoder is installed; `write`, `finish` and `commit`
        raise it too.
    """

    def __init__(
        self, path: Path, video: Video, detectors: Sequence[str], boxes: str = "alarm"
    ) -> None:
        self.frames = _Frames(video)
        self._boxes = boxes
        self._path = path
        facts = video.facts
        self._layout = layout = Layout.of(facts)
        self._blank = np.full((layout.height, layout.width, 3), DARK, np.uint8)
        rate, count = facts.frame_rate, facts.frames_declared
        duration_s = float(count / rate) if rate and count else None
        self._strip = Strip(layout, detectors, duration_s)
        self._file = PartFile(path)
        try:
            with output_errors(path):
                self._recording = Recording(self._file, layout.width, layout.height, rate)
        except BaseException:
            self._file.discard()
            raise
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="oppload-annotate")
        self._waiting: deque[Future[None]] = deque()
        self._finished = False

    def write(self, record: FrameRecord) -> None:
        """Take the record of the next frame."""
        self._await(4)
        picture = self.frames.picture()
        self._waiting.append(self._thread.submit(self._encode, picture, record))

    def finish(self) -> None:
        """Wait until every frame is encoded, and finish the file; may be called twice."""
        self._await(0)
        if not self._finished:
            self._thread.shutdown()
            with output_errors(self._path):
                self._recording.finish()
        self._finished = True

    def commit(self) -> None:
        """Give the finished file its name; a video without a frame is removed."""
        if self._recording.frames:
            self._file.commit()
        else:
            self._file.discard()
            with output_errors(self._path):
                self._path.unlink(missing_ok=True)

    def keep(self) -> None:
        """Finish the file and keep it as the part file, which can be played; else remove it."""
        try:
            self.finish()
            self._file.keep()
        except OpploadError:
            self.discard()

    def discard(self) -> None:
        """Stop the thread, and remove the file."""
        self._thread.shutdown(cancel_futures=True)
        self._recording.abandon()
        self._file.discard()

    def _await(self, most: int) -> None:
        """Wait until at most `most` frames are not yet encoded; raise an error of the thread."""
        while len(self._waiting) > most:
            with output_errors(self._path):
                self._waiting[0].result()  # after an error it remains, so that each call fails
            self._waiting.popleft()

    def _encode(self, picture: Bgr, record: FrameRecord) -> None:
        layout, canvas = self._layout, self._blank.copy()
        size = (layout.picture.width, layout.picture.height)
        same_size = picture.shape[1::-1] == size
        canvas[layout.picture.slices] = picture if same_size else cv2.resize(picture, size)
        placing = placing_detector(record.detectors)
        if placing is not None and self._boxes != "none":
            boxed = (found for found in record.detections if found.alarm or self._boxes == "all")
            draw_detections(canvas, layout, boxed, placing.colour)
        self._strip.draw(canvas, record)
        self._recording.write(canvas, record.time_s)
