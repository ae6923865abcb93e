"""Tuning tables in memory: read, checked and written."""

from __future__ import annotations

import os.path
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from oppload_cli.errors import OutputError, ParameterError, ResultError, counted
from oppload_cli.files.atomic import write_atomic
from oppload_cli.files.reading import path_of
from oppload_cli.models.registry import known_names
from oppload_cli.results.cells import check_filled, check_numbers, need_columns, read_table
from oppload_cli.results.result_files import header_of, sidecar_of, unknown_detector
from oppload_cli.results.table import write_sidecar

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    import pandas as pd

_ANOTHER_TABLE = "give a table of 'oppload tune'"


@dataclass(frozen=True, eq=False, repr=False)
class Tuning:
    """One tuning table, from :func:`tune` or :func:`read_tuning`.

    Attributes
    ----------
    path : Path
        The CSV file; only a file name if the table was not read from files.
    rows : DataFrame
        A row per condition and detector.
    parameters : tuple of str
        The swept parameters: the columns between ``stimulus`` and ``model``.
    sidecar : dict
        The content of the sidecar; empty if there is none. `summary` in it has the numbers of each
        curve, and `doubts` the reasons why curves mean little.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> oppload.Tuning.symmetric.__doc__
    'Whether half a turn gives the same stimulus; the sidecar says so.'
    """

    path: Path
    rows: pd.DataFrame
    parameters: tuple[str, ...]
    sidecar: dict[str, Any] = field(default_factory=dict)

    def __repr__(self) -> str:
        rows, swept = counted(len(self.rows), "row"), ", ".join(self.parameters)
        parts = [repr(self.path.name), f"{rows} over {swept}: {', '.join(self.models)}"]
        if doubts := self.sidecar.get("doubts"):
            parts.append(f"{counted(len(doubts), 'doubt')}: see sidecar['doubts']")
        return f"Tuning({', '.join(parts)})"

    @property
    def models(self) -> tuple[str, ...]:
        """The detectors in the table, in the order of the registry."""
        models = set(self.rows["model"])
        return tuple(name for name in known_names() if name in models)

    @property
    def name(self) -> str:
        """The name of the stimulus, without the part that names the values of the sweep."""
        first = str(self.rows["stimulus"].iloc[0])
        return str(self.sidecar.get("stimulus", {}).get("name") or first.rpartition("/")[0])

    @property
    def direction(self) -> str | None:
        """The first swept parameter that is an axis or a direction, if there is one."""
        return direction_of(self.parameters)

    @property
    def symmetric(self) -> bool:
        """Whether half a turn gives the same stimulus; the sidecar says so."""
        return self.sidecar.get("stimulus", {}).get("symmetric") is True

    def of(self, model: str) -> pd.DataFrame:
        """Return the rows of one detector, in their order, without those that have no peak.

        A stimulus that ends during the warm-up of the detector has no peak.
        """
        given: object = model  # a caller may give a list, in spite of the type
        if not isinstance(given, str):
            raise ParameterError(f"model must be the name of one detector, not {given!r:.60}")
        chosen = (self.rows["model"] == model) & self.rows["peak"].notna()
        return self.rows[chosen].reset_index(drop=True)

    def save(self, folder: str | Path = ".", *, if_exists: str = "error") -> Path:
        """Write the table and its sidecar, as ``oppload tune`` does.

        Parameters
        ----------
        folder : str or Path
            Folder of the files, made if it does not exist.
        if_exists : str
            ``error`` or ``overwrite``.

        Returns
        -------
        Path
            The table, from which :func:`read_tuning` reads both files.

        Raises
        ------
        OutputError
            If a file exists already, or cannot be written.
        ParameterError
            If `if_exists` is another word.
        """
        if str(if_exists) not in {"error", "overwrite"}:
            raise ParameterError(f"if_exists must be error or overwrite, not {if_exists!r}")
        table = path_of(folder, "folder") / self.path.name
        sidecar = table.with_suffix(".json")
        for path in (table, sidecar):
            if if_exists == "error" and os.path.lexists(path):
                raise OutputError(
                    f"{path}: exists already; choose if_exists='overwrite', or another folder"
                )
        text = self.rows.to_csv(index=False, float_format="%.9g", lineterminator="\n")
        write_atomic(table, text)
        if self.sidecar:
            write_sidecar(sidecar, self.sidecar)
        return table


def direction_of(parameters: Iterable[str]) -> str | None:
    """Return the first dotted key that names an axis or a direction, such as ``bar.axis_deg``."""
    directions = {"axis_deg", "rotation_deg", "direction_deg"}
    return next((key for key in parameters if key.rpartition(".")[2] in directions), None)


def is_tuning(path: Path) -> bool:
    """Tell whether a CSV file has the header of a tuning table; False if it cannot be read."""
    header = header_of(path)
    return header[:1] == ["stimulus"] and "model" in header


def read_tuning(path: str | Path) -> Tuning:
    """Read a ``.tuning.csv``.

    Parameters
    ----------
    path : str or Path
        The table; its sidecar is beside it.

    Raises
    ------
    ResultError
        If the table cannot be read, a column is missing, a cell is not a number or a detector has
        no peak.

    Examples
    --------
    >>> import oppload_cli as oppload
    >>> oppload.read_tuning("missing.tuning.csv")  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    ...
    oppload_cli.errors.ResultError: missing.tuning.csv: cannot be read (no such file...
    """
    path = path_of(path, "path")
    return tuning_of(path, read_table(path, _ANOTHER_TABLE), sidecar_of(path.with_suffix(".json")))


def tuning_of(path: Path, rows: pd.DataFrame, sidecar: dict[str, Any]) -> Tuning:
    """Return a tuning table after a check; the errors are those of :func:`read_tuning`."""
    need_columns(path, rows, ("stimulus", "model", "peak"), _ANOTHER_TABLE)
    names = list(rows.columns)
    parameters = tuple(names[1 : names.index("model")])
    if not parameters:
        raise ResultError(
            f"{path}: has no column of a swept parameter before 'model'; {_ANOTHER_TABLE}"
        )
    unknown = sorted(set(map(str, rows["model"])) - set(known_names()))
    if unknown:
        raise unknown_detector(path, unknown[0])
    peaks = check_numbers(path, rows, "peak")
    if set(rows["model"]) - set(rows["model"][~np.isnan(peaks)]):  # a detector without any peak
        advice = "make the stimulus longer than the warm-up of the detector"
        check_filled(path, "peak", peaks, advice)
    return Tuning(path, rows, parameters, sidecar)
