"""The files of a benchmark: tables, figures and one page."""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from matplotlib.colors import LogNorm

from oppload_cli.benchmark.battery import CONTROL, LOOMING, TABLES, BatteryTable, Shown
from oppload_cli.environment import environment
from oppload_cli.errors import OutputError
from oppload_cli.evaluation.detectors import EvaluatedDetector, full_label
from oppload_cli.evaluation.output import report_of
from oppload_cli.evaluation.page import NO_VALUE, number
from oppload_cli.files.atomic import output_errors, refuse_existing, remove, write_atomic
from oppload_cli.files.html import embedded, rendered
from oppload_cli.files.tables import Cell, csv_text, finite_text
from oppload_cli.models.presets import DEFAULT_PRESET
from oppload_cli.models.registry import detector_named
from oppload_cli.plots.style import (
    PAGE,
    SHADES,
    image_bytes,
    plain,
    save,
    styled_figure,
    write_title,
)
from oppload_cli.results.table import write_sidecar

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from oppload_cli.evaluation.evaluate import Evaluation
    from oppload_cli.files.atomic import PartFile

_SCHEMA = "oppload.benchmark/1"
_LEAST, _MOST = 1e-3, 10.0  # widest range of the shades, in responses to the looming disk
_LEAST_ROWS = 5  # the figure is at least as high, so that the numbers at its colour bar are apart
_ROWS_FOR_LABEL = 6  # from this number of rows on, the colour bar is high enough for its long label
SIDECAR = "benchmark.json"
_FILES = ("stimuli.csv", "summary.csv", SIDECAR, "benchmark.html")


class _TableCell(NamedTuple):
    """The results of one detector in one column of a table."""

    over_loom: float  # largest response over the response to the looming disk
    alarmed: int  # number of the stimuli with an alarm
    stimuli: int


class _Summary(NamedTuple):
    """The results of one detector over all stimuli shown: a row of ``summary.csv``."""

    # Probability that the peak for a looming stimulus is larger than that for a control; 0.5 is
    # chance.
    auc: float
    looming_alarmed: int | None  # stimuli with an alarm; None if the detector's alarms are off
    looming: int
    controls_alarmed: int | None
    controls: int
    largest_control_over_loom: float
    largest_control: str  # label of the control with the largest response
    # Time for a frame of 427 x 240 on one core; None with another preset than the usual one, under
    # which it was measured.
    cost_ms: float | None


class Benchmark:
    """All measurements of a benchmark.

    `shown` has the stimuli with their measurements, in the order of the battery: the looming disk
    is the first. `clips` is an evaluation of the same detectors on labelled clips, if there is one.
    """

    def __init__(
        self,
        shown: Sequence[Shown],
        evaluated: Sequence[EvaluatedDetector],
        clips: Evaluation | None = None,
    ) -> None:
        self.shown, self.clips = shown, clips
        self.names = [each.name for each in evaluated]
        self.alarms_on = {each.name: each.alarm.on for each in evaluated}
        self.detectors = {each.name: detector_named(each.detector) for each in evaluated}
        measured = {name: [each.measured[name] for each in shown] for name in self.names}
        self._peaks = {
            name: np.array([each.peak or 0.0 for each in row]) for name, row in measured.items()
        }
        self._alarmed = {
            name: np.array([each.alarms > 0 for each in row]) for name, row in measured.items()
        }
        self.loom = {name: float(self._peaks[name][0]) for name in self.names}
        self.tables = [table for table in TABLES if len(self.labels(table)) > 1]

    def labels(self, table: BatteryTable) -> list[str]:
        """Return the headings of a table's columns."""
        columns = [each.column for each in self.shown if each.column.table == table.name]
        return list(dict.fromkeys(column.label for column in columns))

    def over_loom(self, name: str, peak: float) -> float:
        """Return a response divided by the response to the looming disk.

        0 if the first is 0, infinite if only the second is 0.
        """
        if peak == 0:
            return 0.0
        return peak / self.loom[name] if self.loom[name] else math.inf

    def cell(self, table: BatteryTable, label: str, name: str) -> _TableCell:
        """Return the results of one detector in the column `label` of a table."""
        part = [
            (each.column.table, each.column.label) == (table.name, label) for each in self.shown
        ]
        peaks, alarmed = self._peaks[name][part], self._alarmed[name][part]
        over_loom = self.over_loom(name, float(peaks.max()))
        return _TableCell(over_loom, int(alarmed.sum()), len(alarmed))

    def summary(self, name: str) -> _Summary:
        """Return the results of one detector over all stimuli; each stimulus counts once."""
        first_shown = np.sort(np.unique([each.key for each in self.shown], return_index=True)[1])
        shown, peaks = [self.shown[index] for index in first_shown], self._peaks[name][first_shown]
        kinds = np.array([each.column.kind for each in shown])
        alarmed = self._alarmed[name][first_shown]
        looming, control = kinds == LOOMING, kinds == CONTROL
        excess = peaks[looming][:, None] - peaks[control]
        auc = float(np.mean(excess > 0) + np.mean(excess == 0) / 2) if excess.size else math.nan
        largest_label, over_loom = "", math.nan
        if control.any():
            index = int(np.argmax(np.where(control, peaks, -1)))
            over_loom = self.over_loom(name, float(peaks[index]))
            largest_label = shown[index].column.label
        on = self.alarms_on[name]
        usual = name.partition(":")[2] in ("", DEFAULT_PRESET)
        return _Summary(
            auc,
            int(alarmed[looming].sum()) if on else None,
            int(looming.sum()),
            int(alarmed[control].sum()) if on else None,
            int(control.sum()),
            over_loom,
            largest_label,
            self.detectors[name].cost_ms if usual else None,
        )


def settings_of(
    detectors: Sequence[EvaluatedDetector], tables: Sequence[str], manifest: Path | None
) -> dict[str, Any]:
    """Return the settings of a benchmark for ``benchmark.json``."""
    return {
        "detectors": {each.name: each.as_dict() for each in detectors},
        "tables": list(tables),
        "manifest": None if manifest is None else str(manifest),
    }


def refuse_other(folder: Path, settings: Mapping[str, Any]) -> None:
    """Raise OutputError if a folder has a benchmark with other settings, or other such files."""
    earlier = _earlier_sidecar(folder)
    if earlier is None:
        refuse_existing((folder / name for name in _FILES), "error")
        return
    # Through JSON, as `earlier` was: it makes lists of tuples.
    wanted = json.loads(json.dumps(settings, default=str))
    keys = [key for key in wanted if not earlier or earlier.get(key, wanted[key]) != wanted[key]]
    if keys:
        raise OutputError(
            f"{folder / SIDECAR}: is a benchmark with other {' and '.join(keys)}; choose "
            "--if-exists overwrite, or another --output"
        )


def _earlier_sidecar(folder: Path) -> dict[str, Any] | None:
    """Return the content of a folder's ``benchmark.json``; None without it, empty if damaged."""
    try:
        content = json.loads((folder / SIDECAR).read_text("utf-8"))
    except FileNotFoundError:
        return None
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}


def write_benchmark(
    benchmark: Benchmark, sidecar: PartFile, *, command: Sequence[str], settings: Mapping[str, Any]
) -> Iterator[Path]:
    """Write all files of a benchmark; yield each path after the file was written.

    `sidecar` is the part file of ``benchmark.json``, which keeps other runs out of its folder. It
    gets the command line and the settings from :func:`settings_of`. Raises OutputError if a file
    cannot be written.
    """
    folder = sidecar.path.parent
    # Delete the files of an earlier benchmark, also figures that this benchmark does not make.
    earlier = () if _earlier_sidecar(folder) is None else (f"{table.name}.pdf" for table in TABLES)
    for name in (*earlier, *_FILES):
        with output_errors(folder / name):
            remove(folder / name)
    summaries = {name: benchmark.summary(name) for name in benchmark.names}
    rows = [{"detector": name, **each._asdict()} for name, each in summaries.items()]
    for name, of_table in (("stimuli.csv", list(_rows(benchmark))), ("summary.csv", rows)):
        write_atomic(folder / name, csv_text(of_table, of_table[0], finite_text))
        yield folder / name
    pictures = {}
    for each in benchmark.tables:
        figure = _drawn(benchmark, each)
        path = folder / f"{each.name}.pdf"
        save(figure, path)
        pictures[each.name] = image_bytes(figure, "png", 160)
        yield path
    facts = {"schema": _SCHEMA, "tool": environment(), "command": list(command)}
    write_sidecar(sidecar, {**facts, **settings})
    yield sidecar.path
    write_atomic(folder / "benchmark.html", _page(benchmark, summaries, pictures))
    yield folder / "benchmark.html"


def _rows(benchmark: Benchmark) -> Iterator[dict[str, Cell]]:
    for shown in benchmark.shown:
        for measured in shown.measured.values():
            yield {
                "table": shown.column.table,
                "column": shown.column.label,
                "kind": shown.column.kind,
                "stimulus": shown.protocol.name,
                "detector": measured.detector,
                "peak": measured.peak,
                "peak_over_loom": benchmark.over_loom(measured.detector, measured.peak or 0.0),
                "peak_time_s": measured.peak_time_s,
                "motion_end_s": shown.protocol.timing.end_s,
                "alarms": measured.alarms if benchmark.alarms_on[measured.detector] else None,
                "first_alarm_s": measured.first_alarm_s,
            }


def _drawn(benchmark: Benchmark, table: BatteryTable) -> Figure:
    """Draw one table as a heat map of responses, with dots for alarms."""
    labels, names = benchmark.labels(table), benchmark.names
    cells = [[benchmark.cell(table, label, name) for label in labels] for name in names]
    values = np.array([[cell.over_loom for cell in row] for row in cells])
    least, most = _limits(values)
    width = min(PAGE, 2.4 + 0.26 * len(labels) + 0.9)
    rows = max(len(names), _LEAST_ROWS)
    with styled_figure(width, 1.35 + 0.17 * rows + 0.35) as figure:
        axes = figure.subplots()
        norm = LogNorm(least, most)
        shades = axes.imshow(
            np.clip(np.nan_to_num(values, nan=0.0, posinf=most), least, most),
            norm=norm, cmap=SHADES, aspect="auto",
        )  # fmt: skip
        for y, row in enumerate(cells):
            for x, cell in enumerate(row):
                if cell.alarmed:
                    bright = norm(np.clip(cell.over_loom, least, most)) > 0.5
                    fill = "full" if cell.alarmed == cell.stimuli else "left"
                    axes.plot(
                        x, y, "o", markersize=4, markeredgewidth=0.5,
                        color="black" if bright else "white", fillstyle=fill,
                    )  # fmt: skip
        axes.set_xticks(range(len(labels)), labels, rotation=60, ha="right", rotation_mode="anchor")
        axes.set_yticks(range(len(names)), [plain(full_label(name)) for name in names])
        axes.set_xlabel(table.axis)
        # Above the complete figure: above narrow axes, the lines would be cut.
        write_title(
            figure,
            f"{table.title}\nshades: response / that to the looming disk\n"
            "dots: alarm, half a dot: for some stimuli",
        )
        axes.tick_params(length=0)
        axes.spines[:].set_visible(False)
        bar = figure.colorbar(shades, ax=axes, pad=0.02, extend="both")
        steps = (1,) if most > 100 * least else (1, 2, 5)
        ticks = [step * 10.0**decade for decade in range(-3, 2) for step in steps]
        shown = [tick for tick in ticks if 0.999 * least <= tick <= 1.001 * most]
        bar.set_ticks(shown, labels=[f"{tick:g}" for tick in shown])
        bar.ax.minorticks_off()
        long_label = len(names) >= _ROWS_FOR_LABEL
        bar.set_label("response / that to the looming disk" if long_label else "response / disk")
    return figure


def _limits(values: NDArray[np.float64]) -> tuple[float, float]:
    """Return the ends of the shades: the least and largest response, within `_LEAST` and `_MOST`.

    Their ratio is at least 2, so that nearly equal responses have similar shades.
    """
    known = values[np.isfinite(values) & (values > 0)]
    most = float(np.clip(known.max(initial=0), 2 * _LEAST, _MOST))
    least = float(np.clip(known.min(initial=most), _LEAST, most / 2))
    return least, most


def _page(
    benchmark: Benchmark, summaries: Mapping[str, _Summary], pictures: Mapping[str, bytes]
) -> str:
    columns = (
        ("detection_rate", "at 1 per minute"),
        ("detection_rate", "alarm as shipped"),
        ("false_alarms_per_minute", "alarm as shipped"),
        ("roc_auc", "last second before contact"),
    )
    clips = benchmark.clips
    found = {
        (each.detector, each.measure, each.condition): each
        for each in (clips.measurements if clips else ())
    }
    return rendered(
        "benchmark.html",
        summaries=sorted(summaries.items(), key=lambda item: -np.nan_to_num(item[1].auc, nan=-1.0)),
        tables=[(table, embedded(pictures[table.name])) for table in benchmark.tables],
        clips=report_of(clips)["manifest"] if clips else None,
        measured={
            name: [found.get((name, *column)) for column in columns] for name in benchmark.names
        },
        tool=environment(),
        detectors=benchmark.detectors,
        full_label=full_label,
        number=number,
        nothing=NO_VALUE,
    )
