"""Scripts of the how-to pages that need programs which are not here run with stand-ins."""

from __future__ import annotations

import csv
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

import oppload_cli as oppload
from tests.cli import inside
from tests.media import disk

PAGES = Path(__file__).resolve().parents[1] / "docs" / "howto"
RCLPY = """
class Publisher:
    def __init__(self, topic): self.topic = topic
    def publish(self, message): print(self.topic, message.data)
class Node:
    def create_publisher(self, kind, topic, depth): return Publisher(topic)
def init(): pass
def create_node(name): return Node()
def shutdown(): print("shut down")
"""
MESSAGES = """
class Bool:
    def __init__(self, data): self.data = data
Float32 = Bool
"""


def test_the_ros_node_publishes_each_row(tmp_path: Path) -> None:
    page = (PAGES / "ros2.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```python\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)
    (script,) = [block for block in blocks if "import rclpy" in block]
    (tmp_path / "looming_node.py").write_text(script)
    (tmp_path / "rclpy.py").write_text(RCLPY)
    (tmp_path / "std_msgs").mkdir()
    (tmp_path / "std_msgs" / "msg.py").write_text(MESSAGES)
    table = "frame,time_s,opplod_response,opplod_alarm\n0,0,,0\n1,0.1,0.25,1\n"
    done = subprocess.run(
        [sys.executable, "looming_node.py"],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
        input=table,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.splitlines() == [
        "looming/alarm False", "looming/response 0.0",
        "looming/alarm True", "looming/response 0.25",
        "shut down",
    ]  # fmt: skip


def test_the_callback_of_a_ros_topic_answers_to_its_images() -> None:
    page = (PAGES / "ros2.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```python\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)
    (script,) = [block for block in blocks if "def on_image" in block]
    names: dict[str, Any] = {}
    exec(compile(script, "ros2.md", "exec"), names)  # noqa: S102 - the page's own code
    y, x = np.mgrid[:90, :120]
    answers = []
    for frame in range(26):
        image = np.zeros((90, 3 * 120 + 8), np.uint8)  # rows end in bytes that are no pixels
        white = np.clip(np.hypot(x - 60, y - 45) - 60 / (30 - frame), 0, 1)
        image[:, :360] = np.repeat(255 * white, 3, axis=1)
        stamp = SimpleNamespace(sec=1000, nanosec=round(frame / 30 * 1e9))
        header = SimpleNamespace(stamp=stamp)
        message = SimpleNamespace(
            height=90, width=120, step=368, data=image.tobytes(), header=header
        )
        answers.append(names["on_image"](message))
    assert answers[0] == (False, None)
    alarm, nearest = answers[-1]
    assert alarm
    assert abs(nearest.centre_x - 60) < 1
    assert abs(nearest.time_to_contact_s - 5 / 30) < 0.02


def scripts_of(name: str) -> list[str]:
    """Return the Python code of a page that no other test runs."""
    page = (PAGES / name).read_text(encoding="utf-8")
    return re.findall(r"^```python\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)


@pytest.mark.long
def test_the_log_of_a_loop_over_a_camera_can_be_read_and_drawn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It has the alarms and boxes of the frames that were kept."""
    page = (PAGES.parent / "python.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```python\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)
    (script,) = [block for block in blocks if "DictWriter" in block]
    grown = [1 - disk(120, 60, 60, 60 / (30 - frame)) for frame in range(29)]
    frames = [(255 * frame).round().astype(np.uint8) for frame in grown]
    times = [index / 30 for index in range(29)]
    camera = [(frame, 1000 + time_s) for frame, time_s in zip(frames, times, strict=True)]
    monkeypatch.chdir(tmp_path)
    names = {"analysis": oppload.Analysis((120, 120)), "camera": camera}
    exec(compile(script, "python.md", "exec"), names)  # noqa: S102 - the page's own code
    logged = oppload.read_result("flight.frames.csv").frames
    kept = oppload.run(np.stack(frames), times=times, rmo=False).frames
    assert kept["opplod_alarm"].sum() > 2
    for name in kept:
        assert logged[name].to_numpy() == pytest.approx(kept[name].to_numpy(), 1e-6, nan_ok=True)
    done = inside.oppload("plot", "flight.frames.csv")
    assert (done.returncode, Path("flight.frames.png").exists()) == (0, True), done.stderr


def test_images_have_the_times_of_their_names(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    script, _ = scripts_of("images.md")
    (tmp_path / "cam0").mkdir()
    for number, time_ms in enumerate((0, 30, 95, 130, 160)):
        image = np.full((16, 24), 40 * number, np.uint8)
        assert cv2.imwrite(str(tmp_path / "cam0" / f"{1403636579_000 + time_ms}000000.png"), image)
    monkeypatch.chdir(tmp_path)
    exec(compile(script, "images.md", "exec"), {})  # noqa: S102 - the page's own code
    with (tmp_path / "results" / "cam0.frames.csv").open() as table:
        times = [float(row["time_s"]) for row in csv.DictReader(table)]
    assert times == pytest.approx([0, 0.03, 0.095, 0.13, 0.16], abs=1e-6)


def test_images_of_12_bits_have_the_times_of_a_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A change of two codes of 12 bits, which 8 bits do not hold, reaches the detectors."""
    _, script = scripts_of("images.md")
    (tmp_path / "cam1").mkdir()
    lines = []
    for number, time_s in enumerate((7, 7.03, 7.095, 7.13, 7.16)):
        image = np.full((16, 24), 2048 + 2 * (number % 2), np.uint16)
        assert cv2.imwrite(str(tmp_path / "cam1" / f"img_{number}.tif"), image)
        lines.append(f"{number}\t{time_s}\n")
    (tmp_path / "cam1" / "times.txt").write_text("".join(lines))
    monkeypatch.chdir(tmp_path)
    exec(compile(script, "images.md", "exec"), {})  # noqa: S102 - the page's own code
    with (tmp_path / "results" / "cam1.frames.csv").open() as table:
        rows = list(csv.DictReader(table))
    assert [float(row["time_s"]) for row in rows] == pytest.approx(
        [0, 0.03, 0.095, 0.13, 0.16], abs=1e-6
    )
    share = (1 / 30) / 0.035  # of the step before, by which the change counts
    assert float(rows[3]["luma_change"]) == pytest.approx(share * 2 * 16 / 65535, rel=1e-3)


@pytest.mark.long
@pytest.mark.skipif(not shutil.which("bash"), reason="NOT TESTED: needs bash")
def test_the_first_tutorial_makes_the_videos_of_the_others(tmp_path: Path) -> None:
    page = (PAGES.parent / "tutorials" / "collision.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```sh\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)
    (script,) = [block for block in blocks if "stimuli generate" in block]
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    subprocess.run(
        ["bash", "-euc", script], cwd=tmp_path, env={**os.environ, "PATH": path}, check=True
    )
    made = {str(each.relative_to(tmp_path)) for each in tmp_path.rglob("*.mp4")}
    assert made == {
        "video.mp4", "videos/approach.mp4", "videos/passing-by.mp4", "videos/retreat.mp4",
    }  # fmt: skip
