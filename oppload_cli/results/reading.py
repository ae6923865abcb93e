"""Reading ``frames.csv`` and its sidecar back."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from oppload_cli.errors import ResultError
from oppload_cli.results.columns import MODELS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

WHENCE = "give a frames.csv of 'oppload run'"
SUFFIXES = (".frames.csv.part", ".frames.csv", ".csv")


@dataclass(frozen=True)
class Result:
    """One result, as read.

    Attributes
    ----------
    path : Path
        The CSV.
    frames : DataFrame
        A row per frame; empty cells are NaN.
    sidecar : dict
        Empty where there is none.
    """

    path: Path
    frames: pd.DataFrame
    sidecar: dict[str, Any] = field(default_factory=dict)

    @property
    def stem(self) -> str:
        """The result's name without its suffixes."""
        return _stem(self.path)

    @property
    def title(self) -> str:
        """The input's name, as far as it is known."""
        facts = self.sidecar.get("input")
        name = facts.get("name") if isinstance(facts, dict) else None
        return Path(name).name if isinstance(name, str) and name else self.stem

    @property
    def models(self) -> tuple[str, ...]:
        """The models whose responses it holds."""
        return tuple(name for name in MODELS if f"{name}_response" in self.frames.columns)

    def need(self, columns: Sequence[str]) -> None:
        """Check that columns are there.

        Parameters
        ----------
        columns : sequence of str
            Their names.

        Raises
        ------
        ResultError
            If one is missing; it is named.
        """
        for name in columns:
            if name not in self.frames.columns:
                raise ResultError(f"{self.path}: has no column '{name}'; {WHENCE}")


def read_result(path: Path) -> Result:
    """Read a result.

    Parameters
    ----------
    path : Path
        A ``frames.csv``, or the ``.part`` of an interrupted run, whose last row
        may be cut.

    Returns
    -------
    Result

    Raises
    ------
    ResultError
        If it cannot be read, or is not a result of ``oppload run``.
    """
    result = Result(path, read_table(path, WHENCE), _sidecar(path))
    result.need(("frame", "time_s"))
    if not result.models:
        result.need((f"{MODELS[0]}_response",))
    _check(result)
    return result


def read_table(path: Path, whence: str) -> pd.DataFrame:
    """Read a CSV whose last row may be cut.

    Parameters
    ----------
    path : Path
        The file.
    whence : str
        What the user should give instead of a wrong file, for the messages.

    Returns
    -------
    DataFrame
        At least one row; empty cells are NaN.

    Raises
    ------
    ResultError
        If it cannot be read, or is not a table.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise ResultError(f"{path}: cannot be read ({reason}); check the path") from error
    except UnicodeDecodeError as error:
        raise ResultError(f"{path}: is not a text file; {whence}") from error
    try:
        # Only an empty cell is missing; the word "nan" is a number that went wrong.
        whole = StringIO(text[: text.rfind("\n") + 1])
        table = pd.read_csv(whole, keep_default_na=False, na_values=[""])
    except (pd.errors.ParserError, pd.errors.EmptyDataError, ValueError) as error:
        reason = str(error).splitlines()[0].lower()
        raise ResultError(f"{path}: is not a CSV table ({reason}); {whence}") from error
    if table.empty:
        raise ResultError(f"{path}: holds no row; run the input again")
    return table


def check_numbers(path: Path, table: pd.DataFrame, name: str) -> NDArray[np.float64]:
    """Check that a column holds numbers only, and return them.

    Parameters
    ----------
    path : Path
        The file, for the messages.
    table : DataFrame
        As read.
    name : str
        The column.

    Returns
    -------
    ndarray
        NaN where the cell is empty.

    Raises
    ------
    ResultError
        If a cell holds anything else than a finite number; its line is named.
    """
    cells = table[name]
    values = np.asarray(pd.to_numeric(cells, errors="coerce"), float)
    bad = cells.notna().to_numpy() & ~np.isfinite(values)
    if bad.any():
        row = int(bad.argmax())
        raise ResultError(
            f"{path}: column '{name}' holds '{cells.iloc[row]}' in line {row + 2}, which is no "
            f"finite number; make the file again"
        )
    return values


def _check(result: Result) -> None:
    path, frames = result.path, result.frames
    for name in ("frame", "time_s"):
        empty = np.isnan(check_numbers(path, frames, name))
        if empty.any():
            line = int(empty.argmax()) + 2
            raise ResultError(f"{path}: column '{name}' is empty in line {line}; run it again")
    if len(frames) < 2:
        raise ResultError(
            f"{path}: column 'frame' holds one row, and a curve needs two; run a longer input"
        )
    for model in result.models:
        name = f"{model}_response"
        if np.isnan(check_numbers(path, frames, name)).all():
            raise ResultError(
                f"{path}: column '{name}' is empty in every row, as during warm-up; "
                f"run an input of more than 3 frames"
            )


def _stem(path: Path) -> str:
    for suffix in SUFFIXES:
        if path.name.endswith(suffix):
            return path.name.removesuffix(suffix)
    return path.stem


def _sidecar(path: Path) -> dict[str, Any]:
    beside = path.with_name(f"{_stem(path)}.oppload.json")
    try:
        content = json.loads(beside.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    except (OSError, ValueError, RecursionError) as error:
        raise ResultError(f"{beside}: is not a sidecar that can be read; remove it") from error
    return content if isinstance(content, dict) else {}
