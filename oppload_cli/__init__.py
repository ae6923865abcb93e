"""oppload: OppLoD, D-LGMD and other looming detectors, for videos and cameras.

The names here are the public API. Each is loaded when it is first used, so that importing the
package takes no time.

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
    from oppload_cli.api import Result, read_result, run, tune
    from oppload_cli.detection.alarm import Alarm, AlarmParams, alarm_params
    from oppload_cli.detection.contact import PlaceParams
    from oppload_cli.detection.places import Detection
    from oppload_cli.errors import OpploadError
    from oppload_cli.frame_times import ticks
    from oppload_cli.models.bank import DetectorBank
    from oppload_cli.models.detector import AlarmRule, Box, Column, Detector, Response, UnitMaps
    from oppload_cli.models.dlgmd import Dlgmd, DlgmdParams, DlgmdResponse
    from oppload_cli.models.flow_divergence import FlowDivergence, FlowDivergenceParams
    from oppload_cli.models.frame_difference import FrameDifference, FrameDifferenceParams
    from oppload_cli.models.layers import Layers
    from oppload_cli.models.opplod import Opplod, OpplodParams, OpplodResponse
    from oppload_cli.models.opplod_lplc2 import (
        OpplodLplc2,
        OpplodLplc2Params,
        OpplodLplc2Response,
    )
    from oppload_cli.models.opplod_paper import (
        OpplodPaper,
        OpplodPaperParams,
        OpplodPaperResponse,
    )
    from oppload_cli.models.opplod_reference import (
        OpplodReference,
        OpplodReferenceParams,
        OpplodReferenceResponse,
    )
    from oppload_cli.models.registry import detectors, forget, parameters_of, register
    from oppload_cli.motion.rmo import RmoMetrics, RmoParams
    from oppload_cli.pipeline.analysis import Analysis, analyse
    from oppload_cli.pipeline.sources import open_source
    from oppload_cli.plots.curves import plot_curves
    from oppload_cli.plots.place_map import plot_places
    from oppload_cli.plots.rmo_curves import plot_rmo
    from oppload_cli.plots.tuning_plots import plot_tuning
    from oppload_cli.results.record import DetectorRecord, FrameRecord
    from oppload_cli.results.tuning import Tuning, read_tuning
    from oppload_cli.schema import Parameters, parameter
    from oppload_cli.video.frames import Frame
    from oppload_cli.video.source import Video, open_video
    from oppload_cli.video.span import Position, Span


__all__ = [
    "Alarm", "AlarmParams", "AlarmRule", "Analysis", "Box", "Column", "Detection", "Detector",
    "DetectorBank", "DetectorRecord", "Dlgmd", "DlgmdParams", "DlgmdResponse", "FlowDivergence",
    "FlowDivergenceParams", "Frame", "FrameDifference", "FrameDifferenceParams", "FrameRecord",
    "Layers", "OpploadError", "Opplod", "OpplodLplc2", "OpplodLplc2Params", "OpplodLplc2Response",
    "OpplodPaper", "OpplodPaperParams", "OpplodPaperResponse", "OpplodParams", "OpplodReference",
    "OpplodReferenceParams", "OpplodReferenceResponse", "OpplodResponse", "Parameters",
    "PlaceParams", "Position", "Response", "Result", "RmoMetrics", "RmoParams", "Span", "Tuning",
    "UnitMaps", "Video", "__version__", "alarm_params", "analyse", "detectors", "forget",
    "open_source", "open_video", "parameter", "parameters_of", "plot_curves", "plot_places",
    "plot_rmo", "plot_tuning", "read_result", "read_tuning", "register", "run", "stimulus", "ticks",
    "tune",
]  # fmt: skip

_MODULES = {
    "api": ("Result", "read_result", "run", "tune"),
    "detection.alarm": ("Alarm", "AlarmParams", "alarm_params"),
    "detection.contact": ("PlaceParams",),
    "detection.places": ("Detection",),
    "errors": ("OpploadError",),
    "frame_times": ("ticks",),
    "models.bank": ("DetectorBank",),
    "models.detector": ("AlarmRule", "Box", "Column", "Detector", "Response", "UnitMaps"),
    "models.dlgmd": ("Dlgmd", "DlgmdParams", "DlgmdResponse"),
    "models.layers": ("Layers",),
    "models.flow_divergence": ("FlowDivergence", "FlowDivergenceParams"),
    "models.frame_difference": ("FrameDifference", "FrameDifferenceParams"),
    "models.opplod": ("Opplod", "OpplodParams", "OpplodResponse"),
    "models.opplod_lplc2": ("OpplodLplc2", "OpplodLplc2Params", "OpplodLplc2Response"),
    "models.opplod_paper": ("OpplodPaper", "OpplodPaperParams", "OpplodPaperResponse"),
    "models.opplod_reference": (
        "OpplodReference",
        "OpplodReferenceParams",
        "OpplodReferenceResponse",
    ),
    "models.registry": ("detectors", "forget", "parameters_of", "register"),
    "motion.rmo": ("RmoMetrics", "RmoParams"),
    "pipeline.analysis": ("Analysis", "analyse"),
    "pipeline.sources": ("open_source",),
    "plots.curves": ("plot_curves",),
    "plots.place_map": ("plot_places",),
    "plots.rmo_curves": ("plot_rmo",),
    "plots.tuning_plots": ("plot_tuning",),
    "results.record": ("DetectorRecord", "FrameRecord"),
    "results.tuning": ("Tuning", "read_tuning"),
    "schema": ("Parameters", "parameter"),
    "video.frames": ("Frame",),
    "video.source": ("Video", "open_video"),
    "video.span": ("Position", "Span"),
}
_HOMES = {name: module for module, names in _MODULES.items() for name in names}


def __dir__() -> list[str]:
    return list(__all__)


if not TYPE_CHECKING:  # else type checkers and editors would take every name for a public one

    def __getattr__(name: str) -> Any:
        if name == "stimulus":
            return import_module("oppload_cli.stimulus")
        if name not in _HOMES:
            raise AttributeError(f"module 'oppload_cli' has no attribute '{name}'")
        return getattr(import_module(f"oppload_cli.{_HOMES[name]}"), name)
