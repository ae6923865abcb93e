"""The ground truth file agrees with the frames."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import pytest

from oppload_cli import stimulus
from oppload_cli.errors import StimulusError
from oppload_cli.stimulus.geometry import Projection
from oppload_cli.version import __version__
from tests.stimulus.measuring import made

if TYPE_CHECKING:
    from pathlib import Path


def test_reference_disk() -> None:
    """Radius 5 + 4 t px, t in frames, in the middle of 600 x 600."""
    truth = stimulus.ground_truth(stimulus.load("opplod2023/looming-disk-centre"))
    assert truth["schema"] == "oppload.stimulus/1"
    assert truth["tool_version"] == __version__
    assert truth["display"] == {
        "width": 600,
        "height": 600,
        "frame_rate": "30/1",
        "pixels_per_degree": 10.0,
        "projection": "flat",
    }
    assert truth["looming"] is True
    assert truth["contact_time_s"] is None
    assert len(truth["frames"]) == 45
    for index, frame in enumerate(truth["frames"]):
        (disk,) = frame["objects"]
        assert frame["frame"] == index
        assert frame["time_s"] == index / 30
        assert frame["looming"] is True
        assert disk["angular_size_deg"] * 10 / 2 == pytest.approx(5 + 4 * index)
        assert disk["edge_speed_px_frame"] == pytest.approx(4)
        assert (disk["centre_x_px"], disk["centre_y_px"]) == (300, 300)
        assert disk["time_to_contact_s"] is None


def test_reference_disk_off_centre() -> None:
    truth = stimulus.ground_truth(stimulus.load("opplod2023/looming-disk-off-centre"))
    disk = truth["frames"][10]["objects"][0]
    assert (disk["centre_x_px"], disk["centre_y_px"]) == pytest.approx((430, 230))


def test_a_bar_that_grows_like_an_approach_has_no_contact() -> None:
    protocol = stimulus.load("klapoetke2017/loom-l-over-v/l-over-v-40")
    bar = replace(protocol.objects[0], kind="bar", width_deg=10)
    truth = stimulus.ground_truth(replace(protocol, objects=(bar,)))
    contacts = {frame["objects"][0]["time_to_contact_s"] for frame in truth["frames"]}
    assert (truth["looming"], truth["contact_time_s"], contacts) == (False, None, {None})


def test_approach_has_a_time_of_contact() -> None:
    protocol = stimulus.load("klapoetke2017/loom-l-over-v/l-over-v-40")
    truth = stimulus.ground_truth(protocol)
    assert truth["contact_time_s"] == pytest.approx(2.2)
    looming = [frame for frame in truth["frames"] if frame["looming"]]
    for frame in looming:
        disk = frame["objects"][0]
        assert disk["time_to_contact_s"] == pytest.approx(2.2 - frame["time_s"])
        expected = 2 * math.degrees(math.atan(0.04 / (2.2 - frame["time_s"])))
        assert disk["angular_size_deg"] == pytest.approx(expected, abs=1e-9)
    # it looms from the end of the pause until it has 60 degrees
    assert looming[0]["time_s"] == pytest.approx(0.2)
    assert looming[-1]["objects"][0]["angular_size_deg"] < 60
    assert truth["frames"][-1]["objects"][0]["angular_size_deg"] == 60


@pytest.mark.parametrize(
    ("name", "looms"),
    [
        ("controls/receding-disk/l-over-v-40", False),
        ("controls/translating-disk-direction/rotation-45", False),
        ("controls/size-steps", False),
        ("controls/texture-zoom/zoom-0.6", False),
        ("klapoetke2017/bar-expand-60/axis-30", False),
        ("controls/looming-on-moving-texture/direction-90", True),
        ("controls/looming-ring", True),
        ("opplod2023/approaching-block", True),
    ],
)
def test_only_complete_outlines_loom(name: str, looms: bool) -> None:
    assert stimulus.ground_truth(stimulus.load(name))["looming"] is looms


_ASIDE: dict[str, Any] = {"disk.motion.speed_deg_s": 0.0}
_BACK: dict[str, Any] = {**_ASIDE, "disk.motion.path_s": [1, 1.7]}


@pytest.mark.parametrize(
    ("changes", "passes"),
    [
        # From 5.72 to 40 degrees in 1.725 s: half of the growth is 17.1 degrees, 9.93 deg/s.
        ({}, True),
        ({"disk.motion.speed_deg_s": 9.9}, False),
        ({"disk.motion.speed_deg_s": 10.0}, True),
        ({"disk.motion.speed_deg_s": 10.0, "disk.motion.direction_deg": 200}, True),
        # From 20 to 40 degrees in 0.293 s: 34.1 deg/s.
        ({"disk.growth.least_deg": 20, "disk.motion.speed_deg_s": 34}, False),
        ({"disk.growth.least_deg": 20, "disk.motion.speed_deg_s": 35}, True),
        # Contact after the end of the clip: from 3.81 to 11.42 degrees in 2 s, 1.90 deg/s.
        ({"disk.growth.contact_s": 3.2, "disk.motion.speed_deg_s": 1.8}, False),
        ({"disk.growth.contact_s": 3.2, "disk.motion.speed_deg_s": 2.0}, True),
        # A way out and back, a shake and the movement of all, which is that of the camera.
        ({**_BACK, "disk.motion.path_deg": [[15, 0], [0, 0]]}, False),
        ({**_BACK, "disk.motion.path_deg": [[0, 0], [18, 0]]}, True),
        ({**_ASIDE, "disk.motion.shake_deg": 40}, False),
        ({**_ASIDE, "scene.motion.speed_deg_s": 12}, False),
    ],
)  # fmt: skip
def test_what_moves_aside_further_than_it_grows_passes(
    changes: dict[str, Any], passes: bool
) -> None:
    """Then it neither looms nor touches; else contact is at the end of the motion."""
    protocol = stimulus.load("controls/near-miss", changes)
    truth = stimulus.ground_truth(protocol)
    contact = changes.get("disk.growth.contact_s", 2.2)
    assert truth["contact_time_s"] == (None if passes else contact)
    assert truth["looming"] is not passes
    middle = truth["frames"][30]["objects"][0]
    assert middle["edge_speed_deg_s"] > 0 or "disk.growth.least_deg" in changes
    assert middle["time_to_contact_s"] == (None if passes else pytest.approx(contact - 1))


@pytest.mark.parametrize("end_deg", [60, 15])
@pytest.mark.parametrize(("speed", "passes"), [(9.9, False), (10.0, False), (10.1, True)])
def test_a_disk_that_grows_at_constant_edge_speed_passes_too(
    speed: float, passes: bool, end_deg: float
) -> None:
    """Both edges move by 10 deg/s; beyond, they move to the same side, until the growth ends."""
    changes = {"disk.motion.speed_deg_s": speed, "disk.growth.speed_deg_s": 10}
    changes["disk.growth.end_deg"] = end_deg
    protocol = stimulus.load("klapoetke2017/loom-speed", changes)
    truth = stimulus.ground_truth(protocol)
    assert truth["looming"] is not passes


def test_a_shape_that_fills_every_display_has_no_speed_there() -> None:
    """Near 180 degrees the tangent of half the size has no bound; the drawn outline keeps still."""
    screen = Projection((60, 80), 1.0, perspective=True)
    assert screen.reach(89.99) == screen.reach(89.9)
    speeds = [screen.reach_speed(angle, 10) for angle in (0, 45, 89.9, -89.9)]
    assert speeds == pytest.approx([10, 20, 0, 0])


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        ("controls/near-miss", {}),
        ("controls/zigzag-disk", {}),
        ("controls/zigzag-disk", {"display.projection": "perspective"}),
        ("controls/looming-perspective", {}),
        ("klapoetke2017/bar-expand-10-one-end/axis-30", {}),
        ("klapoetke2017/bar-sweep/rotation-45", {}),
    ],
)
def test_edge_speed_is_the_change_of_the_size_on_the_display(
    name: str, changes: dict[str, Any]
) -> None:
    """A central difference of finely spaced truths gives the same pixels per frame."""
    coarse = stimulus.load(name, changes)
    rate = coarse.display.frame_rate
    fine = stimulus.load(name, {**changes, "display.frame_rate": str(rate * 100)})
    for frame in range(8, 20):
        stated = stimulus.frame_truth(coarse, frame).objects[0]
        before, after = (
            stimulus.frame_truth(fine, frame * 100 + step).objects[0] for step in (-1, 1)
        )
        if coarse.objects[0].growth is None:
            moved = math.hypot(
                after.centre_x_px - before.centre_x_px, after.centre_y_px - before.centre_y_px
            )
            expected = moved / 2 * 100
        else:
            assert after.angular_size_deg is not None
            assert before.angular_size_deg is not None
            ends = 1 if coarse.objects[0].growth.sides != "both" else 2
            expected = _reach(coarse, after.angular_size_deg) - _reach(
                coarse, before.angular_size_deg
            )
            expected *= 2 / ends / 2 * 100
        assert stated.edge_speed_px_frame == pytest.approx(expected, rel=1e-4)


def test_patterns_and_edges_have_a_place_that_moves_and_no_size() -> None:
    """The place is the origin of the pattern, a point of the edge, or the middle of an aperture."""
    moving = stimulus.Motion(speed_deg_s=10, direction_deg=90)
    grating: dict[str, Any] = {
        "id": "g",
        "kind": "sine-grating",
        "period_deg": 10,
        "motion": moving,
    }
    edge = stimulus.Object(id="e", kind="edge", motion=moving, centre_deg=(3, 0))
    for obj, x, moved in (
        (stimulus.Object(**grating), 100, 5),
        (stimulus.Object(**grating, size_deg=8), 100, 0),
        (edge, 115, 5),
    ):
        truth = stimulus.frame_truth(made(obj), 15).objects[0]
        assert truth.angular_size_deg is None
        place = truth.centre_x_px, truth.centre_y_px
        assert place == pytest.approx((x, 90 - 5 * moved))


def _reach(protocol: stimulus.Protocol, size_deg: float) -> float:
    return Projection.of(protocol.display).reach(size_deg / 2)


def test_reading(tmp_path: Path) -> None:
    path = tmp_path / "a.stimulus.json"
    truth = stimulus.ground_truth(stimulus.load("klapoetke2017/loom"))
    path.write_text(json.dumps(truth), encoding="utf-8")
    assert stimulus.read_ground_truth(path) == truth
    for text, words in (
        ("{", "not valid JSON"),
        ("[1]", "its schema is None"),
        ('{"schema": "oppload.stimulus/9", "frames": []}', "oppload.stimulus/9"),
    ):
        path.write_text(text)
        with pytest.raises(StimulusError, match=words):
            stimulus.read_ground_truth(path)
    with pytest.raises(StimulusError, match="no such file"):
        stimulus.read_ground_truth(tmp_path / "gone.json")
