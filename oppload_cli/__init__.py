"""oppload: OppLoD and D-LGMD, two insect-inspired looming detectors, on video.

The names here are the public API. They are loaded when first used, so that
importing the package costs nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from oppload_cli.version import __version__

if TYPE_CHECKING:
    from oppload_cli import stimulus
    from oppload_cli.analysis import analyse
    from oppload_cli.detection.alarm import Alarm, AlarmParams
    from oppload_cli.detection.parameters import PlaceParams
    from oppload_cli.errors import OpploadError
    from oppload_cli.models.dlgmd import Dlgmd, DlgmdResponse
    from oppload_cli.models.opplod import Box, Opplod, OpplodResponse
    from oppload_cli.models.parameters import DlgmdParams, OpplodParams
    from oppload_cli.models.presets import PRESETS
    from oppload_cli.motion.parameters import RmoParams
    from oppload_cli.motion.rmo import RmoMetrics
    from oppload_cli.results.record import Detection, FrameRecord
    from oppload_cli.video.frames import Frame
    from oppload_cli.video.source import Video, open_video
    from oppload_cli.video.span import Position, Span

_HOME = {
    "Alarm": "detection.alarm",
    "AlarmParams": "detection.alarm",
    "Box": "models.opplod",
    "Detection": "results.record",
    "Dlgmd": "models.dlgmd",
    "DlgmdParams": "models.parameters",
    "DlgmdResponse": "models.dlgmd",
    "Frame": "video.frames",
    "FrameRecord": "results.record",
    "Opplod": "models.opplod",
    "OpploadError": "errors",
    "OpplodParams": "models.parameters",
    "OpplodResponse": "models.opplod",
    "PRESETS": "models.presets",
    "PlaceParams": "detection.parameters",
    "Position": "video.span",
    "RmoMetrics": "motion.rmo",
    "RmoParams": "motion.parameters",
    "Span": "video.span",
    "Video": "video.source",
    "analyse": "analysis",
    "open_video": "video.source",
}

__all__ = [
    "PRESETS",
    "Alarm",
    "AlarmParams",
    "Box",
    "Detection",
    "Dlgmd",
    "DlgmdParams",
    "DlgmdResponse",
    "Frame",
    "FrameRecord",
    "OpploadError",
    "Opplod",
    "OpplodParams",
    "OpplodResponse",
    "PlaceParams",
    "Position",
    "RmoMetrics",
    "RmoParams",
    "Span",
    "Video",
    "__version__",
    "analyse",
    "open_video",
    "stimulus",
]


def __getattr__(name: str) -> Any:
    if name == "stimulus":
        return import_module("oppload_cli.stimulus")
    if name not in _HOME:
        raise AttributeError(f"module 'oppload_cli' has no attribute '{name}'")
    return getattr(import_module(f"oppload_cli.{_HOME[name]}"), name)
