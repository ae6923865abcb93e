"""Reading the table of ``oppload tune`` back."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from oppload_cli.errors import ResultError
from oppload_cli.results.columns import MODELS
from oppload_cli.results.directions import direction_of
from oppload_cli.results.reading import check_numbers, read_table

if TYPE_CHECKING:
    from pathlib import Path

    import pandas as pd

WHENCE = "give a table of 'oppload tune'"
NEEDED = ("stimulus", "model", "peak")


@dataclass(frozen=True)
class Tuning:
    """One tuning table, as read.

    Attributes
    ----------
    path : Path
        The CSV.
    rows : DataFrame
        A row per condition and model.
    parameters : tuple of str
        Columns of swept values, between ``stimulus`` and ``model``.
    sidecar : dict
        Empty where there is none.
    """

    path: Path
    rows: pd.DataFrame
    parameters: tuple[str, ...]
    sidecar: dict[str, Any] = field(default_factory=dict)

    @property
    def models(self) -> tuple[str, ...]:
        """The models that it holds, in the usual order."""
        held = set(self.rows["model"])
        return tuple(name for name in MODELS if name in held)

    @property
    def name(self) -> str:
        """The stimulus without the part that names a member of the sweep."""
        first = str(self.rows["stimulus"].iloc[0])
        return str(self.sidecar.get("stimulus", {}).get("name") or first.rpartition("/")[0])

    @property
    def direction(self) -> str | None:
        """The parameter that is an axis or a direction, if there is one."""
        return direction_of(self.parameters)

    @property
    def symmetric(self) -> bool:
        """Whether half a turn gives the same stimulus; the sidecar says so."""
        return self.sidecar.get("stimulus", {}).get("symmetric") is True

    def of(self, model: str) -> pd.DataFrame:
        """Return the rows of one model, in their order.

        Parameters
        ----------
        model : str
            Its name.

        Returns
        -------
        DataFrame
        """
        return self.rows[self.rows["model"] == model].reset_index(drop=True)


def is_tuning(path: Path) -> bool:
    """Tell from its header whether a CSV is a tuning table.

    Parameters
    ----------
    path : Path
        A file; one that cannot be read is none.

    Returns
    -------
    bool
    """
    try:
        with path.open(encoding="utf-8") as file:
            header = file.readline().strip().split(",")
    except (OSError, UnicodeDecodeError):
        return False
    return header[:1] == ["stimulus"] and "model" in header


def read_tuning(path: Path) -> Tuning:
    """Read a tuning table.

    Parameters
    ----------
    path : Path
        A ``.tuning.csv``.

    Returns
    -------
    Tuning

    Raises
    ------
    ResultError
        If it cannot be read, a column is missing or a cell is not a number.
    """
    rows = read_table(path, WHENCE)
    for name in NEEDED:
        if name not in rows.columns:
            raise ResultError(f"{path}: has no column '{name}'; {WHENCE}")
    names = list(rows.columns)
    parameters = tuple(names[1 : names.index("model")])
    if not parameters:
        raise ResultError(f"{path}: has no column of a swept parameter before 'model'; {WHENCE}")
    unknown = sorted(set(map(str, rows["model"])) - set(MODELS))
    if unknown:
        raise ResultError(f"{path}: column 'model' holds '{unknown[0]}'; {WHENCE}")
    _check_peaks(path, rows)
    return Tuning(path, rows, parameters, _sidecar(path))


def _check_peaks(path: Path, rows: pd.DataFrame) -> None:
    empty = np.isnan(check_numbers(path, rows, "peak"))
    if empty.any():
        raise ResultError(
            f"{path}: column 'peak' is empty in line {int(empty.argmax()) + 2}; "
            f"make the stimulus longer than the warm-up of 4 frames"
        )


def _sidecar(path: Path) -> dict[str, Any]:
    beside = path.with_suffix(".json")
    try:
        content = json.loads(beside.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    except (OSError, ValueError) as error:
        raise ResultError(f"{beside}: is not a sidecar that can be read; remove it") from error
    return content if isinstance(content, dict) else {}
