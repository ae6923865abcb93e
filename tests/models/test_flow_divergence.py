from __future__ import annotations

import cv2
import numpy as np
import pytest

from oppload_cli.errors import ParameterError
from oppload_cli.models.flow_divergence import (
    FlowDivergence,
    FlowDivergenceParams,
    largest_divergence,
)
from tests.media import texture


def flow_of(along_x: float, along_y: float, turn: float = 0.0, shift: float = 0.0) -> np.ndarray:
    y, x = np.mgrid[-60:60, -80:80].astype(np.float32)
    return np.stack([along_x * x - turn * y + shift, along_y * y + turn * x], axis=-1)


def enlarged(picture: np.ndarray) -> np.ndarray:
    """Return a picture that has grown by 4 % about its middle."""
    height, width = picture.shape
    turn = cv2.getRotationMatrix2D(((width - 1) / 2, (height - 1) / 2), 0, 1.04)
    return cv2.warpAffine(picture, turn, (width, height), flags=1).astype(np.float32)


def response(before: np.ndarray, now: np.ndarray, **params: float) -> float:
    detector = FlowDivergence(before.shape, FlowDivergenceParams(**params))
    assert detector.step(before) is None
    answer = detector.step(now)
    assert answer is not None
    return answer.response


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
    assert response(still, enlarged(still)) == pytest.approx(0.08, rel=0.25)
    assert response(still, np.roll(still, 2, axis=1)) < 0.02
    assert response(still, still) == 0


def test_low_and_wide_frames_are_measured_too() -> None:
    # With OpenCV's own scales this frame, lower than 32 px, ends the process.
    still = texture(31, 160, 1)
    assert response(still, enlarged(still)) == pytest.approx(0.08, rel=0.5)


def test_the_window_is_a_share_of_the_height() -> None:
    still = texture(120, 160, 1)
    small, default, whole = (
        response(still, enlarged(still), window=window) for window in (0.1, 5 / 12, 1.0)
    )
    assert small > default > whole > 0


def test_reset_starts_over() -> None:
    frames = [texture(48, 64, seed) for seed in range(3)]
    detector = FlowDivergence((48, 64))
    first = [detector.step(frame) for frame in frames]
    assert first[0] is None
    detector.reset()
    assert [detector.step(frame) for frame in frames] == first


def test_frames_may_not_be_smaller_than_the_search_for_flow_takes() -> None:
    with pytest.raises(ParameterError, match="needs frames of at least 16 x 16 px, not 40 x 15"):
        FlowDivergence((15, 40))
    frames = np.random.default_rng(1).random((2, 16, 40), dtype=np.float32)
    detector = FlowDivergence((16, 40))
    first, second = (detector.step(frame) for frame in frames)
    assert first is None
    assert second is not None
    assert second.response > 0
