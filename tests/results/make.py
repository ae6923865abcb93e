"""Result and tuning tables made by hand."""

from __future__ import annotations

import csv
import json
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

HEADER = (
    "frame,time_s,luma_change,opplod_response,opplod_threshold,opplod_alarm,opplod_x,opplod_y,"
    "opplod_width,opplod_height,opplod_unit_x,opplod_unit_y,dlgmd_response,dlgmd_threshold,"
    "dlgmd_alarm,dlgmd_s,flow_vectors,rom_pairs,rom_share,rmo_mean,rmo_max,rmo_index"
)
COLUMNS = HEADER.split(",")


def rows_of(table: Path) -> list[dict[str, str]]:
    with table.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def frame_rows(frames: int = 40, peak: int = 30) -> list[dict[str, str]]:
    """Rows as `oppload run` writes them; OppLoD peaks at `peak`, D-LGMD at the end."""
    rows = []
    for frame in range(frames):
        opplod = float(np.exp(-(((frame - peak) / 4) ** 2)))
        row: dict[str, Any] = dict.fromkeys(COLUMNS, "")
        row |= {"frame": frame, "time_s": f"{frame / 20:.9g}", "opplod_alarm": 0, "dlgmd_alarm": 0}
        row |= {"opplod_threshold": 0.25, "dlgmd_threshold": 1.0}
        if frame:
            row |= {"luma_change": 0.01, "flow_vectors": 9, "rom_pairs": 4, "rom_share": 0.1}
            row |= {"rmo_mean": 0.8, "rmo_max": 0.9, "rmo_index": 0.5}
        if frame >= 3:
            row |= {"opplod_response": f"{opplod:.9g}", "opplod_alarm": int(opplod > 0.5)}
            row |= {"opplod_x": 10, "opplod_y": 20, "opplod_width": 40, "opplod_height": 40}
            row |= {"opplod_unit_x": 30, "opplod_unit_y": 40}
            row |= {"dlgmd_response": f"{frame / 1000:.9g}", "dlgmd_alarm": 0, "dlgmd_s": 0.1}
        rows.append({name: str(value) for name, value in row.items()})
    return rows


def write_rows(path: Path, rows: list[dict[str, str]]) -> Path:
    """Write rows with the header of the first."""
    names = list(rows[0])
    lines = [",".join(names), *(",".join(row[name] for name in names) for row in rows)]
    path.write_text("\n".join(lines) + "\n")
    return path


def write_result(path: Path, frames: int = 40, peak: int = 30) -> Path:
    """Write a frames.csv without a sidecar."""
    return write_rows(path, frame_rows(frames, peak))


def write_tuning(
    path: Path,
    values: Mapping[str, Sequence[float | str]],
    peaks: dict[str, list[float]],
    *,
    symmetric: bool = False,
    name: str = "klapoetke2017/bar-expand-10",
    **sidecar: object,
) -> Path:
    """Write a tuning.csv with one value per condition and parameter, and its sidecar."""
    rows = []
    for index in range(len(next(iter(values.values())))):
        condition = {
            key: cell if isinstance(cell := column[index], str) else f"{cell:g}"
            for key, column in values.items()
        }
        for model, column in peaks.items():
            peak = f"{column[index]:.9g}".replace("nan", "")
            rows.append(
                {"stimulus": f"{name}/{index}", **condition}
                | {"model": model, "peak": peak, "mean": "0.1"}
            )
    content = {"stimulus": {"name": name, "symmetric": symmetric}} | sidecar
    path.with_suffix(".json").write_text(json.dumps(content))
    return write_rows(path, rows)
