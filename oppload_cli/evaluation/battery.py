"""The battery: stimuli that show to what a detector responds, as labelled clips."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from oppload_cli.evaluation.clip_inputs import labelled
from oppload_cli.evaluation.metrics.alarms import SHIPPED
from oppload_cli.evaluation.metrics.measures import KIND
from oppload_cli.models.registry import detector_named
from oppload_cli.stimulus.catalogue import find
from oppload_cli.stimulus.protocol import Protocol

if TYPE_CHECKING:
    from collections.abc import Iterator

    from oppload_cli.evaluation.engine import Evaluation
    from oppload_cli.evaluation.manifest import Manifest
    from oppload_cli.evaluation.metrics.clips import Flags, Numbers
    from oppload_cli.files.tables import Cell


# The tables of the battery and their titles. The stimuli of a table differ in one property, whose
# name is that of the table; it is a condition of the measures.
TABLES = {
    KIND: "Kind of motion",
    "polarity": "Polarity of the disk",
    "contrast": "Contrast of the disk",
    "noise": "Noise: share of white",
    "speed": "Speed: l/v",
    "size": "Size at the end",
    "place": "Place: right, up",
    "background": "Motion behind the disk",
}
_LOOM = "klapoetke2017/loom-l-over-v"
_L_OVER_V, _MOST = "disk.growth.l_over_v_ms", "disk.growth.most_deg"
_DISK = {_L_OVER_V: 40}
_QUARTERS = [0, 45, 90, 135]


@dataclass(frozen=True)
class BatteryColumn:
    """One stimulus of the catalogue, or several that count together."""

    table: str  # a key of `TABLES`
    label: str
    stimulus: str
    # Changed values of the protocol by key; a list of values gives a stimulus for each value.
    settings: dict[str, Any] = field(default_factory=dict)

    def protocols(self) -> list[Protocol]:
        """Return the protocols of the stimuli."""
        return find(self.stimulus)[0].with_settings(self.settings).protocols()


# The looming disk is the first: the response to it is the unit of all responses.
BATTERY = (
    BatteryColumn(KIND, "looming disk", _LOOM, _DISK),
    BatteryColumn(KIND, "looming square", "controls/looming-square"),
    BatteryColumn(KIND, "looming patch", "controls/looming-patch"),
    BatteryColumn(KIND, "receding disk", "controls/receding-disk", _DISK),
    BatteryColumn(KIND, "receding patch", "controls/receding-patch"),
    BatteryColumn(KIND, "near miss", "controls/near-miss"),
    BatteryColumn(
        KIND,
        "translating disk",
        "controls/translating-disk-speed",
        {"disk.motion.speed_deg_s": [20, 40, 80]},
    ),
    BatteryColumn(KIND, "translating bar", "controls/translating-bar-speed"),
    BatteryColumn(KIND, "turning bar", "controls/rotating-bar"),
    BatteryColumn(KIND, "grating", "controls/square-grating", {"grating.axis_deg": _QUARTERS}),
    BatteryColumn(KIND, "plaid", "controls/plaid"),
    BatteryColumn(KIND, "pan", "controls/texture-pan", {"ground.motion.direction_deg": _QUARTERS}),
    BatteryColumn(KIND, "roll", "controls/texture-rotation"),
    BatteryColumn(KIND, "forward and backward", "controls/texture-zoom"),
    BatteryColumn(KIND, "drifting dots", "controls/dots-drift"),
    BatteryColumn(KIND, "shake", "controls/camera-shake"),
    BatteryColumn(KIND, "flicker", "controls/flicker"),
    BatteryColumn(KIND, "luminance step", "controls/luminance-step"),
    BatteryColumn(KIND, "dimming, brightening", "controls/luminance-ramp"),
    BatteryColumn(KIND, "appearing disk", "controls/appearing-disk"),
    BatteryColumn(KIND, "noise", "controls/static-texture", {"effects.noise": 0.05}),
    BatteryColumn("polarity", "dark", _LOOM, _DISK),
    BatteryColumn("polarity", "bright", "klapoetke2017/loom-bright", _DISK),
    *(
        BatteryColumn(
            "contrast",
            f"{contrast:g}",
            "controls/looming-contrast",
            {"display.background": 0.5, "disk.luminance": round(0.5 * (1 - contrast), 6)},
        )
        for contrast in (0.1, 0.2, 0.3, 0.5, 0.7, 1.0)
    ),
    *(
        BatteryColumn("noise", f"{noise:g}", "controls/looming-noise", {"effects.noise": noise})
        for noise in (0.0, 0.02, 0.05, 0.1, 0.2)
    ),
    *(
        BatteryColumn("speed", f"{ratio} ms", _LOOM, {_L_OVER_V: ratio})
        for ratio in (10, 20, 40, 60, 80, 100, 140, 200)
    ),
    *(
        BatteryColumn("size", f"{size} deg", _LOOM, {**_DISK, _MOST: size})
        for size in (10, 20, 30, 45, 60)
    ),
    *(
        BatteryColumn(
            "place", f"{x}, {y} deg", _LOOM, {**_DISK, _MOST: 40, "disk.centre_deg": [x, y]}
        )
        for x, y in ((0, 0), (10, 0), (20, 0), (0, 10), (-10, 0), (0, -10), (14, 14))
    ),
    BatteryColumn("background", "still texture", "controls/looming-on-static-texture"),
    *(
        BatteryColumn(
            "background",
            f"pan {speed} deg/s",
            "controls/looming-on-moving-texture",
            {"ground.motion.speed_deg_s": speed, "ground.motion.direction_deg": 0},
        )
        for speed in (5, 15, 30)
    ),
    BatteryColumn("background", "forward motion", "controls/looming-on-zooming-texture"),
    BatteryColumn("background", "shake", "controls/looming-with-shake"),
)


def battery_stimuli() -> Manifest:
    """Return the stimuli of the battery with labels from their ground truth, each stimulus once.

    The conditions of a label hold, by table, the column of the stimulus.
    """
    protocols: list[Protocol] = []
    names: list[str] = []
    columns: list[dict[str, str]] = []
    for column in BATTERY:
        own = column.protocols()
        for protocol in own:
            if protocol in protocols:
                columns[protocols.index(protocol)][column.table] = column.label
                continue
            name = column.label if column.table == KIND else f"{column.table} {column.label}"
            part = f", {protocol.name.rpartition('/')[2]}" if len(own) > 1 else ""
            protocols.append(protocol)
            names.append(name + part)
            columns.append({column.table: column.label})
    stimuli = labelled(protocols, [])
    entries = [
        replace(
            entry,
            label=replace(
                entry.label,
                name=name,
                conditions=conditions,
                motion="" if entry.label.looming else conditions[KIND],
            ),
        )
        for entry, name, conditions in zip(stimuli.entries, names, columns, strict=True)
    ]
    return replace(stimuli, entries=entries)


class BatterySummary(NamedTuple):
    """The results of one detector over the battery; NaN or None where they are not known."""

    # Probability that the peak for a looming stimulus is larger than that for a control; 0.5 is
    # chance.
    auc: float
    approaches_detected: int | None  # by the alarm as shipped; None if the alarms are off
    approaches: int
    controls_alarmed: int | None
    controls: int
    largest_control_over_loom: float
    largest_control: str  # kind of motion of the control with the largest response
    cost_ms: float | None  # declared time for a frame of its working size on one core


class BatteryResponses:
    """The responses and alarms of all detectors, from an evaluation of `battery_stimuli`.

    Attributes
    ----------
    names : list of str
        The detectors.
    over_loom : dict of ndarray, by detector
        The largest response in each clip divided by that to the looming disk: 0 if the response is
        0, infinite if only that to the disk is 0, NaN if the disk is missing.
    alarmed : dict of ndarray, by detector
        1 for an approach that the alarm as shipped detects and for a control with a false alarm,
        else 0; NaN if the detector's alarms are off.
    """

    def __init__(self, evaluation: Evaluation) -> None:
        self._clips, self._entries = evaluation.clips, evaluation.entries
        self._looming = np.array([clip.label.looming for clip in self._clips])
        self.names = [detector.name for detector in evaluation.detectors]
        self._outcomes = {
            name: evaluation.performances[name].decisions[SHIPPED].outcomes for name in self.names
        }
        self._peaks = {
            name: np.array([np.nanmax(clip.outputs[name].response) for clip in self._clips])
            for name in self.names
        }
        self.over_loom = {name: self._over_loom(peaks) for name, peaks in self._peaks.items()}
        self.alarmed = {
            name: np.where(self._looming, outcomes.detected, np.minimum(outcomes.false_alarms, 1))
            for name, outcomes in self._outcomes.items()
        }

    def columns(self, table: str) -> dict[str, Flags]:
        """Return by label of a table's columns, in their order, which of the clips they have."""
        labels = [clip.label.conditions.get(table) for clip in self._clips]
        return {
            column.label: np.array([label == column.label for label in labels])
            for column in BATTERY
            if column.table == table and column.label in labels
        }

    def _over_loom(self, peaks: Numbers) -> Numbers:
        loom = peaks[self.columns(KIND).get(BATTERY[0].label, np.zeros(len(peaks), bool))]
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(peaks == 0, 0.0, peaks / (loom[0] if len(loom) else math.nan))

    def summary(self, name: str) -> BatterySummary:
        """Return the results of one detector over all stimuli."""
        peaks, alarmed, looming = self._peaks[name], self.alarmed[name], self._looming
        excess = peaks[looming][:, None] - peaks[~looming]
        auc = float(np.mean(excess > 0) + np.mean(excess == 0) / 2) if excess.size else math.nan
        control, over_loom = "", math.nan
        if not looming.all():
            largest = int(np.argmax(np.where(looming, -1, peaks)))
            control = self._clips[largest].label.motion
            over_loom = float(self.over_loom[name][largest])
        on = not np.isnan(alarmed).any()
        return BatterySummary(
            auc,
            int(alarmed[looming].sum()) if on else None,
            int(looming.sum()),
            int(alarmed[~looming].sum()) if on else None,
            int((~looming).sum()),
            over_loom,
            control,
            detector_named(name).cost_ms,
        )

    def rows(self) -> Iterator[dict[str, Cell]]:
        """Yield the rows of ``battery.csv``: one for each column, stimulus and detector."""
        for table in TABLES:
            for label, shown in self.columns(table).items():
                for index in map(int, np.flatnonzero(shown)):
                    for name in self.names:
                        found = self._found(index, name)
                        yield {"table": table, "column": label, **found}

    def _found(self, index: int, name: str) -> dict[str, Cell]:
        """Return what was measured of a detector in one clip."""
        clip, stimulus = self._clips[index], self._entries[index].path
        outcomes = self._outcomes[name]
        return {
            "clip": clip.label.name,
            "stimulus": stimulus.name,
            "contender": name,
            "peak": float(self._peaks[name][index]),
            "peak_over_loom": float(self.over_loom[name][index]),
            "peak_time_s": float(clip.time_s[np.nanargmax(clip.outputs[name].response)]),
            "motion_end_s": stimulus.timing.end_s if isinstance(stimulus, Protocol) else None,
            "detected": known(outcomes.detected[index], bool),
            "lead_s": float(outcomes.lead_s[index]),
            "false_alarms": known(outcomes.false_alarms[index], int),
        }


BATTERY_COLUMNS = (
    *("table", "column", "clip", "stimulus", "contender", "peak", "peak_over_loom"),
    *("peak_time_s", "motion_end_s", "detected", "lead_s", "false_alarms"),
)


def known(value: float, kind: type[int]) -> int | None:
    """Return an outcome as a whole number or a truth value; None for NaN."""
    return None if math.isnan(value) else kind(value)
