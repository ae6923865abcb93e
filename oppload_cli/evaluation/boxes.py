"""Boxes of the looming objects, beside a manifest (``docs/evaluation.md``)."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from oppload_cli.errors import ManifestError
from oppload_cli.evaluation.manifest import Manifest, RowError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from oppload_cli.detection.evaluation.series import Box

USUAL = "boxes.json"


def with_boxes(manifest: Manifest, path: Path | None = None) -> Manifest:
    """Return a manifest with the boxes of its clips.

    Parameters
    ----------
    manifest : Manifest
        The clips.
    path : Path, optional
        A JSON file ``{file: {frame: [left, top, width, height]}}`` in source pixels;
        else ``boxes.json`` beside the manifest, if it is there. Clips that are not in
        the manifest are passed over: several manifests may share the boxes.

    Returns
    -------
    Manifest
        A box that is wrong is a fault, not an error.

    Raises
    ------
    ManifestError
        If the file cannot be read, or is no such JSON.
    """
    if path is None:
        path = manifest.path.with_name(USUAL)
        if not path.is_file():
            return manifest
    content = _content(path)
    faults = list(manifest.faults)
    entries = []
    for entry in manifest.entries:
        name = entry.label.name
        boxes: dict[int, Box] = {}
        for found in _boxes(content.get(name, {})):
            if isinstance(found, RowError):
                faults.append(f"{path}: {name}: {found}")
            else:
                boxes[found[0]] = found[1]
        entries.append(replace(entry, label=replace(entry.label, boxes=boxes)))
    return replace(manifest, entries=entries, faults=faults)


def _content(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise ManifestError(f"{path}: cannot be read ({reason}); check --boxes") from error
    except (ValueError, RecursionError) as error:
        raise ManifestError(f"{path}: is not valid JSON ({error}); correct the file") from error
    if not isinstance(content, dict):
        raise ManifestError(
            f"{path}: must be an object of clips such as "
            '{"clip.mp4": {"12": [left, top, width, height]}}; correct the file'
        )
    return content


def _boxes(of_clip: object) -> Iterator[tuple[int, Box] | RowError]:
    if not isinstance(of_clip, dict):
        yield RowError("must be an object of frames; correct it")
        return
    for frame, box in of_clip.items():
        if not re.fullmatch(r"[0-9]{1,9}", frame):
            yield RowError(f"frame '{frame}' must be a whole number from 0; correct it")
        elif not _is_box(box):
            yield RowError(
                f"frame {frame}: a box must be [left, top, width, height] in pixels with a width "
                f"and height above 0, not {json.dumps(box)[:60]}"
            )
        else:
            yield int(frame), (float(box[0]), float(box[1]), float(box[2]), float(box[3]))


def _is_box(box: object) -> bool:
    return (
        isinstance(box, list)
        and len(box) == 4
        and all(isinstance(side, int | float) and not isinstance(side, bool) for side in box)
        and all(math.isfinite(side) and abs(side) < 1e9 for side in box)
        and box[2] > 0
        and box[3] > 0
    )
