"""The content of a result's page: curves, alarms, boxes, ground truth, settings, remarks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from oppload_cli.errors import OpploadError, printable
from oppload_cli.files.atomic import PART
from oppload_cli.models.detector import Box
from oppload_cli.models.registry import detector_named, placing_detector
from oppload_cli.palette import INK, ink_on
from oppload_cli.results.alarm_log import uncounted_in
from oppload_cli.results.cells import check_numbers
from oppload_cli.results.result_files import (
    alarm_rows,
    check_schema,
    frame_ends,
    known_threshold,
    read_detections,
)
from oppload_cli.results.truths import contacts_of, find_truth, sizes_in
from oppload_cli.version import __version__

if TYPE_CHECKING:
    from oppload_cli.results.result_files import BaseResult, Series

    _Boxes = dict[int, list[list[Any]]]

_DIGITS = 4  # of a number in the page; the table has all digits
_DETECTION = (*Box._fields, "centre_x", "centre_y", "id", "alarm", "time_to_contact_s")


class RelativeCurve(NamedTuple):
    """The responses of a detector divided by its threshold."""

    name: str
    label: str
    colour: str
    values: Series  # over the threshold, or without one over the peak; NaN during warm-up
    thresholded: bool  # whether the values are over a threshold

    @property
    def unit(self) -> str:
        """The words after a value."""
        return "times the threshold" if self.thresholded else "of its peak"

    @property
    def best(self) -> int:
        """The row of the largest value."""
        return int(np.nanargmax(self.values))

    @property
    def peak(self) -> float:
        """The largest value."""
        return float(self.values[self.best])


class _AlarmSpan(NamedTuple):
    curve: RelativeCurve
    first: int  # row
    last: int  # row
    frame: int  # of the first row
    start_s: float
    end_s: float  # of the last frame's display
    peak: float  # of the curve's values in this time
    contact_s: float | None  # from start_s to contact, by the first estimate in this time


@dataclass(frozen=True)
class Content:
    """The content of a result's page.

    Each box is ``[x, y, width, height, centre_x, centre_y, id, alarm, time to contact]`` in source
    pixels and seconds. A number that is not known is None.
    """

    result: BaseResult
    curves: list[RelativeCurve]
    alarms: list[_AlarmSpan]  # in the order of their first rows
    boxes: _Boxes  # by row
    box_colour: str  # of the boxes' detector
    truth: dict[str, Any] | None  # sizes and contacts of a stimulus
    notes: list[str]  # remarks on the result, a sentence each

    @classmethod
    def of(cls, result: BaseResult) -> Content:
        """Return the content of a result's page.

        Raises
        ------
        ResultError
            If the result is of another version, if one of its files is damaged, or if a detector
            responded to no frame.
        """
        check_schema(result)
        result.need_responses(result.models)
        curves = [_curve(result, name) for name in result.models]
        placing = placing_detector(result.models)
        name, colour = (placing.name, placing.colour) if placing else ("", "")
        boxes = _boxes(result, name) if placing else {}
        alarms: list[_AlarmSpan] = []
        for curve in curves:
            alarms += _alarms(result, curve, boxes if curve.name == name else {})
        alarms.sort(key=lambda span: span.first)
        notes = _notes(result, curves)
        try:
            truth = _truth(result)
        except (OpploadError, KeyError, TypeError, ValueError) as error:
            truth = None
            notes.append(f"the ground truth of its stimulus cannot be read ({error})")
        return cls(result, curves, alarms, boxes, colour, truth, notes)

    @property
    def strongest(self) -> RelativeCurve:
        """The curve with the largest peak; curves over a threshold come before others."""
        return max(self.curves, key=lambda curve: (curve.thresholded, curve.peak))

    @property
    def reason(self) -> str:
        """Why the strongest response above its threshold caused no alarm.

        The text is the end of a sentence; it is empty in all other cases.
        """
        best = self.strongest
        alarms = [alarm for alarm in self.alarms if alarm.curve is best]
        if not best.thresholded:
            return ""
        if best.peak > max([1.0, *(alarm.peak for alarm in alarms)]):
            alarms_part = self.result.part("alarms")
            return f", {uncounted_in(alarms_part, best.name, beside_alarms=bool(alarms))}"
        return ""

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the source in pixels; if not known, of the part that boxes reach."""
        facts = self.result.part("input")
        try:
            return int(facts["width"]), int(facts["height"])
        except (KeyError, TypeError, ValueError):
            boxes = [box for boxes in self.boxes.values() for box in boxes]
            right = max((box[0] + box[2] for box in boxes), default=16)
            bottom = max((box[1] + box[3] for box in boxes), default=9)
            return round(right), round(bottom)

    def settings(self) -> dict[str, dict[str, str]]:
        """Return the settings of the run from the sidecar, as texts by group and name."""
        sidecar = self.result.sidecar
        command = " ".join(map(str, sidecar["command"])) if "command" in sidecar else None
        groups: dict[str, Any] = {
            "run": {"command": command, "models": ", ".join(self.result.models)},
            **{name: self.result.part(name) for name in ("input", "working", "decode", "tool")},
            **{f"parameters: {n}": values for n, values in self.result.part("parameters").items()},
        }
        return {
            printable(str(group)): {
                printable(str(name)): printable(_as_text(value))
                for name, value in values.items()
                if value is not None
            }
            for group, values in groups.items()
            if isinstance(values, dict)
        }

    def data(self) -> dict[str, Any]:
        """Return the data for the script of the page, ready for JSON."""
        frames = self.result.frames
        rmo = [name for name in ("rmo_index", "rmo_mean") if name in frames.columns]
        return {
            "frames": frames["frame"].to_numpy(int).tolist(),
            "time": _rounded(frames["time_s"].to_numpy(float), 9),
            "size": self.size,
            "curves": [
                {
                    "label": curve.label,
                    "colour": curve.colour,
                    "thresholded": curve.thresholded,
                    "values": _rounded(_kept_below_one(curve.values)),
                    "alarms": [[a.first, a.last] for a in self.alarms if a.curve is curve],
                }
                for curve in self.curves
            ],
            "rmo": {name: _rounded(check_numbers(self.result.path, frames, name)) for name in rmo},
            "truth": self.truth,
            "boxes": self.boxes,
            "boxColour": self.box_colour,
            "boxInk": ink_on(self.box_colour or INK),
        }


def _curve(result: BaseResult, name: str) -> RelativeCurve:
    detector = detector_named(name)
    response = check_numbers(result.path, result.frames, f"{name}_response")
    threshold = known_threshold(result, name)
    over = threshold if threshold is not None else np.nanmax(response) or 1
    return RelativeCurve(
        name, detector.label, detector.colour, response / over, threshold is not None
    )


def _alarms(result: BaseResult, curve: RelativeCurve, boxes: _Boxes) -> list[_AlarmSpan]:
    times = result.frames["time_s"].to_numpy(float)
    frames = result.frames["frame"].tolist()
    ends = frame_ends(times)
    return [
        _AlarmSpan(
            curve,
            first,
            stop - 1,
            int(frames[first]),
            float(times[first]),
            float(ends[stop - 1]),
            float(np.nanmax(curve.values[first:stop], initial=0.0)),
            _contact_s(times, range(first, stop), boxes),
        )
        for first, stop in alarm_rows(result, curve.name)
    ]


def _contact_s(times: Series, rows: range, boxes: _Boxes) -> float | None:
    """Return the time from the first row to contact, by the first estimate in the rows."""
    for row in rows:
        remaining_s = boxes[row][0][-1] if row in boxes else None
        if remaining_s is not None:
            return float(times[row] - times[rows[0]] + remaining_s)
    return None


def _boxes(result: BaseResult, name: str) -> _Boxes:
    """Return the boxes by row: from ``detections.jsonl``, or from the table without this file."""
    rows = {int(frame): row for row, frame in enumerate(result.frames["frame"])}
    boxes: _Boxes = {}
    detections = read_detections(result.path)
    if detections is not None:
        for detection in detections:
            if detection["frame"] in rows:
                boxes.setdefault(rows[detection["frame"]], []).append(
                    [_short(detection.get(key)) for key in _DETECTION]
                )
        return boxes
    sides = [f"{name}_{side}" for side in _DETECTION[:4]]
    if not set(sides) <= set(result.frames.columns):
        return boxes
    table = np.array([check_numbers(result.path, result.frames, side) for side in sides]).T
    alarm = result.frames.get(f"{name}_alarm")
    for row in np.flatnonzero(np.isfinite(table).all(axis=1)):
        on = alarm is not None and bool(alarm.iloc[row] == 1)
        boxes[int(row)] = [[*map(_short, table[row].tolist()), None, None, None, on, None]]
    return boxes


def _truth(result: BaseResult) -> dict[str, Any] | None:
    """Return angular sizes by object and row, whether an object looms by row, and the contacts."""
    truth = find_truth(result)
    if truth is None:
        return None
    by_frame = {int(frame["frame"]): frame for frame in truth["frames"]}
    frames = [by_frame.get(int(frame)) for frame in result.frames["frame"]]
    return {
        "sizes": {str(name): [*map(_short, sizes)] for name, sizes in sizes_in(frames).items()},
        "looming": [bool(frame and frame["looming"]) for frame in frames],
        "contacts": contacts_of(truth),
    }


def _notes(result: BaseResult, curves: list[RelativeCurve]) -> list[str]:
    notes = []
    if result.path.name.endswith(PART):
        notes.append("the run was interrupted; the page shows the frames that it had written")
    if not result.sidecar:
        notes.append(
            "the result has no sidecar; thresholds are those of the default settings, and may not "
            "be those of the run"
        )
    version = result.part("tool").get("oppload")
    if version not in (None, __version__):
        notes.append(f"the result was made by oppload {version}, the page by {__version__}")
    decode = result.part("decode")
    if decode.get("complete") is False:
        messages = decode.get("messages")
        reasons = "; ".join(map(str, messages)) if isinstance(messages, list) else ""
        notes.append(f"the video was not read completely ({reasons or 'damaged frames'})")
    if result.shortfall:
        notes.append(result.shortfall)
    notes += map(str, result.sidecar.get("remarks", ()))
    off = [curve.label for curve in curves if not curve.thresholded]
    if off:
        notes.append(f"no alarm of {', '.join(off)}: each curve is divided by its peak")
    return notes


def _as_text(value: Any) -> str:
    """Return a setting as text without the brackets and quotes of Python."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, dict):
        return ", ".join(f"{name} {_as_text(inner)}" for name, inner in value.items())
    return ", ".join(map(_as_text, value)) or "none" if isinstance(value, list) else str(value)


def _kept_below_one(values: Series) -> Series:
    """Return values of which none below 1 becomes 1 when it is rounded."""
    return np.where(values < 1, np.minimum(values, 1 - 10.0**-_DIGITS), values)


def _short(value: Any) -> Any:
    """Return a float with a few digits, and any other value unchanged."""
    return float(f"{value:.{_DIGITS + 2}g}") if isinstance(value, float) else value


def _rounded(values: Series, digits: int = _DIGITS) -> list[float | None]:
    """Return numbers for JSON, None for NaN."""
    return [float(f"{value:.{digits}g}") if np.isfinite(value) else None for value in values]
