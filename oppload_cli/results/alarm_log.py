"""The alarms of a run: collected from records, written to ``alarms.csv``, and in words."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, fields
from typing import TYPE_CHECKING, Any, NamedTuple

from oppload_cli.errors import printable
from oppload_cli.files.tables import open_csv, rows_of
from oppload_cli.models.detector import Box
from oppload_cli.models.registry import detector_named, known_names

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

    from oppload_cli.results.record import FrameRecord

ALARM_COLUMNS = (  # of alarms.csv
    *("result", "video", "model", "start_frame", "start_s", "end_s", "peak_over_threshold"),
    *(*Box._fields, "time_to_contact_s"),
)


@dataclass
class _AlarmEvent:
    """One alarm of one detector.

    The alarm starts in the frame `start_frame`, at the time `start_s`; `end_s` is the time of the
    last frame with the alarm on.
    """

    start_frame: int
    start_s: float
    end_s: float
    peak_over_threshold: float = 0.0  # largest ratio of the response to the threshold
    # x, y, width, height in source px of the object at this ratio; if there was none, of the object
    # at the largest ratio before.
    box: list[float] | None = None
    # From the start of the alarm to contact, by the first estimate during the alarm.
    time_to_contact_s: float | None = None
    # The measurements on which the response rests at its largest ratio to the threshold, by the
    # names of the detector's columns (`Detector.witnesses`).
    witnesses: dict[str, float] = field(default_factory=dict)

    def add(self, record: FrameRecord, model: str) -> None:
        """Take a frame in which the alarm is on."""
        self.end_s = record.time_s
        said = record[model]
        ratio, detection = said.over_threshold, said.object
        if detection is not None and detection.time_to_contact_s is not None:
            contact_s = record.time_s - self.start_s + detection.time_to_contact_s
            self.time_to_contact_s = self.time_to_contact_s or contact_s
        if ratio is not None and ratio > self.peak_over_threshold:
            self.peak_over_threshold = ratio
            names = detector_named(model).witnesses
            values = {name: getattr(said.answer, name) for name in names}
            # Without a flow the response rests on one witness alone.
            self.witnesses = {} if None in values.values() else values
            self.box = list(detection.box) if detection is not None else self.box


class Verdict(NamedTuple):
    """The alarms of one detector for one input, the earliest first.

    `peak` is the largest ratio of the response to its threshold; None without a response, or if
    alarms are switched off. `peak_blind` is the `blind` of the peak's `FrameRecord`.
    """

    model: str
    alarms: tuple[_AlarmEvent, ...]
    peak: float | None
    peak_blind: str | None = None

    @property
    def strongest(self) -> float:
        """Largest ratio of the response to its threshold; during alarms only, if there are any."""
        return max((alarm.peak_over_threshold for alarm in self.alarms), default=self.peak or 0.0)

    @property
    def is_uncounted(self) -> bool:
        """Whether the peak exceeds the threshold and the peaks of all alarms."""
        peaks_of_alarms = (alarm.peak_over_threshold for alarm in self.alarms)
        return (self.peak or 0.0) > max([1.0, *peaks_of_alarms])

    def __str__(self) -> str:
        """Return the verdict as a text, such as ``no alarm, peak at 0.2 of the threshold``."""
        peak = self.peak or 0.0
        if not self.alarms:
            if self.is_uncounted:
                why = uncounted(self.peak_blind)
                return f"no alarm, peak at {times(peak)} times the threshold, {why}"
            return "no alarm" + f", peak at {times(peak)} of the threshold" * bool(peak)
        first, count = self.alarms[0], len(self.alarms)
        many = f", {count} alarms" if count > 1 else ""
        contact_s = first.time_to_contact_s
        contact = "" if contact_s is None else f", contact estimated {contact_s:.1f} s later"
        largest = f", response up to {times(self.strongest)} times the threshold"
        if self.is_uncounted:
            why = uncounted(self.peak_blind, beside_alarms=True)
            largest += f" (the peak is {times(peak)} times, {why})"
        if not self.strongest:
            largest = ", response above a threshold of 0"
        elif self.strongest <= 1:
            largest += ", but above the threshold when the alarm began"
        best = max(self.alarms, key=lambda alarm: alarm.peak_over_threshold)
        columns = detector_named(self.model).columns
        units = {column.name: column.unit.removeprefix("1") for column in columns}
        because = ", ".join(
            f"{name} {value:.2g}{units[name]}" for name, value in best.witnesses.items()
        )
        largest += f" ({because})" if because else ""
        return f"alarm at {first.start_s:.2f} s (frame {first.start_frame}{contact}){many}{largest}"

    def as_dict(self) -> dict[str, Any]:
        """Return the verdict for JSON."""
        alarms = [asdict(alarm) for alarm in self.alarms]
        return {"alarms": alarms, "peak": self.peak, "peak_blind": self.peak_blind}


_CAUSES = {
    "start": "came at the start",
    "cut": "came at a cut or a flash",
    "rest": "came at the end of a rest",
    "gap": "came after a gap",
}


def uncounted(blind: str | None, *, beside_alarms: bool = False) -> str:
    """Return the end of a sentence: why a response above the threshold caused no alarm.

    `blind` is the `peak_blind` of a `Verdict`, or None if the reason is not known. `beside_alarms`
    says whether the detector had alarms in other frames.
    """
    short = "came soon after an alarm, or was too short" if beside_alarms else "was too short"
    any_cause = "came at the start, a cut, a flash, the end of a rest or after a gap"
    if blind is None:
        reason = f"{any_cause}, or {short}"
    else:
        reason = _CAUSES.get(blind, any_cause) if blind else short
    return f"which did not count: it {reason}"


def uncounted_in(alarms: Mapping[str, Any], model: str, *, beside_alarms: bool = False) -> str:
    """Return the end of a sentence as `uncounted` does, from the part ``alarms`` of a sidecar."""
    content = alarms.get(model)
    blind = content.get("peak_blind") if isinstance(content, dict) else None
    return uncounted(blind if isinstance(blind, str) else None, beside_alarms=beside_alarms)


class AlarmLog:
    """Collects the alarms of one detector from the records of one input."""

    def __init__(self, model: str) -> None:
        self._model = model
        self._alarms: list[_AlarmEvent] = []
        self._on = False
        self._peak: float | None = None
        self._peak_blind: str | None = None

    def add(self, record: FrameRecord) -> None:
        """Take the next frame."""
        ratio = record[self._model].over_threshold
        if ratio is not None and (self._peak is None or ratio > self._peak):
            self._peak, self._peak_blind = ratio, record.blind
        on = record[self._model].alarm
        if on and not self._on:
            self._alarms.append(_AlarmEvent(record.frame, record.time_s, record.time_s))
        if on:
            self._alarms[-1].add(record, self._model)
        self._on = on

    @property
    def verdict(self) -> Verdict:
        """The verdict on the frames so far."""
        return Verdict(self._model, tuple(self._alarms), self._peak, self._peak_blind)


def verdicts_in(sidecar: Mapping[str, Any]) -> tuple[Verdict, ...]:
    """Return the verdicts in a sidecar.

    Raises
    ------
    KeyError, TypeError, AttributeError
        If the sidecar has no verdicts, or a verdict is not complete.
    """
    known = {value.name for value in fields(_AlarmEvent)}  # earlier versions wrote others too
    verdicts = []
    for model, content in sidecar["alarms"].items():
        alarms = tuple(
            _AlarmEvent(**{name: value for name, value in event.items() if name in known})
            for event in content["alarms"]
        )
        verdicts.append(Verdict(model, alarms, content["peak"], content.get("peak_blind")))
    return tuple(verdicts)


MOST_IN_A_LINE = 3  # detectors; if there are more, each has a line


def in_words(verdicts: Iterable[Verdict]) -> str:
    """Return the verdicts of all detectors on one input as one line."""
    listed = list(verdicts)
    if len(listed) == 1:
        return str(listed[0])
    return "; ".join(f"{label_of(verdict.model)} {verdict}" for verdict in listed)


def times(value: float) -> str:
    """Return a ratio to a threshold as a text with few digits; below 1 it does not become 1."""
    if 0 < value < 0.01:
        return "<0.01"
    value = 0.99 if 0.99 < value < 1 else value
    return f"{value:.0f}" if value >= 99.5 else f"{value:.2g}"


def label_of(model: str) -> str:
    """Return the label of a detector; its name if it is not registered."""
    return detector_named(model).label if model in known_names() else model


def write_alarms(
    path: Path, verdicts_of: Mapping[str, Iterable[Verdict]], stems: Mapping[str, str]
) -> None:
    """Write ``alarms.csv``: a row per alarm, sorted by input, from the verdicts by input.

    `stems` are the names of the results by input. The file keeps its rows of other results. So a
    second batch into the same folder, for example with the inputs that failed, adds to the file.
    Raises OutputError if it cannot be written.
    """
    replaced = {printable(stems[video]) for video in verdicts_of}
    with open_csv(path, ALARM_COLUMNS) as table:  # first: two batches may end at the same time
        rows: list[dict[str, Any]] = [
            row for row in rows_of(path, ALARM_COLUMNS) if row["result"] not in replaced
        ]
        for video, verdicts in verdicts_of.items():
            about = {"result": printable(stems[video]), "video": printable(video)}
            for verdict in verdicts:
                rows += [about | _alarm_row(verdict.model, alarm) for alarm in verdict.alarms]
        for row in sorted(rows, key=lambda row: row["video"]):
            table.write(row)


def _alarm_row(model: str, alarm: _AlarmEvent) -> dict[str, Any]:
    row = {"model": model, **asdict(alarm)}
    box = row.pop("box") or [None] * 4
    return row | dict(zip(Box._fields, box, strict=True))
