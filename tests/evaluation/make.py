"""Clips whose responses are made by hand."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from oppload_cli.evaluation.metrics.clips import Clip, Label, Output
from oppload_cli.models.detector import Box

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

NAME = "opplod"
WARM_UP = 3


def clip(
    response: Sequence[float],
    onset: int | None = None,
    contact: int | None = None,
    *,
    rate: float = 10,
    motion: str = "",
    boxes: Mapping[int, tuple[float, float, float, float]] | None = None,
    alarm: Sequence[int] = (),
    winner: Sequence[Sequence[float]] | None = None,
) -> Clip:
    """A clip of 400 x 200 px; its first three responses are warm-up."""
    values = np.array(response, float)
    values[:WARM_UP] = np.nan
    on = np.zeros(len(values), bool)
    on[list(alarm)] = True
    labelled = {frame: Box(*box) for frame, box in (boxes or {}).items()}
    output = Output(values, values, on, None if winner is None else np.array(winner, float))
    label = Label(f"{onset}.avi", onset, contact, motion, labelled)
    return Clip(label, np.arange(len(values)) / rate, 400, 200, {NAME: output})


def peaks(frames: int, at: dict[int, float]) -> list[float]:
    """Responses that are 0 except at some frames."""
    return [at.get(frame, 0.0) for frame in range(frames)]
