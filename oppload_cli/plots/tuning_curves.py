"""The curves of tuning tables and the labels of their axes, for all kinds of plots of tuning."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING, Any, NamedTuple, get_args

import numpy as np

from oppload_cli.errors import ResultError
from oppload_cli.models.registry import detector_named
from oppload_cli.plots import style
from oppload_cli.schema import DeclaredTable, Parameter
from oppload_cli.stimulus import Protocol

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    import pandas as pd

    from oppload_cli.models.detector import Detector
    from oppload_cli.results.result_files import Series
    from oppload_cli.results.tuning import Tuning


_DEVIATION = "peak_deviation"


class TuningCurve(NamedTuple):
    """The peaks of one detector in a table: a curve of a figure, or a panel."""

    tuning: Tuning
    detector: type[Detector]
    table: str  # its name if there are several tables, else empty
    rows: pd.DataFrame  # of the detector
    look: dict[str, Any]  # line properties of matplotlib

    @property
    def peaks(self) -> Series:
        """The peak in each row."""
        return self.rows["peak"].to_numpy(float)

    @property
    def deviations(self) -> Series | None:
        """The standard deviation of each peak over the seeds; None if it is no mean."""
        return self.rows[_DEVIATION].to_numpy(float) if _DEVIATION in self.rows else None

    @property
    def largest(self) -> float:
        """The largest peak."""
        return float(self.peaks.max())

    @property
    def doubts(self) -> str:
        """Why the curve means little, from the sidecar; a line break before each reason."""
        return "".join(
            f"\n{doubt.get('note')}"
            for doubt in self.tuning.sidecar.get("doubts", ())
            if isinstance(doubt, dict) and doubt.get("model") == self.detector.name
        )

    @property
    def name(self) -> str:
        """The name of the detector, after that of the table if there are several tables."""
        return f"{self.table}: {self.detector.label}" if self.table else self.detector.label

    @property
    def label(self) -> str:
        """The name with the largest peak, for a legend."""
        largest = f"largest peak {style.short_number(self.largest)} ({self.detector.unit})"
        return style.wrapped(f"{self.name}, {largest}{self.doubts}", style.LEGEND_WIDTH)

    def over_largest(self, across: str, up: str) -> tuple[pd.DataFrame, float]:
        """Return a map of the peaks divided by the largest one, and the largest one.

        The map has a column for each value of the parameter `across`, and a row for each of `up`.
        """
        peaks = self.rows.pivot_table(index=up, columns=across, values="peak")
        largest = float(np.nanmax(peaks))
        return peaks / (largest or 1.0), largest


class Request(NamedTuple):
    """Tables to draw, at least one, and how to draw them."""

    tunings: Sequence[Tuning]
    models: Sequence[str]  # the detectors to draw; none for all
    names: Sequence[str]  # a name for each table
    title: str = ""
    published: bool = False  # whether published neurons are drawn too
    raw: bool = False  # whether peaks are drawn in their unit, not over the largest one
    lplc2: str = "auto"  # the bar whose LPLC2 tuning a polar plot shows

    def curves(self) -> list[TuningCurve]:
        """Return the curves, table by table; raise ResultError if none has a detector."""
        if not any(tuning.rows["peak"].notna().any() for tuning in self.tunings):
            raise ResultError(f"{self.tunings[0].path}: column 'peak' is empty; nothing is drawn")
        for model in self.models:
            if all(tuning.of(model).empty for tuning in self.tunings):
                raise ResultError(
                    f"{self.tunings[0].path}: column 'model' never holds '{model}'; leave it out"
                )
        shown = [
            (tuning, detector_named(model), name * (len(self.tunings) > 1), rows)
            for tuning, name in zip(self.tunings, self.names, strict=True)
            for model in self.models or tuning.models
            if len(rows := tuning.of(model))
        ]
        looks = style.looks_of([detector.name for _, detector, _, _ in shown])
        return [TuningCurve(*parts, look) for parts, look in zip(shown, looks, strict=True)]

    def of_one_table(self, figure: str) -> list[TuningCurve]:
        """Return the curves in the table's order; raise ResultError if there are more tables."""
        tuning, *others = self.tunings
        if others:
            raise ResultError(f"{others[0].path}: {figure} shows one table; plot them separately")
        return sorted(self.curves(), key=lambda curve: tuning.models.index(curve.detector.name))


def averaged(tuning: Tuning) -> Tuning:
    """Return a table with the means over the seeds, if it sweeps another parameter too.

    A column holds the standard deviations of the peaks, with n - 1 in the denominator.
    """
    others = [name for name in tuning.parameters if name != "seed"]
    if not others or len(others) == len(tuning.parameters):
        return tuning
    groups = tuning.rows.groupby([*others, "model"], sort=False, dropna=False)
    means = groups.mean(numeric_only=True).drop(columns="seed")
    means[_DEVIATION] = groups["peak"].std()
    means["stimulus"] = groups["stimulus"].first()
    return replace(tuning, rows=means.reset_index(), parameters=tuple(others))


def column_of(tuning: Tuning, ending: str, wanted: str, *, count: int = 1) -> str:
    """Return the one swept column with an ending, in a table with `count` swept columns.

    Raises
    ------
    ResultError
        If not exactly one column has the ending, or the number of swept columns is another; the
        message says that the figure needs `wanted`.
    """
    columns = [name for name in tuning.parameters if name.endswith(ending)]
    if len(columns) != 1 or len(tuning.parameters) != count:
        swept = " and ".join(tuning.parameters)
        alone = "only " if columns else ""
        raise ResultError(f"{tuning.path}: sweeps '{swept}', not {alone}{wanted}")
    return columns[0]


def first_stimulus(tuning: Tuning) -> dict[str, Any]:
    """Return the protocol of a table's first stimulus from the sidecar, without damaged parts."""
    first = tuning.sidecar.get("stimulus", {}).get("first")
    types = {"display": dict, "object": list}
    items = first.items() if isinstance(first, dict) else ()
    return {key: value for key, value in items if isinstance(value, types.get(key, object))}


def described(parameter: str) -> str:
    """Return the label of an axis: ``speed (deg/s)`` for the parameter ``disk.speed_deg_s``."""
    *_, owner, leaf = ("", *parameter.split("."))
    if leaf in {"right", "up"}:  # the two numbers of a position
        return f"{leaf} (deg)"
    if leaf == "l_over_v_ms":
        return "l/v (ms)"
    if leaf == "end_deg":
        return "final size (deg)"
    unit = _units().get(leaf, "")
    ending = unit.lower().replace("1/", "per_").replace("/", "_")
    if unit and leaf.endswith(f"_{ending}"):
        return f"{leaf.removesuffix(f'_{ending}').replace('_', ' ')} ({unit})"
    return f"{owner} {leaf}".replace("_", " ").strip() + f" ({unit})" * bool(unit)


@cache
def _units() -> dict[str, str]:
    return {key.name: key.unit for key in _declared(Protocol) if key.unit}


def _declared(table: type[DeclaredTable]) -> Iterator[Parameter]:
    """Yield the keys of a table, and of the tables in this table."""
    for key in table.declared():
        yield key
        inner = (get_args(key.type) or (key.type,))[0]
        if isinstance(inner, type) and issubclass(inner, DeclaredTable):
            yield from _declared(inner)
