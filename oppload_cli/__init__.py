"""oppload: OppLoD and D-LGMD, two insect-inspired looming detectors, on video.

The names here are the public API. They are loaded when first used, so that
importing the package costs nothing.

>>> import oppload_cli as oppload
>>> result = oppload.run("controls/looming-perspective", rmo=False)
>>> result.summary["opplod"]["first_alarm_time_s"] < result.sidecar["stimulus"]["contact_time_s"]
True
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from oppload_cli.version import __version__

if TYPE_CHECKING:
    from oppload_cli import stimulus
    from oppload_cli.api import Result, read_result, run
    from oppload_cli.detection.alarm import Alarm
    from oppload_cli.detection.parameters import AlarmParams, PlaceParams, alarm_params
    from oppload_cli.detection.places import Detection
    from oppload_cli.errors import OpploadError
    from oppload_cli.models.bank import DetectorBank
    from oppload_cli.models.detector import Box, Column, Detector, Response, UnitMaps
    from oppload_cli.models.dlgmd import Dlgmd, DlgmdParams, DlgmdResponse
    from oppload_cli.models.dpc import Layers
    from oppload_cli.models.flow_divergence import FlowDivergence, FlowDivergenceParams
    from oppload_cli.models.frame_difference import FrameDifference, FrameDifferenceParams
    from oppload_cli.models.opplod import Opplod, OpplodResponse
    from oppload_cli.models.opplod_parameters import OpplodParams
    from oppload_cli.models.presets import PRESETS
    from oppload_cli.models.registry import detectors, parameters_of, register
    from oppload_cli.motion.rmo import RmoMetrics, RmoParams
    from oppload_cli.pipeline.analysis import analyse
    from oppload_cli.pipeline.sources import open_source
    from oppload_cli.plots.curves import plot_curves
    from oppload_cli.plots.places import plot_places
    from oppload_cli.plots.rmo import plot_rmo
    from oppload_cli.plots.tuning import plot_tuning
    from oppload_cli.results.reading import Tuning, read_tuning
    from oppload_cli.results.table import FrameRecord
    from oppload_cli.video.frames import Frame
    from oppload_cli.video.source import Video, open_video
    from oppload_cli.video.span import Position, Span


_HOME = {
    "Alarm": "detection.alarm",
    "AlarmParams": "detection.parameters",
    "Box": "models.detector",
    "Column": "models.detector",
    "Detection": "detection.places",
    "Detector": "models.detector",
    "DetectorBank": "models.bank",
    "Dlgmd": "models.dlgmd",
    "DlgmdParams": "models.dlgmd",
    "DlgmdResponse": "models.dlgmd",
    "FlowDivergence": "models.flow_divergence",
    "FlowDivergenceParams": "models.flow_divergence",
    "Frame": "video.frames",
    "FrameDifference": "models.frame_difference",
    "FrameDifferenceParams": "models.frame_difference",
    "FrameRecord": "results.table",
    "Layers": "models.dpc",
    "OpploadError": "errors",
    "Opplod": "models.opplod",
    "OpplodParams": "models.opplod_parameters",
    "OpplodResponse": "models.opplod",
    "PRESETS": "models.presets",
    "PlaceParams": "detection.parameters",
    "Position": "video.span",
    "Response": "models.detector",
    "Result": "api",
    "RmoMetrics": "motion.rmo",
    "RmoParams": "motion.rmo",
    "Span": "video.span",
    "Tuning": "results.reading",
    "UnitMaps": "models.detector",
    "Video": "video.source",
    "alarm_params": "detection.parameters",
    "analyse": "pipeline.analysis",
    "detectors": "models.registry",
    "open_source": "pipeline.sources",
    "open_video": "video.source",
    "parameters_of": "models.registry",
    "plot_curves": "plots.curves",
    "plot_places": "plots.places",
    "plot_rmo": "plots.rmo",
    "plot_tuning": "plots.tuning",
    "read_result": "api",
    "read_tuning": "results.reading",
    "register": "models.registry",
    "run": "api",
}

__all__ = [
    "PRESETS",
    "Alarm",
    "AlarmParams",
    "Box",
    "Column",
    "Detection",
    "Detector",
    "DetectorBank",
    "Dlgmd",
    "DlgmdParams",
    "DlgmdResponse",
    "FlowDivergence",
    "FlowDivergenceParams",
    "Frame",
    "FrameDifference",
    "FrameDifferenceParams",
    "FrameRecord",
    "Layers",
    "OpploadError",
    "Opplod",
    "OpplodParams",
    "OpplodResponse",
    "PlaceParams",
    "Position",
    "Response",
    "Result",
    "RmoMetrics",
    "RmoParams",
    "Span",
    "Tuning",
    "UnitMaps",
    "Video",
    "__version__",
    "alarm_params",
    "analyse",
    "detectors",
    "open_source",
    "open_video",
    "parameters_of",
    "plot_curves",
    "plot_places",
    "plot_rmo",
    "plot_tuning",
    "read_result",
    "read_tuning",
    "register",
    "run",
    "stimulus",
]


def __dir__() -> list[str]:
    return list(__all__)


def __getattr__(name: str) -> Any:
    if name == "stimulus":
        return import_module("oppload_cli.stimulus")
    if name not in _HOME:
        raise AttributeError(f"module 'oppload_cli' has no attribute '{name}'")
    return getattr(import_module(f"oppload_cli.{_HOME[name]}"), name)
