"""A result whose frames carry their number as a picture, at irregular times."""

from __future__ import annotations

import json
from fractions import Fraction
from itertools import accumulate
from typing import TYPE_CHECKING, Any

import numpy as np

from oppload_cli.results.table import SCHEMA
from oppload_cli.version import __version__
from tests.media import write_video
from tests.results.make import write_rows

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

FRAMES, BITS = 20, 5
WIDTH, HEIGHT = 160, 96
TIMES_MS = list(accumulate([33, 40, 7, 110, 33, 21, 8, 8, 60, 33] * 2, initial=0))[:FRAMES]
FIRST, LAST = 4, 17  # frames of the result: as of a run with --start and --end
BOX = (1, 40, 24, 80, 48, 80, 48, 0.5, True)  # of frames 8 to 10
ALARMS = ((8, 10), (14, 15))  # of opplod


def numbered_picture(frame: int) -> NDArray[np.uint8]:
    """Upright stripes, the first white; the others are the binary digits of the number."""
    stripes = [255, *(255 * (frame >> bit & 1) for bit in range(BITS))]
    return np.repeat(np.repeat([stripes], HEIGHT, 0), WIDTH // (BITS + 1) + 1, 1)[:, :WIDTH].astype(
        np.uint8
    )


def number_of(row: list[int] | NDArray[Any]) -> int:
    """Read the number from a row of pixels."""
    wide = WIDTH // (BITS + 1) + 1
    scale = len(row) / WIDTH
    return sum(
        (int(row[int((wide * (bit + 1.5)) * scale)]) > 128) << bit
        for bit in range(BITS)
        if wide * (bit + 1.5) < WIDTH
    )


def write_clip(path: Path, **coding: Any) -> Path:
    """Write the video, lossless if nothing else is asked for, with its times in milliseconds."""
    pictures = [numbered_picture(frame) for frame in range(FRAMES)]
    how: dict[str, Any] = {
        "codec": "ffv1",
        "times": TIMES_MS,
        "time_base": Fraction(1, 1000),
    } | coding
    return write_video(path, pictures, **how)


def write_numbered_result(folder: Path, stem: str = "clip", video: str | None = None) -> Path:
    """Write a video, its table, its detections and its sidecar; return the table."""
    clip = folder / (video or f"{stem}.mkv")
    write_clip(clip)
    rows = []
    for frame in range(FIRST, LAST + 1):
        alarm = any(first <= frame <= last for first, last in ALARMS)
        row = {
            "frame": frame, "time_s": f"{TIMES_MS[frame] / 1000:.9g}", "luma_change": 0.1,
            "opplod_response": 0.5 if alarm else 0.002, "opplod_threshold": 0.05,
            "opplod_alarm": int(alarm),
            "opplod_x": 10, "opplod_y": 20, "opplod_width": 40, "opplod_height": 30,
            "dlgmd_response": "" if frame == FIRST else 0.001 * frame,
            "dlgmd_threshold": 0.1, "dlgmd_alarm": 0, "dlgmd_s": 0.1,
            "rmo_mean": 0.5, "rmo_index": 0.25,
        }  # fmt: skip
        rows.append({name: str(value) for name, value in row.items()})
    table = write_rows(folder / f"{stem}.frames.csv", rows)
    keys = "frame time_s id x y width height centre_x centre_y response alarm time_to_contact_s"
    lines = [
        dict(zip(keys.split(), (frame, TIMES_MS[frame] / 1000, *BOX, contact), strict=True))
        for frame, contact in ((8, None), (9, 0.5), (10, None))
    ]
    text = "".join(json.dumps(line) + "\n" for line in lines)
    (folder / f"{stem}.detections.jsonl").write_text(text)
    write_sidecar(table, sidecar_of(clip))
    return table


def sidecar_of(clip: Path) -> dict[str, Any]:
    """What `oppload run` says of the clip, as far as a page uses it."""
    return {
        "schema": SCHEMA,
        "tool": {"oppload": __version__},
        "command": ["oppload", "run", clip.name],
        "models": ["opplod", "dlgmd"],
        "parameters": {"alarm": {"factor": 0.0, "opplod_floor": 0.05, "dlgmd_floor": 0.1}},
        "input": {
            "name": str(clip),
            "kind": "container",
            "width": WIDTH,
            "height": HEIGHT,
            "bytes": clip.stat().st_size,
        },
        "decode": {"complete": True, "messages": []},
    }


def write_sidecar(table: Path, content: dict[str, Any]) -> None:
    """Write the sidecar beside a table."""
    name = table.name.replace(".frames.csv", ".oppload.json")
    table.with_name(name).write_text(json.dumps(content))
