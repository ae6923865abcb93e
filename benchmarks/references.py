"""The programs and functions with which the benchmarks compare the speed of oppload."""

from __future__ import annotations

import resource
import shutil
import subprocess
import sys
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from benchmarks import decoding
from tests import reference

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    Luma = NDArray[np.float32]


def decode_command(path: Path) -> list[str]:
    """Return the command of bare decoding."""
    return [sys.executable, str(Path(decoding.__file__)), str(path)]


def dis(frames: Sequence[Luma]) -> float:
    """Run DIS optical flow (ultrafast) with divergence over frames."""
    search = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_ULTRAFAST)
    return _expansion(frames, search.calc)


def farneback(frames: Sequence[Luma]) -> float:
    """Run Farneback optical flow with divergence over frames."""

    def flow_of(before: NDArray[np.uint8], now: NDArray[np.uint8], flow: Luma) -> NDArray[Any]:
        return cv2.calcOpticalFlowFarneback(before, now, flow, 0.5, 3, 15, 3, 5, 1.2, 0)

    return _expansion(frames, flow_of)


def _expansion(frames: Sequence[Luma], flow_of: Callable[..., NDArray[Any]]) -> float:
    """Return the sum of the mean divergence of optical flow, a common measure of expansion."""
    total = 0.0
    greys = [cv2.convertScaleAbs(luma, alpha=255) for luma in frames]
    for before, now in pairwise(greys):
        flow = flow_of(before, now, np.zeros((*now.shape, 2), np.float32))
        across = cv2.Sobel(flow[..., 0], cv2.CV_32F, 1, 0, ksize=3)
        down = cv2.Sobel(flow[..., 1], cv2.CV_32F, 0, 1, ksize=3)
        total += cv2.mean(across)[0] + cv2.mean(down)[0]
    return total


def literal(frames: Sequence[Luma], *, paper: bool) -> float:
    """Run both models by the literal reference of the tests, from the fourth frame on.

    The opponent sums of `opplod_reference` are left out, because the literal reference computes
    them by loops in Python. So the literal reference seems faster than it is.
    """
    total = 0.0
    for t in range(3, len(frames)):
        p = reference.photoreceptors(frames[t - 3 : t + 1])
        s = np.maximum(0, reference.excitation(p) - reference.inhibition(p))
        total += float(s.mean())
        if paper:
            total += reference.paper_response(p, field=200, grid=(5, 5), threshold=0, gain=1)
        else:
            cell = frames[0].shape[0] // 30
            for phi in (45, 135, 225, 315):
                total += float(reference.pooled(reference.pathway(p, phi), cell, 1.5).max())
    return total


def scenedetect_command(path: Path) -> list[str] | None:
    """Return PySceneDetect's command for a file, or None if it is not installed."""
    beside = Path(sys.executable).with_name("scenedetect")
    command = str(beside) if beside.exists() else shutil.which("scenedetect")
    if command is None:
        return None
    words = ("-q", "-i", str(path), "-o", str(path.with_name("out")))
    return [command, *words, "detect-content", "list-scenes", "-q"]


def run(command: list[str]) -> None:
    """Run a command to its end, and discard its output."""
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def processor_s(command: list[str]) -> float:
    """Run a command to its end; return its processor time and that of its processes, in seconds."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    run(command)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
