from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from tests.media import looming, write_video

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture(scope="session")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A looming disk of 24 frames, off centre."""
    frames = [(frame * 255).round().astype(np.uint8) for frame in looming(240, 150, 110, 24)]
    return write_video(tmp_path_factory.mktemp("clips") / "loom.avi", frames)
