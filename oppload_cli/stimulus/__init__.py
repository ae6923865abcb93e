"""Stimuli: protocols as data, their frames, their ground truth and the catalogue.

>>> from oppload_cli import stimulus
>>> protocol = stimulus.load("opplod2023/looming-disk-centre")
>>> sum(1 for frame in stimulus.frames(protocol)) == protocol.frame_count
True

Names are imported when they are first used: reading protocols needs no NumPy.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from oppload_cli.stimulus.catalogue import Entry, entries, find, load, load_all, read_entry
    from oppload_cli.stimulus.courses import Course
    from oppload_cli.stimulus.files import Written, file_stem, write
    from oppload_cli.stimulus.objects import Brightness, Growth, Motion, Object
    from oppload_cli.stimulus.protocol import Protocol, json_schema
    from oppload_cli.stimulus.protocol_tables import Camera, Display, Effects, Scene, Timing
    from oppload_cli.stimulus.renderer import Renderer, StimulusFrame, frames
    from oppload_cli.stimulus.truth import (
        FrameTruth,
        ObjectTruth,
        PictureTruth,
        frame_truth,
        ground_truth,
        read_ground_truth,
    )


__all__ = [
    "Brightness", "Camera", "Course", "Display", "Effects", "Entry", "FrameTruth", "Growth",
    "Motion", "Object", "ObjectTruth", "PictureTruth", "Protocol", "Renderer", "Scene",
    "StimulusFrame", "Timing", "Written", "entries", "file_stem", "find", "frame_truth", "frames",
    "ground_truth", "json_schema", "load", "load_all", "read_entry", "read_ground_truth", "write",
]  # fmt: skip

_MODULES = {
    "catalogue": ("Entry", "entries", "find", "load", "load_all", "read_entry"),
    "courses": ("Course",),
    "files": ("Written", "file_stem", "write"),
    "objects": ("Brightness", "Growth", "Motion", "Object"),
    "protocol": ("Protocol", "json_schema"),
    "renderer": ("Renderer", "StimulusFrame", "frames"),
    "protocol_tables": ("Camera", "Display", "Effects", "Scene", "Timing"),
    "truth": (
        *("FrameTruth", "ObjectTruth", "PictureTruth"),
        *("frame_truth", "ground_truth", "read_ground_truth"),
    ),
}
_HOMES = {name: module for module, names in _MODULES.items() for name in names}


if not TYPE_CHECKING:  # else type checkers and editors would take every name for a public one

    def __getattr__(name: str) -> Any:
        if name not in _HOMES:
            raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
        return getattr(importlib.import_module(f"{__name__}.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return list(__all__)
