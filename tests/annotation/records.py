"""Records of frames made by hand."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from typing import TYPE_CHECKING

import cv2

from oppload_cli.detection.places import Detection
from oppload_cli.models.detector import Box, Response
from oppload_cli.models.registry import detector_named
from oppload_cli.palette import bgr
from oppload_cli.results.record import DetectorRecord, FrameRecord
from oppload_cli.video.frames import InputFacts

if TYPE_CHECKING:
    from collections.abc import Callable

    import pytest


def paint_of(name: str) -> tuple[int, int, int]:
    """The colour of a detector as OpenCV has it."""
    return bgr(detector_named(name).colour)


def record(
    frame: int,
    ratios: dict[str, float | None] | None = None,
    alarms: dict[str, bool] | None = None,
    detections: tuple[Detection, ...] = (),
    *,
    rate: float = 30,
    repeat: str = "",
) -> FrameRecord:
    """A frame whose responses are `ratios` times their thresholds."""
    ratios = {"opplod": 0.1, "dlgmd": 0.1} if ratios is None else ratios
    thresholds = {"opplod": 4.0, "dlgmd": 0.5}
    detectors = {}
    for name, ratio in ratios.items():
        threshold = thresholds.get(name, 1.0)
        answer = None if ratio is None else Response(ratio * threshold)
        alarm = bool(alarms and alarms.get(name))
        objects = detections if name == "opplod" else ()
        detectors[name] = DetectorRecord(answer, alarm, threshold, objects=objects)
    return FrameRecord(frame, frame / rate, 0.1, detectors, repeat=repeat)


def with_threshold(made: FrameRecord, threshold: float) -> FrameRecord:
    """The same record with another threshold of all detectors."""
    said = made.detectors.items()
    return replace(made, detectors={name: replace(one, threshold=threshold) for name, one in said})


def detection(
    box: tuple[float, float, float, float], *, alarm: bool = False, seconds: float | None = None
) -> Detection:
    """An object whose expansion is in the middle of its box."""
    x, y, width, height = box
    return Detection(3, Box(*box), x + width / 2, y + height / 2, 0.25, alarm, seconds)


def facts(width: int, height: int, frames: int | None = None) -> InputFacts:
    """An input of 30 frames/s."""
    return InputFacts("a.avi", "container", width, height, Fraction(30), frames)


def texts_of(monkeypatch: pytest.MonkeyPatch, draw: Callable[[], object]) -> list[str]:
    """The texts that a function writes into a picture, in the order of writing."""
    texts: list[str] = []
    monkeypatch.setattr(cv2, "putText", lambda *given: texts.append(given[1]))
    draw()
    return texts
