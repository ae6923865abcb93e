"""Remarks on values that the frames of a valid stimulus do not show."""

from __future__ import annotations

import tomllib

import pytest

from oppload_cli.stimulus import Protocol, Renderer

TOP = """
[display]
width = 100
height = 100
frame_rate = 10
pixels_per_degree = 4
[timing]
motion_s = 1.0
after_s = 0.5
"""
GRATING = """
[[object]]
id = "grating"
kind = "square-grating"
period_deg = 10
motion.speed_deg_s = {}
"""
DISK = """
[[object]]
id = "disk"
kind = "disk"
size_deg = 10
"""


def remarks(text: str) -> list[str]:
    return Protocol.from_table(tomllib.loads(text), "my.toml").remarks()


@pytest.mark.parametrize(
    ("text", "remarked"),
    [
        (GRATING.format(49), False),
        (GRATING.format(50), True),  # half of the period in a frame
        (GRATING.format("70\nmotion.direction_deg = 60"), False),  # 35 deg/s along the axis
        (GRATING.format("0\nmotion.path_deg = [[0, 0], [51, 0]]\nmotion.path_s = [0, 1]"), True),
        (GRATING.format("30\nmotion.zoom_per_s = -1"), True),  # the period shrinks to 3.7 deg
        (GRATING.format("30\n[scene.motion]\nspeed_deg_s = 30"), True),
        (GRATING.replace("square-grating", "plaid").format(70), False),  # 4.95 deg on both axes
        (GRATING.replace("square-grating", "plaid").format(71), True),
        (DISK + "motion.speed_deg_s = 51", False),
    ],
)
def test_a_grating_that_moves_too_far_in_a_frame(text: str, remarked: bool) -> None:
    found = remarks(TOP + text)
    assert len(found) == remarked
    assert all(remark.startswith("object 'grating': it moves by half of its") for remark in found)


@pytest.mark.parametrize(
    ("text", "remarked"),
    [
        (DISK + "luminance = 1.0", True),
        (DISK + "luminance = 1.0\n" + DISK.replace('"disk"\nkind', '"ring"\nkind'), False),
        (DISK + "luminance = 1.0\nbrightness = {kind = 'step', to = 0.5}", False),
        (DISK.replace('"disk"\nsize', '"patch"\nsize') + "luminance = 0.5", False),
    ],
)
def test_objects_of_the_luminance_of_the_ground(text: str, remarked: bool) -> None:
    grounds = (TOP, TOP.replace("[timing]", "background = 0.5\n[timing]"))
    found = remarks(grounds["patch" in text] + text)
    assert len(found) == remarked
    assert all(remark.startswith("every object has the luminance of") for remark in found)


@pytest.mark.parametrize(
    ("motion", "remarked"),
    [
        ("motion = {zoom_per_s = 1}", True),
        ("motion = {rotation_deg_s = 9}", True),
        ("motion = {zoom_per_s = 1, speed_deg_s = 5}", False),
        ("motion = {rotation_deg_s = 9, shake_deg = 1}", False),
        ("motion = {zoom_per_s = 1}\ncoherence = 1", False),
        ("", False),
    ],
)
def test_coherence_that_has_no_effect(motion: str, remarked: bool) -> None:
    """The frames of a zoom or a turn are the same at every coherence."""
    dots = DISK.replace('kind = "disk"', 'kind = "dots"\ndot_deg = 1\ndots_per_100deg2 = 9')
    text = TOP + dots + motion
    found = remarks(text if "coherence" in text else f"{text}\ncoherence = 0.5")
    assert len(found) == remarked
    assert all("so that coherence has no effect" in remark for remark in found)
    if remarked:
        made = (Protocol.from_table(tomllib.loads(f"{text}\ncoherence = {c}"), "") for c in (0, 1))
        first, second = (Renderer(protocol).grey(8) for protocol in made)
        assert (first == second).all()


@pytest.mark.parametrize(
    ("growth", "found"),
    [
        ("l_over_v_ms = 40", ""),
        ("l_over_v_ms = 40\nmost_deg = 20\nleast_deg = 10", ""),
        ("l_over_v_ms = 5", ""),  # 0.85 of the growth in one frame
        ("l_over_v_ms = 3", "from one frame to the next"),  # 0.91
        ("l_over_v_ms = 0.04", "from one frame to the next"),  # seconds
        ("l_over_v_ms = 0.04\nmost_deg = 20", "from one frame to the next"),
        ("l_over_v_ms = 40\ncontact_s = 60\nleast_deg = 1", "the same in every frame"),
        ("l_over_v_ms = 40\ncontact_s = 60", ""),  # grows little, but evenly
        ("l_over_v_ms = 40_000\nmost_deg = 20", "the same in every frame"),  # microseconds
        ("l_over_v_ms = 40_000", "the same in every frame"),
    ],
)
@pytest.mark.parametrize("reverse", [False, True])
def test_an_approach_that_no_frame_shows(growth: str, found: str, reverse: bool) -> None:
    disk = DISK.replace("size_deg = 10", f"reverse = {str(reverse).lower()}")
    remarked = remarks(f"{TOP}{disk}[object.growth]\nkind = 'approach'\n{growth}")
    assert len(remarked) == bool(found)
    assert all(found in remark and "which is in milliseconds" in remark for remark in remarked)


@pytest.mark.parametrize(("hertz", "remarked"), [(5, False), (5.1, True)])
def test_a_flicker_that_is_too_fast(hertz: float, remarked: bool) -> None:
    flicker = f"brightness = {{kind = 'flicker', to = 1.0, frequency_hz = {hertz}}}"
    found = remarks(TOP + DISK + flicker)
    assert len(found) == remarked
    assert all("brightness.frequency_hz is above half of" in remark for remark in found)


@pytest.mark.parametrize(
    ("text", "late"),
    [
        ("brightness = {kind = 'step', to = 1.0, start_s = 1.0}", ""),
        ("brightness = {kind = 'step', to = 1.0, start_s = 1.1}", "brightness.start_s"),
        ("growth = {kind = 'steps', sizes_deg = [1, 2], times_s = [0.5, 1.0]}", ""),
        ("growth = {kind = 'steps', sizes_deg = [1, 2], times_s = [0.5, 1.1]}", "growth.times_s"),
        ("motion = {path_deg = [[0, 0], [1, 1]], path_s = [0, 1.0]}", ""),
        ("motion = {path_deg = [[0, 0], [1, 1]], path_s = [0, 1.1]}", "motion.path_s"),
    ],
)
def test_a_change_after_the_end_of_the_motion(text: str, late: str) -> None:
    found = remarks(TOP + DISK + text)
    assert len(found) == bool(late)
    assert all(f"{late} is after the end of the motion" in remark for remark in found)


def test_a_change_that_no_frame_shows() -> None:
    # Without a pause after the motion, the last frame comes before the end of the motion.
    step = "growth = {kind = 'steps', sizes_deg = [2], times_s = [1.0]}"
    top = TOP.replace("after_s = 0.5", "")
    assert "growth.times_s" in remarks(top + DISK + step)[0]
    assert remarks(top + DISK + "reverse = true\n" + step) == []
    # An approach has no steps, even if no frame comes after the pause.
    top = TOP.replace("rate = 10", "rate = 0.5").replace("motion_s", "before_s = 0.4\nmotion_s")
    disk = DISK.replace("size_deg = 10", "[object.growth]\nkind = 'approach'\nl_over_v_ms = 40")
    assert not any("times_s" in remark for remark in remarks(top + disk))


@pytest.mark.parametrize(("cut_s", "remarked"), [(1.4, False), (1.5, True)])
def test_a_cut_after_the_end_of_the_clip(cut_s: float, remarked: bool) -> None:
    projection = "projection = 'perspective'\n[timing]"
    scene = f"[scene]\nbackground = 'sky'\ncut_s = {cut_s}"
    found = remarks(TOP.replace("[timing]", projection) + scene)
    assert len(found) == remarked
    assert all("cut_s is after the end of the clip" in remark for remark in found)


BALL = """
[[object]]
id = "ball"
kind = "picture"
drawing = "ball"
size_m = 0.5
course = {kind = "collision", speed_m_s = 2}
"""


@pytest.mark.parametrize(
    ("text", "keys"),
    [
        (
            f"[scene]\nrotation_deg = 90\nmotion.speed_deg_s = 0\n{BALL}",
            "rotation_deg and scene.motion",
        ),
        (f"[scene]\ncentre_deg = [5, 0]\n{BALL}{DISK}", "centre_deg"),
        ("[scene]\nbackground = 'sky'\nrotation_deg = 90", "rotation_deg"),
        (f"[scene]\nbackground = 'sky'\nrotation_deg = 90\n{DISK}", ""),  # the disk turns
        (f"[scene]\nbackground = 'sky'\n{BALL}", ""),
    ],
)
def test_a_turn_of_the_scene_that_pictures_do_not_follow(text: str, keys: str) -> None:
    found = remarks(TOP.replace("[timing]", "projection = 'perspective'\n[timing]") + text)
    assert len(found) == bool(keys)
    assert all(f"do not follow scene.{keys}; use a course" in remark for remark in found)
