from __future__ import annotations

import cv2
import numpy as np
import pytest

from oppload_cli.errors import FrameError
from oppload_cli.motion.divergence import FlowDivergence, largest_divergence
from tests.media import texture


def flow_of(along_x: float, along_y: float, turn: float = 0.0, shift: float = 0.0) -> np.ndarray:
    y, x = np.mgrid[-60:60, -80:80].astype(np.float32)
    return np.stack([along_x * x - turn * y + shift, along_y * y + turn * x], axis=-1)


@pytest.mark.parametrize(
    ("flow", "expected"),
    [
        (flow_of(0.05, 0.05), 0.1),
        (flow_of(0.05, 0.0), 0.05),
        (flow_of(0.05, 0.05, 0.3, 4.0), 0.1),
        (flow_of(0, 0, 0.3), 0.0),
        (flow_of(0, 0, 0, 4.0), 0.0),
        (flow_of(-0.05, -0.05), 0.0),
    ],
)
def test_only_expansion_counts(flow: np.ndarray, expected: float) -> None:
    assert largest_divergence(flow, 50) == pytest.approx(expected, abs=1e-6)


def test_the_window_that_expands_most_is_taken() -> None:
    flow = np.zeros((120, 160, 2), np.float32)
    flow[10:60, 90:140] = flow_of(0.04, 0.04)[35:85, 55:105]
    # Within, 2 x 0.04; the jump back at its edge lies outside a window of 48 px.
    assert largest_divergence(flow, 48) == pytest.approx(0.08, rel=0.02)
    assert largest_divergence(flow, 500) == largest_divergence(flow, 120)


def test_a_growing_texture_diverges_and_a_moving_one_does_not() -> None:
    still = texture(120, 160, 1)
    centre = (79.5, 59.5)
    grown = cv2.warpAffine(
        still, cv2.getRotationMatrix2D(centre, 0, 1.04), (160, 120), flags=1
    ).astype(np.float32)
    moved = np.roll(still, 2, axis=1)
    assert FlowDivergence().step(still) is None
    found = {}
    for name, frame in {"grown": grown, "moved": moved, "still": still}.items():
        flow = FlowDivergence()
        flow.step(still)
        found[name] = flow.step(frame)
    assert found["grown"] == pytest.approx(0.08, rel=0.25)
    assert (found["moved"] or 0) < 0.02
    assert found["still"] == 0


def test_frames_too_small_and_of_another_size() -> None:
    flow = FlowDivergence()
    assert flow.step(np.zeros((8, 8), np.float32)) is None
    assert flow.step(np.ones((8, 8), np.float32)) == 0
    with pytest.raises(FrameError, match="after one of"):
        flow.step(np.ones((9, 8), np.float32))
