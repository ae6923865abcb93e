"""Reading ``frames.csv`` and its sidecar back."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd

from oppload_cli.errors import ResultError
from oppload_cli.results.columns import MODELS

if TYPE_CHECKING:
    from collections.abc import Sequence

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
                raise ResultError(
                    f"{self.path}: has no column '{name}'; give a frames.csv of 'oppload run'"
                )


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
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise ResultError(f"{path}: cannot be read ({reason}); check the path") from error
    except UnicodeDecodeError as error:
        raise ResultError(
            f"{path}: is not a text file; give a frames.csv of 'oppload run'"
        ) from error
    result = Result(path, _parsed(path, text), _sidecar(path))
    result.need(("frame", "time_s"))
    if not result.models:
        result.need((f"{MODELS[0]}_response",))
    _check_numbers(result)
    return result


def _parsed(path: Path, text: str) -> pd.DataFrame:
    from io import StringIO  # noqa: PLC0415 - only here

    whole = text[: text.rfind("\n") + 1]
    try:
        frames = pd.read_csv(StringIO(whole))
    except (pd.errors.ParserError, pd.errors.EmptyDataError, ValueError) as error:
        raise ResultError(
            f"{path}: is not a CSV table ({str(error).splitlines()[0].lower()}); "
            f"give a frames.csv of 'oppload run'"
        ) from error
    if frames.empty:
        raise ResultError(f"{path}: holds no row; run the input again")
    return frames


def _check_numbers(result: Result) -> None:
    names = ["frame", "time_s", *(f"{name}_response" for name in result.models)]
    for name in names:
        column = result.frames[name]
        if not pd.api.types.is_numeric_dtype(column):
            raise ResultError(
                f"{result.path}: column '{name}' holds text; give a frames.csv of 'oppload run'"
            )
        if name in names[:2] and column.isna().any():
            row = int(column.isna().to_numpy().argmax()) + 2
            raise ResultError(
                f"{result.path}: column '{name}' is empty in line {row}; run it again"
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
