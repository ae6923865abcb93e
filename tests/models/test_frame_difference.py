from __future__ import annotations

import numpy as np
import pytest

from oppload_cli.errors import FrameError
from oppload_cli.models.detector import Response
from oppload_cli.models.frame_difference import FrameDifference
from tests import reference


def test_the_response_is_the_mean_of_p() -> None:
    frames = list(np.random.default_rng(1).random((5, 13, 17), dtype=np.float32))
    detector = FrameDifference((13, 17))
    first, *answers = [detector.step(frame) for frame in frames]
    assert first is None
    for answer, p in zip(answers, reference.photoreceptors(frames), strict=True):
        assert answer is not None
        assert answer.response == pytest.approx(p.mean(), rel=1e-6)
        assert answer.box is None


def test_a_still_scene_answers_nothing() -> None:
    detector = FrameDifference((5, 6))
    frame = np.random.default_rng(1).random((5, 6), dtype=np.float32)
    assert [detector.step(frame) for _ in range(3)] == [None, Response(0.0), detector.at_rest()]


def test_reset_starts_over() -> None:
    frames = list(np.random.default_rng(1).random((3, 5, 6), dtype=np.float32))
    detector = FrameDifference((5, 6))
    first = [detector.step(frame) for frame in frames]
    detector.reset()
    assert [detector.step(frame) for frame in frames] == first


def test_a_wrong_array_is_refused() -> None:
    with pytest.raises(FrameError, match="float32 array of shape"):
        FrameDifference((5, 6)).step(np.zeros((6, 5), np.float32))
