"""One pass over a video: every frame through every model and its alarm."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from oppload_cli.detection.alarm import Alarm, AlarmParams
from oppload_cli.detection.cuts import Cuts
from oppload_cli.detection.detections import Detections
from oppload_cli.detection.parameters import PlaceParams
from oppload_cli.models.bank import ModelBank
from oppload_cli.models.convolution import MEMORY
from oppload_cli.models.opplod import Box, Opplod, OpplodResponse
from oppload_cli.models.parameters import DlgmdParams, OpplodParams
from oppload_cli.motion.flow import DenseFlow
from oppload_cli.motion.parameters import RmoParams
from oppload_cli.motion.rmo import RmoMetrics
from oppload_cli.results.record import Detection, FrameRecord
from oppload_cli.video.parameters import RepeatParams
from oppload_cli.video.prefetch import Prefetch, frames_ahead
from oppload_cli.video.repeats import Repeats

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from oppload_cli.models.bank import Response
    from oppload_cli.video.frames import Frame, FrameSource
    from oppload_cli.video.working import WorkingSize

DEFAULT_RMO = RmoParams()
DEFAULT_PLACES = PlaceParams()


def analyse(
    video: FrameSource,
    params: Sequence[OpplodParams | DlgmdParams] | None = None,
    *,
    alarm: AlarmParams | None = None,
    places: PlaceParams | None = DEFAULT_PLACES,
    rmo: RmoParams | None = DEFAULT_RMO,
    repeats: RepeatParams | None = None,
) -> Iterator[FrameRecord]:
    """Run models over a video in one pass.

    Parameters
    ----------
    video : FrameSource
        Such as from :func:`oppload_cli.open_video`; it is iterated, not closed.
    params : sequence of OpplodParams or DlgmdParams, optional
        One set per model; both models with the defaults if left out.
    alarm : AlarmParams, optional
        Of every model's alarm; those of a preset are ``ALARMS[name]`` of
        `oppload_cli.detection.alarm`.
    places : PlaceParams, optional
        Of OppLoD's looming objects; None does not look for them.
    rmo : RmoParams, optional
        Of radial motion opponency; None does not measure it.
    repeats : RepeatParams, optional
        What is done with exact repeats.

    Yields
    ------
    FrameRecord
        One per decoded frame; responses are None during warm-up.
    """
    models = _Models(video, params or (OpplodParams(), DlgmdParams()), alarm, places)
    # A thread of its own for the motion: it costs about as much as a model.
    ahead = frames_ahead(video.facts, video.working)
    seen = Prefetch(_seen(video, rmo, repeats or RepeatParams()), ahead)
    try:
        for count, each in enumerate(seen):
            yield models.answer(each, count)
    finally:
        seen.close()


class _Seen(NamedTuple):
    """A frame, whether the models shall see it, and its radial motion opponency."""

    frame: Frame
    repeat: bool
    passed_over: bool
    still_begins: bool
    opponency: RmoMetrics | None


def _seen(video: FrameSource, rmo: RmoParams | None, repeats: RepeatParams) -> Iterator[_Seen]:
    flow = DenseFlow(rmo) if rmo else None
    copies = Repeats(repeats)
    was_passed_over = False
    for frame in video:
        repeat, passed_over = copies.step(frame.luma)
        still_begins = repeat and was_passed_over and not passed_over
        was_passed_over = passed_over
        opponency = flow.step(frame.luma) if flow and not passed_over else None
        if flow and repeat:
            opponency = RmoMetrics()
        yield _Seen(frame, repeat, passed_over, still_begins, opponency)


class _Models:
    """The models over one video, with their alarms and the places of what looms."""

    def __init__(
        self,
        video: FrameSource,
        params: Sequence[OpplodParams | DlgmdParams],
        alarm: AlarmParams | None,
        places: PlaceParams | None,
    ) -> None:
        self._working = video.working
        self._bank = ModelBank(video.working.shape, [_for_video(each, video) for each in params])
        self._alarms = _Alarms(self._bank, alarm)
        self._objects = _objects(self._bank, video.working, places)

    def answer(self, seen: _Seen, count: int) -> FrameRecord:
        """Take the next frame; `count` frames came before it."""
        answers = self._answers(seen, count)
        change = 0.0 if seen.repeat else self._bank.luma_change
        states = self._alarms.step(seen, answers, change)
        thresholds = self._alarms.thresholds
        time_s = seen.frame.time_s
        found: tuple[Detection, ...] = ()
        if self._objects and Opplod.name in states and not seen.repeat:
            found = self._objects.step(time_s, states[Opplod.name], thresholds[Opplod.name])
        return FrameRecord(
            seen.frame.index,
            time_s,
            change,
            {name: _in_source(answer, self._working) for name, answer in answers.items()},
            states,
            seen.opponency,
            seen.repeat,
            thresholds,
            found,
        )

    def _answers(self, seen: _Seen, count: int) -> dict[str, Response | None]:
        bank = self._bank
        answers = {} if seen.passed_over else bank.step(seen.frame.luma)
        if seen.still_begins:
            # What was passed over was no copy: the models stand still as the scene does.
            for _ in range(bank.memory):
                answers = bank.step(seen.frame.luma)
        if seen.repeat:
            # Where nothing changed every model answers 0, whatever came before.
            answers = bank.at_rest() if count >= MEMORY else dict.fromkeys(bank.models)
        return answers


class _Alarms:
    """The alarms of all models over one video."""

    def __init__(self, bank: ModelBank, params: AlarmParams | None) -> None:
        self._bank = bank
        self._cuts = Cuts(params)
        self._alarms = {name: Alarm(name, params) for name in bank.models}

    @property
    def thresholds(self) -> dict[str, float]:
        """The response above which the latest frame sets each model's alarm off."""
        return {name: alarm.threshold for name, alarm in self._alarms.items()}

    def step(
        self, seen: _Seen, answers: Mapping[str, Response | None], change: float | None
    ) -> dict[str, bool]:
        """Take the answers to the next frame; say by model whether its alarm is on."""
        blind = False
        if change is not None and not seen.passed_over:
            blind = self._cuts.step(self._bank.photoreceptors, change)
        return {
            name: self._alarms[name].step(answer.response, seen.frame.time_s, blind=blind)
            for name, answer in answers.items()
            if answer is not None
        }


def _objects(
    bank: ModelBank, working: WorkingSize, places: PlaceParams | None
) -> Detections | None:
    model = bank.models.get(Opplod.name)
    if places is None or not isinstance(model, Opplod):
        return None
    return Detections(model.judge.maps, working, places)


def _for_video(
    params: OpplodParams | DlgmdParams, video: FrameSource
) -> OpplodParams | DlgmdParams:
    """Fill in what follows from the video."""
    if isinstance(params, DlgmdParams):
        return params
    rate = video.facts.frame_rate
    return params.resolved(video.working.height, float(rate) if rate else None)


def _in_source(answer: Response | None, working: WorkingSize) -> Response | None:
    """Return an answer with its box in source pixels."""
    if not isinstance(answer, OpplodResponse) or answer.box is None:
        return answer
    box, x, y = answer.box, working.scale_x, working.scale_y
    return answer._replace(box=Box(box.x * x, box.y * y, box.width * x, box.height * y))
