"""One decoding pass over a clip for all contenders that see it at the same size."""

from __future__ import annotations

import threading
from collections import deque
from contextlib import ExitStack, closing
from typing import TYPE_CHECKING, cast

import numpy as np

from oppload_cli.analysis import analyse
from oppload_cli.detection.evaluation.series import Answer, Seen
from oppload_cli.errors import SourceError
from oppload_cli.evaluation.contenders import FLOW, MEAN_P
from oppload_cli.evaluation.manifest import RowError
from oppload_cli.models.opplod import OpplodResponse
from oppload_cli.motion.divergence import FlowDivergence
from oppload_cli.video.parameters import RepeatParams
from oppload_cli.video.prefetch import Prefetch
from oppload_cli.video.repeats import Repeats
from oppload_cli.video.source import open_video

if TYPE_CHECKING:
    from collections.abc import Generator, Iterator, Sequence

    from oppload_cli.detection.evaluation.series import Label, Numbers
    from oppload_cli.evaluation.contenders import Contender
    from oppload_cli.evaluation.manifest import Entry
    from oppload_cli.results.record import FrameRecord
    from oppload_cli.video.frames import Frame
    from oppload_cli.video.source import Video


class Viewed:
    """What came of showing one clip.

    Attributes
    ----------
    seen : Seen or None
        None where nothing usable came.
    faults : list of str
        What was wrong with the clip, a sentence each, without its row.
    """

    def __init__(self, seen: Seen | None, faults: list[str]) -> None:
        self.seen, self.faults = seen, faults


def view(entry: Entry, contenders: Sequence[Contender], threads: int = 0) -> Viewed:
    """Show a clip to all contenders.

    Parameters
    ----------
    entry : Entry
        The clip with its label.
    contenders : sequence of Contender
        Who sees it.
    threads : int
        Decoder threads; 0 leaves the choice to the decoder.

    Returns
    -------
    Viewed
        What is wrong with the clip is a fault, not an error.
    """
    answers: dict[str, Answer] = {}
    faults: list[str] = []
    try:
        for height in dict.fromkeys(each.height for each in contenders):
            part = [each for each in contenders if each.height == height]
            with open_video(entry.path, height=height, threads=threads) as video:
                times, found = _answers(video, part)
                answers.update(found)
                complete, facts = video.decode.complete, video.facts
        seen = Seen(
            entry.label,
            times,
            facts.width,
            facts.height,
            {each.name: answers[each.name] for each in contenders},
        )
        _check(seen)
    except (SourceError, RowError) as error:
        return Viewed(None, [str(error)])
    if not complete:
        faults.append(f"{entry.label.name}: is damaged or cut; what could be decoded is used")
    faults += _boxes_beyond(entry.label, len(seen))
    return Viewed(seen, faults)


def _check(seen: Seen) -> None:
    name, contact = seen.label.name, seen.label.contact
    if seen.first == len(seen):
        raise RowError(f"{name}: has {len(seen)} frames, too few for any response; leave it out")
    if contact is not None and contact >= len(seen):
        raise RowError(
            f"{name}: its contact, frame {contact}, is beyond its last frame, {len(seen) - 1}; "
            "correct it"
        )
    if contact is not None and contact < seen.first:
        raise RowError(
            f"{name}: its contact, frame {contact}, is before the first response, frame "
            f"{seen.first}; leave it out"
        )


def _boxes_beyond(label: Label, frames: int) -> list[str]:
    return [
        f"{label.name}: the box of frame {frame} is beyond its last frame, {frames - 1}; correct it"
        for frame in sorted(label.boxes)
        if frame >= frames
    ]


def _answers(video: Video, contenders: Sequence[Contender]) -> tuple[Numbers, dict[str, Answer]]:
    """Run all contenders of one working height in step."""
    groups = _groups([each for each in contenders if each.params is not None])
    wants_flow = any(each.name == FLOW for each in contenders)
    feed = _Feed(video, len(groups) + 1)
    with ExitStack() as stack:
        passes = []
        for reader, group in enumerate(groups):
            params = [each.params for each in group if each.params is not None]
            records = analyse(feed.reader(reader), params, alarm=group[0].alarm, rmo=None)
            passes.append(
                stack.enter_context(closing(cast("Generator[FrameRecord, None, None]", records)))
            )
        flow = stack.enter_context(
            closing(Prefetch(_divergence(feed.reader(len(groups)), wants_flow), ahead=2))
        )
        table = list(zip(flow, *passes, strict=True))
    times = np.array([time_s for (time_s, _), *_ in table])
    found = {
        each.name: _answer([row[index + 1] for row in table], each)
        for index, group in enumerate(groups)
        for each in group
    }
    for each in contenders:
        if each.name == FLOW:
            found[FLOW] = Answer(_numbers([value for (_, value), *_ in table]))
        elif each.name == MEAN_P:
            found[MEAN_P] = Answer(_numbers([row[1].luma_change for row in table]))
    return times, found


def _groups(contenders: Sequence[Contender]) -> list[list[Contender]]:
    """Put contenders together that can share layers: of different models, and one alarm."""
    groups: list[list[Contender]] = []
    for each in contenders:
        for group in groups:
            other = all(member.model != each.model for member in group)
            if other and group[0].alarm == each.alarm:
                group.append(each)
                break
        else:
            groups.append([each])
    return groups


def _answer(records: Sequence[FrameRecord], contender: Contender) -> Answer:
    name = contender.model
    found = [record.responses.get(name) for record in records]
    response = _numbers([None if each is None else each.response for each in found])
    alarm = np.array([record.alarms.get(name, False) for record in records], bool)
    if name != "opplod":
        return Answer(response, alarm)
    boxes = [each.box if isinstance(each, OpplodResponse) else None for each in found]
    place = [
        [np.nan] * 4 if box is None else [box.x, box.y, box.width, box.height] for box in boxes
    ]
    return Answer(response, alarm, np.array(place, float).reshape(-1, 4))


def _numbers(values: Sequence[float | None]) -> Numbers:
    return np.array([np.nan if value is None else value for value in values], float)


def _divergence(part: _Part, wanted: bool) -> Iterator[tuple[float, float | None]]:
    """Yield each frame's time and divergence; copies are passed over, as by the models."""
    copies, flow = Repeats(RepeatParams()), FlowDivergence()
    for count, frame in enumerate(part):
        repeat, passed_over = copies.step(frame.luma)
        value = flow.step(frame.luma) if wanted and not passed_over else None
        yield frame.time_s, 0.0 if repeat and count else value


class _Part:
    """What one reader sees of a video: all that an analysis asks of it."""

    def __init__(self, video: Video, frames: Iterator[Frame]) -> None:
        self.facts, self.working = video.facts, video.working
        self._frames = frames

    def __iter__(self) -> Iterator[Frame]:
        return self._frames


class _Feed:
    """One video for several readers, each in a thread of its own.

    They go in step, so that few frames wait.
    """

    def __init__(self, video: Video, readers: int) -> None:
        self._video, self._frames = video, iter(video)
        self._waiting: list[deque[Frame]] = [deque() for _ in range(readers)]
        self._lock = threading.Lock()

    def reader(self, number: int) -> _Part:
        """Return what one reader sees."""
        return _Part(self._video, self._read(number))

    def _read(self, number: int) -> Iterator[Frame]:
        own = self._waiting[number]
        while True:
            with self._lock:
                if not own:
                    frame = next(self._frames, None)
                    if frame is None:
                        return
                    for waiting in self._waiting:
                        waiting.append(frame)
            yield own.popleft()
