"""The files of a benchmark: tidy tables, figures and one page."""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from matplotlib.colors import LogNorm

from oppload_cli.benchmark.battery import BATTERY, CONTROL, LOOMING, TABLES
from oppload_cli.environment import environment
from oppload_cli.errors import OutputError
from oppload_cli.evaluation.detectors import label_of
from oppload_cli.evaluation.page import number
from oppload_cli.files.atomic import output_errors, remove, write_atomic
from oppload_cli.files.html import embedded, rendered
from oppload_cli.files.tables import open_table
from oppload_cli.models.registry import detectors
from oppload_cli.plots.style import PAGE, SHADES, image_bytes, save, styled_figure
from oppload_cli.results.table import write_sidecar

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from oppload_cli.benchmark.battery import Shown, Table
    from oppload_cli.evaluation.detectors import EvaluatedDetector
    from oppload_cli.evaluation.evaluate import Evaluation
    from oppload_cli.files.tables import Cell

_SCHEMA = "oppload.benchmark/1"
_STIMULI: dict[str, type] = {
    "table": str,
    "column": str,
    "kind": str,
    "stimulus": str,
    "detector": str,
    "peak": float,
    "peak_over_loom": float,
    "peak_time_s": float,
    "motion_end_s": float,
    "alarms": int,
    "first_alarm_s": float,
}
_SUMMARY: dict[str, type] = {
    "detector": str,
    "auc": float,
    "looming_alarmed": int,
    "looming": int,
    "controls_alarmed": int,
    "controls": int,
    "largest_control_over_loom": float,
    "largest_control": str,
    "cost_ms": float,
}
_DOTS = "dots: alarm, half a dot: for some stimuli"
_LEAST, _MOST = 1e-3, 10.0  # the shades end here at most: response over that to the looming disk
_ROOM = 6  # rows beside which the bar has room for its label
_SIDECAR = "benchmark.json"
_FILES = ("stimuli.csv", "summary.csv", _SIDECAR, "benchmark.html")


class _Cells(NamedTuple):
    """One column of a table for one detector.

    `over_loom` is the largest response to its stimuli over that to the looming disk: 0 without a
    response to them, infinite without a response to the disk alone.
    """

    over_loom: float
    alarmed: int
    stimuli: int


class _Summary(NamedTuple):
    """The figures of one detector over the complete battery: a row of ``summary.csv``.

    A stimulus of several tables counts once. `auc` is the chance that its peak is larger for a
    looming stimulus than for a control; 0.5 tells nothing apart. `largest_control` is the column
    of that control. `cost_ms` is per frame of 427 x 240 on one core.
    """

    auc: float
    looming_alarmed: int
    looming: int
    controls_alarmed: int
    controls: int
    largest_control_over_loom: float
    largest_control: str
    cost_ms: float | None


class Benchmark:
    """Everything that was measured.

    Parameters
    ----------
    shown : sequence of Shown
        Every stimulus, in the order of the battery.
    evaluated : sequence of EvaluatedDetector
        The detectors.
    clips : Evaluation, optional
        On labelled clips.
    """

    def __init__(
        self,
        shown: Sequence[Shown],
        evaluated: Sequence[EvaluatedDetector],
        clips: Evaluation | None = None,
    ) -> None:
        self.shown, self.detectors, self.clips = shown, list(evaluated), clips
        self.names = [each.name for each in evaluated]
        found = {
            name: [next(one for one in each.measured if one.detector == name) for each in shown]
            for name in self.names
        }
        self._peaks = {name: np.array([one.peak or 0.0 for one in found[name]]) for name in found}
        self._alarmed = {name: np.array([one.alarms > 0 for one in found[name]]) for name in found}
        first = next(i for i, each in enumerate(shown) if each.column is BATTERY[0])
        self.loom = {name: float(self._peaks[name][first]) for name in self.names}
        self.tables = [table for table in TABLES if len(self.labels(table)) > 1]

    def labels(self, table: Table) -> list[str]:
        """Return the headings of a table's columns."""
        columns = [each.column for each in self.shown if each.column.table == table.name]
        return list(dict.fromkeys(column.label for column in columns))

    def over_loom(self, name: str, peak: float) -> float:
        """Return a response over that to the looming disk; infinite where that is 0."""
        if peak == 0:
            return 0.0
        return peak / self.loom[name] if self.loom[name] else math.inf

    def cells(self, table: Table, label: str, name: str) -> _Cells:
        """Return one cell of a table."""
        part = [
            (each.column.table, each.column.label) == (table.name, label) for each in self.shown
        ]
        peaks, alarmed = self._peaks[name][part], self._alarmed[name][part]
        return _Cells(self.over_loom(name, float(peaks.max())), int(alarmed.sum()), len(alarmed))

    def summary(self, name: str) -> _Summary:
        """Return the figures of one detector over the complete battery, each stimulus once."""
        once = np.sort(np.unique([each.key for each in self.shown], return_index=True)[1])
        shown, peaks = [self.shown[place] for place in once], self._peaks[name][once]
        kinds = np.array([each.column.kind for each in shown])
        alarmed = self._alarmed[name][once]
        looming, control = kinds == LOOMING, kinds == CONTROL
        higher = peaks[looming][:, None] - peaks[control]
        auc = float(np.mean(higher > 0) + np.mean(higher == 0) / 2) if higher.size else math.nan
        worst, over = "", math.nan
        if control.any():
            place = int(np.argmax(np.where(control, peaks, -1)))
            over = self.over_loom(name, float(peaks[place]))
            worst = shown[place].column.label
        cost = detectors()[name.partition(":")[0]].cost_ms
        return _Summary(
            auc,
            int(alarmed[looming].sum()),
            int(looming.sum()),
            int(alarmed[control].sum()),
            int(control.sum()),
            over,
            worst,
            cost,
        )


def settings_of(
    detectors: Sequence[EvaluatedDetector], tables: Sequence[str], manifest: Path | None
) -> dict[str, Any]:
    """Return what decides the files of a benchmark, as ``benchmark.json`` holds it."""
    return {
        "detectors": {each.name: each.as_dict() for each in detectors},
        "tables": list(tables),
        "manifest": None if manifest is None else str(manifest),
    }


def refuse_other(folder: Path, settings: Mapping[str, Any]) -> None:
    """Raise OutputError if a folder holds a benchmark of other settings."""
    path = folder / _SIDECAR
    there = _kept(folder)
    if there is None:
        return
    # As it would be read again: tuples are lists there.
    asked = json.loads(json.dumps(settings, default=str))
    other = [key for key, value in asked.items() if there.get(key, value) != value or not there]
    if other:
        raise OutputError(
            f"{path}: is a benchmark with other {' and '.join(other)}; choose --if-exists "
            "overwrite, or another --output"
        )


def _kept(folder: Path) -> dict[str, Any] | None:
    """Return the ``benchmark.json`` of a folder; None without one, empty if it is damaged."""
    try:
        held = json.loads((folder / _SIDECAR).read_text("utf-8"))
    except FileNotFoundError:
        return None
    except (OSError, ValueError):
        return {}
    return held if isinstance(held, dict) else {}


def write_benchmark(
    benchmark: Benchmark, folder: Path, *, command: Sequence[str], settings: Mapping[str, Any]
) -> Iterator[Path]:
    """Write all files of a benchmark.

    Parameters
    ----------
    benchmark : Benchmark
        The measurements.
    folder : Path
        For the files.
    command : sequence of str
        The command line, for ``benchmark.json``.
    settings : mapping
        From :func:`settings_of`.

    Yields
    ------
    Path
        Each file once it is written.

    Raises
    ------
    OutputError
        If one cannot be written.
    """
    # Also figures of an earlier benchmark there that this one does not make.
    earlier = () if _kept(folder) is None else (f"{table.name}.pdf" for table in TABLES)
    for name in (*earlier, *_FILES):
        with output_errors(folder / name):
            remove(folder / name)
    summaries = {name: benchmark.summary(name) for name in benchmark.names}
    figures = ({"detector": name, **each._asdict()} for name, each in summaries.items())
    for name, columns, rows in (
        ("stimuli.csv", _STIMULI, _rows(benchmark)),
        ("summary.csv", _SUMMARY, figures),
    ):
        with open_table(folder / name, columns) as table:
            for row in rows:
                table.write({key: _known(value) for key, value in row.items()})
        yield folder / name
    pictures = {}
    for each in benchmark.tables:
        figure = _drawn(benchmark, each)
        path = folder / f"{each.name}.pdf"
        save(figure, path)
        pictures[each.name] = image_bytes(figure, "png", 160)
        yield path
    facts = {"schema": _SCHEMA, "tool": environment(), "command": list(command)}
    write_sidecar(folder / _SIDECAR, {**facts, **settings})
    yield folder / _SIDECAR
    write_atomic(folder / "benchmark.html", _page(benchmark, summaries, pictures))
    yield folder / "benchmark.html"


def _rows(benchmark: Benchmark) -> Iterator[dict[str, Cell]]:
    for each in benchmark.shown:
        for found in each.measured:
            yield {
                "table": each.column.table,
                "column": each.column.label,
                "kind": each.column.kind,
                "stimulus": each.stimulus,
                "detector": found.detector,
                "peak": found.peak,
                "peak_over_loom": benchmark.over_loom(found.detector, found.peak or 0.0),
                "peak_time_s": found.peak_time_s,
                "motion_end_s": each.motion_end_s,
                "alarms": found.alarms,
                "first_alarm_s": found.first_alarm_s,
            }


def _known(value: Cell) -> Cell:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _drawn(benchmark: Benchmark, table: Table) -> Figure:
    """Draw one table as a heat map: response over that to the looming disk, dots for alarms."""
    labels, names = benchmark.labels(table), benchmark.names
    cells = [[benchmark.cells(table, label, name) for label in labels] for name in names]
    values = np.array([[cell.over_loom for cell in row] for row in cells])
    least, most = _limits(values)
    width = min(PAGE, 2.4 + 0.26 * len(labels) + 0.9)
    with styled_figure(width, 1.35 + 0.17 * len(names) + 0.35) as figure:
        axes = figure.subplots()
        norm = LogNorm(least, most)
        shades = axes.imshow(
            np.clip(np.nan_to_num(values, nan=0.0, posinf=most), least, most),
            norm=norm, cmap=SHADES, aspect="auto",
        )  # fmt: skip
        for y, row in enumerate(cells):
            for x, cell in enumerate(row):
                if cell.alarmed:
                    whole = cell.alarmed == cell.stimuli
                    bright = norm(np.clip(cell.over_loom, least, most)) > 0.5
                    axes.plot(
                        x,
                        y,
                        "o",
                        markersize=4,
                        markeredgewidth=0.5,
                        color="black" if bright else "white",
                        fillstyle="full" if whole else "left",
                    )
        axes.set_xticks(range(len(labels)), labels, rotation=60, ha="right", rotation_mode="anchor")
        axes.set_yticks(range(len(names)), [label_of(name) for name in names])
        axes.set_xlabel(table.axis)
        axes.set_title(f"{table.title}\nshades: response over that to the looming disk\n{_DOTS}")
        axes.tick_params(length=0)
        axes.spines[:].set_visible(False)
        bar = figure.colorbar(shades, ax=axes, pad=0.02, extend="both")
        steps = (1,) if most > 100 * least else (1, 2, 5)
        ticks = [step * 10.0**decade for decade in range(-3, 2) for step in steps]
        shown = [tick for tick in ticks if 0.999 * least <= tick <= 1.001 * most]
        bar.set_ticks(shown, labels=[f"{tick:g}" for tick in shown])
        bar.ax.minorticks_off()
        bar.set_label("over the disk" if len(names) < _ROOM else "over the looming disk")
    return figure


def _limits(values: NDArray[np.float64]) -> tuple[float, float]:
    """Return the ends of the shades: those of the responses, but of three decades at most.

    They are apart by a factor of two at least, so that equal responses look alike.
    """
    known = values[np.isfinite(values) & (values > 0)]
    most = float(np.clip(known.max(initial=0), 2 * _LEAST, _MOST))
    least = float(np.clip(known.min(initial=most), _LEAST, most / 2))
    return least, most


def _page(
    benchmark: Benchmark, summaries: Mapping[str, _Summary], pictures: Mapping[str, bytes]
) -> str:
    clips = []
    if benchmark.clips is not None:
        chosen = (
            ("detection_rate", "at 1 per minute"),
            ("detection_rate", "alarm as shipped"),
            ("false_alarms_per_minute", "alarm as shipped"),
            ("roc_auc", "last second before contact"),
        )
        values = {
            (each.detector, each.measure, each.condition): each.value
            for each in benchmark.clips.measurements
        }
        clips = [
            (name, [values.get((name, *which), math.nan) for which in chosen])
            for name in benchmark.names
        ]
    return rendered(
        "benchmark.html",
        summaries=sorted(summaries.items(), key=lambda item: -np.nan_to_num(item[1].auc, nan=-1.0)),
        tables=[(table, embedded(pictures[table.name])) for table in benchmark.tables],
        clips=clips,
        detectors={name: detectors()[name.partition(":")[0]] for name in benchmark.names},
        label_of=label_of,
        number=number,
    )
