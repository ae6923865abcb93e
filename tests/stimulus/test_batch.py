"""Several stimuli at a time, and an end from outside."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.skipif(sys.platform == "win32", reason="process groups are of POSIX")
@pytest.mark.parametrize("stop", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_leaves_whole_files_only(stop: signal.Signals, tmp_path: Path) -> None:
    words = ("stimuli", "generate", "controls/*", "-o", str(tmp_path), "--jobs", "2")
    running = subprocess.Popen(
        [sys.executable, "-m", "oppload_cli", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    for _ in range(600):
        # Written last; each of both processes may be stopped right after one, and take it back.
        if len(list(tmp_path.glob("*.stimulus.json"))) > 2:
            break
        time.sleep(0.05)
    # Ctrl-C goes to the whole group, an end from outside to the parent
    (os.killpg if stop == signal.SIGINT else os.kill)(running.pid, stop)
    _, said = running.communicate(timeout=60)
    assert running.returncode == 130
    assert said.strip() == "oppload: interrupted"
    names = sorted(path.name for path in tmp_path.iterdir())
    assert not [name for name in names if name.endswith(".part")]
    videos = {name.removesuffix(".avi") for name in names if name.endswith(".avi")}
    assert 0 < len(videos) < 150
    assert videos == {
        name.removesuffix(".stimulus.json") for name in names if name.endswith(".json")
    }
