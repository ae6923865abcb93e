"""Clips whose responses are made by hand."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from oppload_cli.evaluation.metrics.clips import Clip, Label, Output

if TYPE_CHECKING:
    from collections.abc import Sequence

    from oppload_cli.evaluation.metrics.clips import Box

NAME = "detector"
WARM_UP = 3


def clip(
    response: Sequence[float],
    onset: int | None = None,
    contact: int | None = None,
    *,
    rate: float = 10,
    motion: str = "",
    boxes: dict[int, Box] | None = None,
    alarm: Sequence[int] = (),
    winner: Sequence[Sequence[float]] | None = None,
) -> Clip:
    """A clip of 400 x 200 px; its first three responses are warm-up."""
    values = np.array(response, float)
    values[:WARM_UP] = np.nan
    on = np.zeros(len(values), bool)
    on[list(alarm)] = True
    output = Output(values, values, on, None if winner is None else np.array(winner, float))
    label = Label(f"{onset}.avi", onset, contact, motion, boxes or {})
    return Clip(label, np.arange(len(values)) / rate, 400, 200, {NAME: output})


def peaks(frames: int, at: dict[int, float]) -> list[float]:
    """Responses that are 0 except at some frames."""
    return [at.get(frame, 0.0) for frame in range(frames)]
