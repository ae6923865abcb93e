"""Reads results, and finds the video and the thresholds of a result."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from oppload_cli.errors import ResultError, SourceError, counted
from oppload_cli.files.atomic import PART, part_of
from oppload_cli.files.reading import is_file, is_folder, is_there, reading, text_of
from oppload_cli.models.detector import Box
from oppload_cli.models.registry import default_names, detector_named, known_names
from oppload_cli.results.cells import (
    ANOTHER_RESULT,
    LARGEST,
    check_frames,
    check_numbers,
    need_columns,
    read_table,
)
from oppload_cli.results.table import (
    DETECTIONS,
    SCHEMA,
    SIDECAR,
    TABLE,
    columns_for,
)
from oppload_cli.video.inputs import NUMBER, is_camera

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    Series = NDArray[np.float64]  # a value for each row of a table


# The types of parts of a sidecar; a part of another type, as in a damaged file, is left out.
_TYPES: dict[str, type] = {
    **dict.fromkeys(("input", "working", "decode", "tool", "parameters", "alarms"), dict),
    **dict.fromkeys(("stimulus", "figure", "changed"), dict),
    **dict.fromkeys(("command", "remarks", "doubts"), list),
}


@dataclass(frozen=True, eq=False)
class BaseResult:
    """The table and the sidecar of one input; :class:`oppload_cli.Result` also has detections."""

    path: Path  # of the table
    frames: pd.DataFrame  # a row per frame; empty cells are NaN
    sidecar: dict[str, Any] = field(default_factory=dict)  # empty if there is none

    @property
    def stem(self) -> str:
        """The result's name without its suffixes."""
        return stem_of(self.path)

    @property
    def title(self) -> str:
        """The input's name from the sidecar, or else the result's name."""
        name = self.part("input").get("name")
        return Path(name).name if isinstance(name, str) and name else self.stem

    @property
    def models(self) -> tuple[str, ...]:
        """The detectors whose responses the table has."""
        return tuple(name for name in known_names() if f"{name}_response" in self.frames.columns)

    def part(self, name: str) -> dict[str, Any]:
        """Return a part of the sidecar, such as ``input``; empty if there is no such part."""
        part: dict[str, Any] = self.sidecar.get(name) or {}
        return part

    @property
    def shortfall(self) -> str:
        """A sentence if the table has fewer rows than the run wrote, else an empty text."""
        written = self.part("decode").get("analysed")
        if not isinstance(written, int) or self.path.name.endswith(PART):
            return ""
        lost = written - len(self.frames)
        return f"the table lacks {lost} of the run's {written} rows; run it again" * (lost > 0)

    def need(self, columns: Sequence[str]) -> None:
        """Raise a ResultError that names the first missing column, if one is missing."""
        models = ", ".join(self.models)
        other = (
            f"its detectors are {models}; choose among them, or run the input again with this one"
        )
        for name in columns:
            of_detector = models and name.endswith("_response")
            need_columns(self.path, self.frames, [name], other if of_detector else ANOTHER_RESULT)

    def need_responses(self, models: Sequence[str]) -> None:
        """Raise a ResultError if there is one frame, or if a detector responded to no frame."""
        if len(self.frames) < 2:
            raise ResultError(
                f"{self.path}: column 'frame' holds one row, and a curve needs two; run a longer "
                "input"
            )
        for model in models:
            name = f"{model}_response"
            if np.isnan(self.frames[name].to_numpy(float)).all():
                raise ResultError(
                    f"{self.path}: column '{name}' is empty in every row, as during warm-up; "
                    f"run an input that lasts longer than the warm-up of '{model}', "
                    f"{counted(detector_named(model).warm_up, 'interval')}"
                )


def read_result(path: Path, needed: Sequence[str] = ("",)) -> BaseResult:
    """Read a result.

    Parameters
    ----------
    path : Path
        A ``frames.csv``, or the part file of an interrupted run, whose last row may be cut.
    needed : sequence of str
        Ends of the names of columns to read, in addition to ``frame``, ``time_s`` and the
        responses, because a table of many hours is large. By default all columns are read.

    Raises
    ------
    ResultError
        If the result cannot be read, or is not a result of ``oppload run``.
    """
    ends = ("frame", "time_s", "_response", *needed)
    frames = read_table(path, ANOTHER_RESULT, lambda name: name.endswith(ends))
    result = BaseResult(path, frames, sidecar_of(beside(path)))
    result.need(("frame", "time_s"))
    if not result.models:
        check_schema(result)
        check_detectors(result.path, result.sidecar)  # the error names an unknown detector
        result.need((f"{default_names()[0]}_response",))
    known = {column.name for column in columns_for(result.models, rmo=True, details=True)}
    check_frames(path, frames, known.intersection(frames.columns))
    return result


def read_detections(table: Path) -> list[dict[str, Any]] | None:
    """Read the ``detections.jsonl`` of a result.

    Parameters
    ----------
    table : Path
        The ``frames.csv``, or the part file of an interrupted run.

    Returns
    -------
    list of dict or None
        The detections with the keys of ``docs/formats.md``, without a last line that was cut; None
        if the file does not exist.

    Raises
    ------
    ResultError
        If the file cannot be read, or a line is not a detection.
    """
    path = beside(table, DETECTIONS)
    path = part_of(path) if table.name.endswith(PART) else path
    if not is_there(path):
        return None
    detections = []
    with reading(path, ResultError, form="JSON Lines", repair="run the input again"):
        for line in text_of(path).split("\n")[:-1]:
            detections.append(json.loads(line))
            if not _is_detection(detections[-1]):
                raise ValueError(f"not a detection: {line[:40]}")
    return detections


def _is_detection(content: Any) -> bool:
    if not isinstance(content, dict):
        return False
    required = [content.get(key) for key in ("frame", *Box._fields)]
    return None not in required and all(
        value is None or (isinstance(value, int | float) and abs(value) <= LARGEST)  # not NaN
        for value in content.values()
    )


def title_and_input(table: Path) -> tuple[str, str]:
    """Return a result's title, and the name of its input in the sidecar, or else its stem.

    The function reads only the sidecar. It raises no error.
    """
    try:
        sidecar = sidecar_of(beside(table))
    except ResultError:  # the error comes again when the result is read
        sidecar = {}
    result = BaseResult(table, pd.DataFrame(), sidecar)
    return result.title, str(result.part("input").get("name") or result.stem)


def stem_of(path: Path) -> str:
    """Return the name of a result without the suffixes of its table."""
    suffixes = (f"{TABLE}{PART}", TABLE, ".csv")
    suffix = next((suffix for suffix in suffixes if path.name.endswith(suffix)), path.suffix)
    return path.name.removesuffix(suffix)


def beside(table: Path, suffix: str = SIDECAR) -> Path:
    """Return the path of the sidecar, or of another file, that belongs to a table."""
    return table.with_name(stem_of(table) + suffix)


def is_collected(path: Path) -> bool:
    """Tell whether a CSV file has the header of a table of several results, as of ``collect``.

    False if it cannot be read.
    """
    return header_of(path)[:1] == ["result"]


def header_of(path: Path) -> list[str]:
    """Return the names of the columns of a CSV file; none if it cannot be read.

    A pipe has none: what is read of it here would be missing later.
    """
    if not is_file(path):
        return []
    try:
        with path.open(encoding="utf-8-sig") as file:
            return file.readline().strip().split(",")
    except (OSError, UnicodeDecodeError):
        return []


def sidecar_of(path: Path) -> dict[str, Any]:
    """Return the content of a sidecar without the parts of a wrong type; empty if there is none.

    Raises ResultError if it cannot be read.
    """
    try:
        content = json.loads(text_of(path))
    except FileNotFoundError:
        return {}
    except (OSError, ValueError, RecursionError) as error:
        raise ResultError(f"{path}: is not a sidecar that can be read; remove it") from error
    if not isinstance(content, dict):
        return {}
    parts = content.items()
    return {name: part for name, part in parts if isinstance(part, _TYPES.get(name, object))}


def find_video(result: BaseResult, moved: Path | None = None) -> str:
    """Return the name of the video or of the images from which a result was made.

    Parameters
    ----------
    result : BaseResult
        Its sidecar has the path of the input from the folder in which the run was started. The
        function looks for this path from the current folder and beside the result.
    moved : Path, optional
        Where the input is now, or a folder that holds it, maybe in some of the folders of its
        path. An input that the folder lacks is sought as without `moved`.

    Raises
    ------
    SourceError
        If the input is not found, is not known, or was a camera or a stream.
    """
    facts = result.part("input")
    name, kind = facts.get("name"), facts.get("kind")
    if moved is not None and not (is_folder(moved) and isinstance(name, str)):
        return str(moved)
    if not isinstance(name, str) or not name:
        raise SourceError(
            "no sidecar names the video of this result; name it with --video (in Python video=PATH)"
        )
    if kind not in ("container", "images"):
        raise SourceError(f"{name}: frames of a camera or a stream are not kept")
    path = Path(name)
    folder = result.path.parent
    candidates = [path, folder / path, folder / path.name]
    if moved:
        parts = [part for part in path.parts if part not in {path.anchor, ".."}]
        # Of many results the videos of some may still be where they were.
        candidates = [*(Path(moved, *parts[at:]) for at in range(len(parts) + 1)), *candidates]
    for candidate in candidates:
        folder = candidate.parent if NUMBER.search(candidate.name) else candidate
        if is_file(candidate) or (kind == "images" and (is_folder(candidate) or is_folder(folder))):
            return f"./{candidate}" if is_camera(str(candidate)) else str(candidate)
    where = f" below {moved}" if moved else ""
    raise SourceError(
        f"{name}: is not found{where}; say where it is with --video (in Python video=PATH)"
    )


def known_threshold(result: BaseResult, name: str) -> Series | None:
    """Return the threshold of a detector's alarm in each frame of a result.

    Parameters
    ----------
    result : BaseResult
        The result.
    name : str
        Name of the detector.

    Returns
    -------
    ndarray, shape (n,), or None
        The threshold as ``docs/alarms.md`` defines it; NaN where it is 0. None if the detector has
        no alarm, or the result is of a version before 1.0, which wrote no thresholds.
    """
    column = f"{name}_threshold"
    if column not in result.frames.columns:
        return None
    threshold = check_numbers(result.path, result.frames, column)
    known = np.isfinite(threshold) & (threshold > 0)
    return np.where(known, threshold, np.nan) if known.any() else None


def alarm_rows(result: BaseResult, name: str) -> list[tuple[int, int]]:
    """Return the first row of each alarm of a detector, and the row after its last one."""
    column = f"{name}_alarm"
    if column not in result.frames.columns:
        return []
    on = check_numbers(result.path, result.frames, column) == 1
    edges = np.flatnonzero(np.diff(np.concatenate(([False], on, [False])).astype(int)))
    return [(first, stop) for first, stop in edges.reshape(-1, 2).tolist()]


def frame_ends(times: Series) -> Series:
    """Return the time at which each frame ends, from the presentation times of all frames.

    A frame lasts until the next one, but at most two median steps, as frames may be missing. The
    last frame lasts for a median step, and the only frame of a result for no time.
    """
    steps = np.diff(times)
    usual = np.median(steps) if steps.size else 0.0
    return np.asarray(times + np.append(np.minimum(steps, 2 * usual), usual), np.float64)


def check_schema(result: BaseResult) -> None:
    """Raise a ResultError if the sidecar of a result has another schema than `SCHEMA`."""
    schema = result.sidecar.get("schema", SCHEMA)
    if schema != SCHEMA:
        raise ResultError(
            f"{result.path}: its sidecar is of schema {schema}, not {SCHEMA}; run the input "
            "again, or remove the sidecar to read the table alone"
        )


def check_detectors(path: Path, sidecar: Mapping[str, Any]) -> None:
    """Raise a ResultError if the sidecar of a result names a detector that is not known here."""
    models = sidecar.get("models")
    for name in models if isinstance(models, list) else ():
        if name not in known_names():
            raise unknown_detector(path, name)


def unknown_detector(path: Path, name: str) -> ResultError:
    """Return the error of a result of a detector that the registry does not know."""
    return ResultError(
        f"{path}: its detector '{name}' is not known here; load it, as in "
        "'oppload --load FILE.py ...', or register its class"
    )
