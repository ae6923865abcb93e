"""Staged scenes: truth against geometry, backgrounds, and what is refused."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest

from oppload_cli import stimulus
from oppload_cli.errors import StimulusError
from oppload_cli.stimulus import PictureTruth, Renderer, background, frame_truth
from oppload_cli.stimulus.courses import Course, Line
from oppload_cli.stimulus.objects import DRAWINGS
from oppload_cli.stimulus.protocol_tables import SURROUNDINGS
from oppload_cli.stimulus.staging import view_of
from tests.media import write_video

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

WIDTH, HEIGHT = 160, 120
EYE = WIDTH / 2 / math.tan(math.radians(30))


def staged(
    course: dict[str, Any] | None, scene: dict[str, Any] | None = None, **others: Any
) -> stimulus.Protocol:
    """Return a protocol of one picture; `others` are values of the object or tables."""
    table: dict[str, Any] = {"timing": {"motion_s": 1.0}, "scene": scene or {}}
    for name in ("timing", "camera", "effects"):
        if name in others:
            table[name] = others.pop(name)
    table["display"] = {
        "width": WIDTH,
        "height": HEIGHT,
        "field_of_view_deg": 60,
        "background": 0.0,
        "projection": "perspective",
        **others.pop("display", {}),
    }
    if course is not None:
        thing = {"id": "thing", "kind": "picture", "size_m": 0.5, **others}
        thing["course"] = course
        if "file" not in thing:
            thing.setdefault("drawing", "ball")
        table["object"] = [thing]
    return stimulus.Protocol.from_table(table, "own.toml")


def white_disk(folder: Path, side: int = 400) -> str:
    """Write a white disk of a smooth outline on transparent ground."""
    x = np.arange(side) + 0.5 - side / 2
    opacity = np.clip(side / 2 - 10 - np.hypot(x[None, :], x[:, None]) + 0.5, 0, 1)
    rgba = np.full((side, side, 4), 255, np.uint8)
    rgba[..., 3] = np.rint(255 * opacity)
    path = folder / "disk.png"
    cv2.imwrite(str(path), rgba)
    return str(path)


def truth_of(protocol: stimulus.Protocol, frame: int) -> PictureTruth:
    truth = frame_truth(protocol, frame).objects[0]
    assert isinstance(truth, PictureTruth)
    return truth


def middle_and_area(picture: NDArray[np.float32]) -> tuple[float, float, float]:
    weights = picture.astype(np.float64)
    total = weights.sum()
    x, y = np.arange(picture.shape[1]) + 0.5, np.arange(picture.shape[0]) + 0.5
    return float(weights.sum(0) @ x / total), float(weights.sum(1) @ y / total), float(total)


@pytest.mark.parametrize(
    "camera", [{}, {"pan_deg_s": 8.0}, {"shake_deg": 1.0}, {"forward_m_s": 6.0}]
)
def test_size_and_place_are_those_of_the_geometry(tmp_path: Path, camera: dict[str, Any]) -> None:
    course = {"kind": "straight", "start_m": [-0.4, 0.3, 5], "velocity_m_s": [0.5, -0.2, -4.0]}
    protocol = staged(course, file=white_disk(tmp_path), camera=camera)
    renderer = Renderer(protocol)
    for frame in (0, 10, 20, 26):
        time = frame / 30
        at = np.array([-0.4 + 0.5 * time, 0.3 - 0.2 * time, 5 - 4 * time])
        x, y, area = middle_and_area(renderer.luminance(frame))
        truth = truth_of(protocol, frame)
        # the middle of a turned disk is not quite that of its image
        assert abs(x - truth.centre_x_px) < (0.5 if camera else 0.05)
        assert abs(y - truth.centre_y_px) < (0.5 if camera else 0.05)
        if not camera:
            assert truth.centre_x_px == pytest.approx(WIDTH / 2 + EYE * at[0] / at[2], abs=1e-9)
            assert truth.centre_y_px == pytest.approx(HEIGHT / 2 - EYE * at[1] / at[2], abs=1e-9)
            diameter = EYE * 0.5 / at[2]
            assert 2 * math.sqrt(area / math.pi) == pytest.approx(diameter, rel=1e-3)
            assert truth.box_px is not None
            assert truth.box_px[2] == pytest.approx(diameter, rel=1e-9)
            growing = EYE * 0.25 * 4 / at[2] ** 2 / 30
            assert truth.edge_speed_px_frame == pytest.approx(growing, rel=1e-9)
            degrees = math.degrees(0.25 * 4 / (at[2] ** 2 + 0.25**2))
            assert truth.edge_speed_deg_s == pytest.approx(degrees, rel=1e-9)
        assert truth.angular_size_deg == pytest.approx(2 * math.degrees(math.atan(0.25 / at[2])))


@pytest.mark.parametrize(("turn", "most"), [(0.0, 1.0), (10.0, 2.5)])
def test_the_box_surrounds_what_is_drawn(tmp_path: Path, turn: float, most: float) -> None:
    """The box is that of the corners: of a turned disk they stick out."""
    course = {"kind": "straight", "start_m": [0.3, 0.1, 2], "velocity_m_s": [0.0, 0.0, -1.0]}
    protocol = staged(course, file=white_disk(tmp_path), camera={"pan_deg_s": turn})
    for frame in (0, 15, 25):
        solid = Renderer(protocol).luminance(frame) > 0.5
        rows, columns = np.flatnonzero(solid.any(axis=1)), np.flatnonzero(solid.any(axis=0))
        box = truth_of(protocol, frame).box_px
        assert box is not None
        found = (columns[0], rows[0], columns[-1] + 1, rows[-1] + 1)
        wanted = (box[0], box[1], box[0] + box[2], box[1] + box[3])
        assert np.abs(np.subtract(found, wanted)).max() < most


def test_a_picture_with_a_corner_behind_the_camera_has_no_box() -> None:
    """A corner at (x, y, 1) m is (x + 1) / sqrt(2) m ahead of a camera that is turned by 45 deg."""
    course = {"kind": "hovering", "distance_m": 1.0}
    for size, boxed in ((1.9, True), (2.1, False)):
        truth = truth_of(staged(course, size_m=size, camera={"start_deg": 45}), 0)
        assert truth.visible
        assert (truth.box_px is not None) is boxed


def test_a_camera_that_turns_and_shakes_stays_rigid() -> None:
    """Its axes are at right angles and of length 1, as right, up and ahead at rest."""
    camera = {"start_deg": 30, "pan_deg_s": 40, "shake_deg": 5}
    protocol = staged(None, {"background": "plane"}, camera=camera)
    for time in (0.1, 0.5, 0.9):
        axes = np.array(view_of(protocol, time).axes)
        np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(axes) == pytest.approx(1)


def test_a_camera_moves_as_long_as_the_motion_lasts() -> None:
    camera = {"start_deg": 5, "pan_deg_s": 10, "forward_m_s": 2}
    timing = {"before_s": 0.5, "motion_s": 1.0, "after_s": 0.5}
    protocol = staged(None, {"background": "plane"}, camera=camera, timing=timing)
    for time, moved_s in ((0.0, 0.0), (0.4, 0.0), (0.8, 0.3), (1.5, 1.0), (1.9, 1.0)):
        view = view_of(protocol, time)
        turn = math.radians(5 + 10 * moved_s)
        assert view.axes[2] == pytest.approx((math.sin(turn), 0, math.cos(turn)))
        assert view.place == pytest.approx((0, 0, 2 * moved_s))


def test_the_shake_of_a_camera_has_the_stated_angle_to_the_side_and_up() -> None:
    timing = {"motion_s": 60.0}
    protocol = staged(None, {"background": "plane"}, camera={"shake_deg": 3.0}, timing=timing)
    ahead = np.array([view_of(protocol, at / 50).axes[2] for at in range(3000)])
    spread = np.degrees(ahead[:, :2].std(axis=0))
    assert np.hypot(*spread) == pytest.approx(3, rel=0.05)
    assert spread.min() > 1.5


def test_forward_motion_over_the_ground_has_the_exact_flow() -> None:
    protocol = staged(None, {"background": "plane"}, camera={"forward_m_s": 3, "height_m": 1.2})
    renderer = Renderer(protocol)
    flow = renderer.flow(4)
    before, after = renderer.luminance(4), renderer.luminance(5)
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    down = y - HEIGHT / 2
    ground = down > 4
    depth = EYE * 1.2 / np.maximum(down, 1e-9)
    grown = depth / (depth - 3 / 30)
    wanted = np.stack([(x - WIDTH / 2) * (grown - 1), down * (grown - 1)], axis=-1)
    assert np.abs(flow - wanted)[ground].max() < 1e-6
    # what is drawn moves as the flow says
    near = slice(HEIGHT // 2 + 16, HEIGHT - 12), slice(20, WIDTH - 20)
    to = ((x + flow[..., 0] - 0.5).astype(np.float32), (y + flow[..., 1] - 0.5).astype(np.float32))
    followed = cv2.remap(after, *to, cv2.INTER_CUBIC)
    assert np.abs(followed - before)[near].mean() < 0.35 * np.abs(after - before)[near].mean()
    shift, _ = cv2.phaseCorrelate(before[near].copy(), followed[near].copy())
    assert max(map(abs, shift)) < 0.2


@pytest.mark.parametrize("kind", SURROUNDINGS)
def test_surroundings_turn_as_the_flow_says(kind: str) -> None:
    protocol = staged(None, {"background": kind}, camera={"pan_deg_s": 12, "start_deg": -5})
    renderer = Renderer(protocol)
    flow = renderer.flow(3)
    middle = flow[HEIGHT // 2 + 6, WIDTH // 2]
    turned = math.radians(12 / 30)
    assert middle[0] == pytest.approx(-EYE * turned, rel=2e-3)
    assert renderer.luminance(3).std() > 0.05
    other = Renderer(staged(None, {"background": kind}, camera={"pan_deg_s": 12, "start_deg": -5}))
    assert other.grey(3).tobytes() == renderer.grey(3).tobytes()


# Mean luminance of four by four parts of a picture, from above and from the left.
PARTS = {
    "plane": (
        (0.8, 0.8, 0.8, 0.8), (0.8, 0.8, 0.8, 0.8),
        (0.455, 0.479, 0.422, 0.441), (0.459, 0.472, 0.489, 0.44),
    ),
    "street": (
        (0.432, 0.679, 0.655, 0.47), (0.427, 0.576, 0.578, 0.47),
        (0.48, 0.44, 0.433, 0.479), (0.361, 0.37, 0.375, 0.36),
    ),
    "forest": (
        (0.361, 0.289, 0.382, 0.323), (0.418, 0.328, 0.365, 0.38),
        (0.346, 0.317, 0.348, 0.33), (0.327, 0.273, 0.28, 0.361),
    ),
    "room": (
        (0.783, 0.794, 0.801, 0.788), (0.645, 0.725, 0.726, 0.645),
        (0.561, 0.493, 0.48, 0.534), (0.42, 0.406, 0.413, 0.423),
    ),
    "sky": (
        (0.736, 0.661, 0.761, 0.741), (0.699, 0.612, 0.804, 0.754),
        (0.561, 0.513, 0.478, 0.408), (0.58, 0.639, 0.593, 0.512),
    ),
}  # fmt: skip


@pytest.mark.parametrize("kind", SURROUNDINGS)
def test_a_seed_gives_the_same_surroundings_in_all_versions(kind: str) -> None:
    picture = Renderer(staged(None, {"background": kind})).luminance(0)
    parts = picture.reshape(4, HEIGHT // 4, 4, WIDTH // 4).mean(axis=(1, 3))
    np.testing.assert_allclose(parts, PARTS[kind], atol=0.002)


def test_there_is_no_flow_across_a_cut() -> None:
    protocol = staged(None, {"background": "room", "cut_s": 0.5}, camera={"forward_m_s": 1})
    renderer = Renderer(protocol)
    known = [np.isfinite(renderer.flow(frame)).any() for frame in (13, 14, 15)]
    assert known == [True, False, True]
    for frame in (-1, protocol.frame_count):
        with pytest.raises(StimulusError, match=f"has no frame {frame}"):
            renderer.flow(frame)


@pytest.mark.parametrize("drawing", DRAWINGS)
def test_drawings_fill_their_boxes(drawing: str) -> None:
    course = {"kind": "hovering", "distance_m": 1.0}
    protocol = staged(course, drawing=drawing, relative_luminance=1.0, scene={"background": "sky"})
    bare = Renderer(staged(None, {"background": "sky"})).luminance(0)
    changed = np.abs(Renderer(protocol).luminance(0) - bare) > 0.02
    rows, columns = np.flatnonzero(changed.any(axis=1)), np.flatnonzero(changed.any(axis=0))
    box = truth_of(protocol, 0).box_px
    assert box is not None
    found = columns[0], rows[0], columns[-1] + 1, rows[-1] + 1
    wanted = box[0], box[1], box[0] + box[2], box[1] + box[3]
    assert np.abs(np.subtract(found, wanted)).max() < 1.5


def test_a_picture_has_the_brightness_of_its_scene(tmp_path: Path) -> None:
    course = {"kind": "hovering", "distance_m": 0.5}
    wanted: dict[str, Any] = {"relative_luminance": 0.5, "display": {"background": 0.6}}
    picture = Renderer(staged(course, file=white_disk(tmp_path), **wanted)).luminance(0)
    assert picture[HEIGHT // 2, WIDTH // 2] == pytest.approx(0.3, abs=1e-3)
    ball = staged(course, **wanted)  # darker than 1, and not of one luminance
    left, top, side, _ = truth_of(ball, 0).box_px or (0, 0, 0, 0)
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    inside = np.hypot(x - left - side / 2, y - top - side / 2) < side / 2 - 1
    assert Renderer(ball).luminance(0)[inside].mean() == pytest.approx(0.3, rel=0.02)


def test_a_black_picture_stays_black_at_any_relative_luminance(tmp_path: Path) -> None:
    rgba = np.zeros((20, 20, 4), np.uint8)
    rgba[2:-2, 2:-2, 3] = 255
    cv2.imwrite(str(tmp_path / "black.png"), rgba)
    course, display = {"kind": "hovering", "distance_m": 1.0}, {"background": 0.5}
    protocol = staged(
        course, file=str(tmp_path / "black.png"), relative_luminance=2.0, display=display
    )
    picture = Renderer(protocol).luminance(0)
    assert (picture[HEIGHT // 2, WIDTH // 2], picture[0, 0]) == (0, 0.5)


def test_a_frame_is_the_same_whichever_frames_were_drawn_before() -> None:
    course = {"kind": "straight", "start_m": [-0.4, 0, 3], "velocity_m_s": [1, 0, 0]}
    protocol = staged(course, {"background": "plane"})
    renderer = Renderer(protocol)
    for index in (0, 15, 29):
        assert renderer.grey(index).tobytes() == Renderer(protocol).grey(index).tobytes()


def test_shadow_compression_and_cut_change_the_frames() -> None:
    course = {"kind": "hovering", "distance_m": 5.0}
    plain = staged(course, {"background": "plane"})
    dark = Renderer(staged(course, {"background": "plane"}, shadow=0.8)).luminance(0)
    bright = staged(course, {"background": "plane"}, relative_luminance=50.0)
    assert Renderer(bright).luminance(0).max() == 1
    change = dark - Renderer(plain).luminance(0)
    assert (1 + change / Renderer(plain).luminance(0)).min() == pytest.approx(1 - 0.8, abs=0.02)
    assert change.min() < -0.1
    assert change.max() <= 1e-6
    coded = Renderer(staged(course, {"background": "plane"}, effects={"jpeg": 20})).grey(0)
    assert 1 < np.abs(coded.astype(int) - Renderer(plain).grey(0)).mean() < 20
    cut = Renderer(staged(None, {"background": "plane", "cut_s": 0.5}))
    steps = [np.abs(cut.luminance(i + 1) - cut.luminance(i)).mean() for i in (13, 14, 15)]
    assert steps[0] == steps[2] == 0
    assert steps[1] > 0.05


# ---- Courses -------------------------------------------------------------------------------


def line(**keys: Any) -> Any:
    return Line.of(Course(**keys), 2.0, 1.5)


def test_courses_pass_the_camera_as_their_kind_says() -> None:
    hit = line(kind="collision", speed_m_s=4.0, bearing_deg=(20.0, 5.0))
    assert hit.closest() == pytest.approx((1.5, 0.0))
    for time in (0.0, 1.0, 1.4):  # its bearing stays
        x, y, z = hit.position(time)
        assert (x / z, y / z) == pytest.approx((math.tan(0.3490658), math.tan(0.0872665)))
    missed = line(
        kind="near-miss", speed_m_s=4.0, miss_sizes=1.5, side="above", bearing_deg=(10.0, 10.0)
    )
    assert missed.closest() == pytest.approx((1.5, 3.0))
    crossing = line(kind="crossing", speed_m_s=4.0, distance_m=9.0, side="right", contact_s=0.5)
    assert crossing.position(0.5) == pytest.approx((0, 0, 9))
    assert crossing.velocity(0.5) == (-4.0, 0.0, 0.0)
    overtaking = line(kind="overtaking", speed_m_s=4.0, miss_sizes=1.0, contact_s=0.5)
    assert overtaking.position(0.0) == (-2.0, 0.0, -2.0)
    assert overtaking.position(1.0) == pytest.approx((-2.0, 0.0, 2.0))
    receding = line(kind="receding", speed_m_s=4.0, distance_m=3.0)
    assert receding.closest() == (None, 3.0)
    hovering = line(kind="hovering", distance_m=3.0, sway_m=0.5)
    assert hovering.position(0.5)[0] == pytest.approx(0.5)
    # As a pendulum, it is fastest in the middle: 2 pi times the rate times the amplitude.
    assert hovering.velocity(0.0) == pytest.approx((math.pi / 2, 0, 0))
    assert hovering.velocity(0.5) == pytest.approx((0, 0, 0))


def test_braking() -> None:
    stops = line(kind="collision", speed_m_s=4.0, braking_m_s2=2.0)  # after 4 of 6 m
    assert stops.closest() == (None, pytest.approx(2.0))
    assert stops.position(9.0) == stops.position(2.0)
    assert stops.velocity(9.0) == (0, 0, 0)
    hits = line(kind="collision", speed_m_s=4.0, braking_m_s2=1.0)
    assert hits.closest()[0] == pytest.approx(2.0)
    assert hits.velocity(2.0)[2] == pytest.approx(-2.0)


def test_what_looms_is_on_course_to_hit_and_soon_there() -> None:
    course = {"kind": "collision", "speed_m_s": 2.0, "contact_s": 0.9}
    hit = staged(course, camera={"looming_within_s": 0.5})
    looming = [index for index in range(30) if truth_of(hit, index).looming]
    assert looming == list(range(12, 27))
    assert stimulus.ground_truth(hit)["contact_time_s"] == pytest.approx(0.9)
    assert truth_of(hit, 12).time_to_contact_s == pytest.approx(0.5)
    paused = staged({**course, "contact_s": 0.2}, timing={"before_s": 0.1, "motion_s": 0.5})
    assert [truth_of(paused, index).time_to_contact_s is None for index in (8, 9)] == [False, True]
    # The camera has turned away by 100 degrees at the end, and by 90 degrees in frame 15.
    turned = staged(course, camera={"start_deg": 60, "pan_deg_s": 60})
    assert [truth_of(turned, index).looming for index in (14, 16)] == [True, False]
    missed = staged({"kind": "near-miss", "speed_m_s": 2.0, "miss_sizes": 1.0})
    assert not any(truth_of(missed, index).looming for index in range(30))
    assert truth_of(missed, 0).miss_sizes == pytest.approx(1.0)
    assert truth_of(missed, 0).time_to_contact_s is None
    leaves = truth_of(staged({"kind": "receding", "speed_m_s": 2.0, "distance_m": 3.0}), 5)
    assert (leaves.miss_sizes, leaves.time_to_contact_s) == (None, None)
    # It rests after its motion, and would arrive after the clip; or has vanished before.
    late = staged({**course, "contact_s": 2.0}, timing={"motion_s": 1.0, "after_s": 0.5})
    times = [truth_of(late, index).time_to_contact_s for index in (15, 35)]
    assert times == [pytest.approx(1.5), None]
    gone: dict[str, Any] = {"timing": {"motion_s": 1.0, "after_s": 0.5}, "vanishes": "end"}
    assert stimulus.ground_truth(staged({**course, "contact_s": 1.3}, **gone))["looming"]
    grazing = {"speed_m_s": 3.0, "bearing_deg": [10.0, 10.0], "miss_sizes": 0.5}
    assert truth_of(staged({"kind": "near-miss", **grazing}), 0).time_to_contact_s == pytest.approx(
        1
    )


def test_a_picture_rests_after_its_motion() -> None:
    course = {"kind": "straight", "start_m": [0, 0, 5], "velocity_m_s": [0.5, 0, -4]}
    resting = staged(course, timing={"motion_s": 0.5, "after_s": 0.5})
    moves, *rests = (truth_of(resting, frame) for frame in (14, 15, 29))
    assert moves.edge_speed_deg_s > 0
    for truth in rests:
        assert truth.offset_m == pytest.approx((0.25, 0, 3))
        assert (truth.edge_speed_deg_s, truth.edge_speed_px_frame) == (0, 0)


def test_a_picture_behind_the_camera_is_no_larger_than_half_of_all_around() -> None:
    course = {"kind": "overtaking", "speed_m_s": 4.0, "miss_sizes": 1.0, "contact_s": 0.5}
    behind, beside = (truth_of(staged(course), frame) for frame in (5, 15))
    for truth in (behind, beside):  # 180 degrees, whatever its distance
        sizes = truth.visible, truth.edge_speed_deg_s, truth.edge_speed_px_frame
        assert sizes == (False, 0, 0)
    assert behind.offset_m[2] < -1 < beside.offset_m[2]
    behind, ahead = (truth_of(staged(course), frame) for frame in (0, 27))
    assert (behind.visible, behind.angular_size_deg) == (False, 180)
    expected = 2 * math.degrees(math.atan(0.25 / 1.6))
    assert ahead.visible
    assert ahead.angular_size_deg == pytest.approx(expected)


# ---- Videos as backgrounds, and what is refused -----------------------------------------------


# 20 frames at 20 frames/s, of 80 x 60 px.
SMALL = {"width": 80, "height": 60, "frame_rate": 20}
FOOTAGE = staged(None, {"background": "plane"}, camera={"forward_m_s": 5}, display=SMALL)


@pytest.fixture(scope="module")
def footage(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return stimulus.write(FOOTAGE, tmp_path_factory.mktemp("footage")).video


def in_footage(footage: Path, frame_rate: int = 20, **scene: Any) -> Renderer:
    display = SMALL | {"frame_rate": frame_rate}
    return Renderer(staged(None, {"background": str(footage), **scene}, display=display))


def test_a_video_is_shown_as_it_is(footage: Path) -> None:
    drawn = Renderer(FOOTAGE)
    shown = in_footage(footage)
    for index in (0, 7, 19):
        assert shown.grey(index).tobytes() == drawn.grey(index).tobytes()
    late = in_footage(footage, background_start_s=0.5, background_end="loop")
    assert late.grey(3).tobytes() == drawn.grey(13).tobytes()
    assert late.grey(12).tobytes() == drawn.grey(2).tobytes()
    # The video has its own motion blur.
    scene = {"background": str(footage)}
    blurred = staged(None, scene, display=SMALL, effects={"shutter": 1.0})
    assert Renderer(blurred).grey(7).tobytes() == drawn.grey(7).tobytes()
    doubled = in_footage(footage, 40, background_rate="own")
    assert [doubled.grey(index).tobytes() for index in (6, 7)] == [drawn.grey(3).tobytes()] * 2
    # A part of the video is enough.
    part = staged(
        None, scene | {"background_start_s": 0.5}, display=SMALL, timing={"motion_s": 0.4}
    )
    assert Renderer(part).grey(7).tobytes() == drawn.grey(17).tobytes()


def test_pictures_that_last_longer_repeat_at_their_own_times(tmp_path: Path) -> None:
    """Pictures at 0, 0.1, 0.3 and 0.4 s; the last one lasts 2/15 s, the mean of the others."""
    greys = [40, 80, 120, 160]
    video = write_video(
        tmp_path / "uneven.mkv",
        [np.full((60, 80), grey, np.uint8) for grey in greys],
        times=[0, 100, 300, 400],
        time_base=Fraction(1, 1000),
    )
    shown = in_footage(video, 30, background_rate="own", background_end="loop")
    lasts = [3, 6, 3, 4]  # frames, of which the last one begins just before 16/30 s
    found = [int(shown.grey(index).mean()) for index in range(30)]
    once = [grey for grey, count in zip(greys, lasts, strict=True) for _ in range(count)]
    assert found == (once * 2)[:30]


def test_numbered_images_are_a_video(tmp_path: Path) -> None:
    for number, grey in enumerate((30, 90, 150)):
        cv2.imwrite(str(tmp_path / f"f_{number}.png"), np.full((60, 80), grey, np.uint8))
    scene = {"background": str(tmp_path / "f_%d.png")}
    display = SMALL | {"frame_rate": 30}
    shown = Renderer(staged(None, scene, display=display, timing={"motion_s": 0.1}))
    assert [shown.grey(index).mean() for index in range(3)] == [30, 90, 150]


@pytest.mark.parametrize("rate", [16, 24, 30])
def test_a_video_whose_times_are_rounded_shows_each_picture_once(tmp_path: Path, rate: int) -> None:
    """In milliseconds, picture 2 of 30 per second comes at 0.067 s, after the display's frame."""
    display = SMALL | {"frame_rate": rate}
    camera, timing = {"forward_m_s": 5}, {"motion_s": 0.25}
    drawn = staged(None, {"background": "plane"}, camera=camera, timing=timing, display=display)
    video = stimulus.write(drawn, tmp_path, form="mkv").video
    scene = {"background": str(video)}
    shown = Renderer(staged(None, scene, timing=timing, display=display))
    count = drawn.frame_count
    pictures = [Renderer(drawn).grey(index).tobytes() for index in range(count)]
    assert [shown.grey(index).tobytes() for index in range(count)] == pictures
    again = staged(None, {**scene, "background_end": "loop"}, display=display)
    greys = [Renderer(again).grey(index).tobytes() for index in range(rate)]
    assert greys == (pictures * 5)[:rate]


def test_a_video_of_another_size_covers_the_display(footage: Path) -> None:
    scene = {"background": str(footage), "background_fit": "cover", "background_rate": "own"}
    protocol = staged(None, scene, display={"width": 100, "height": 100})
    assert Renderer(protocol).grey(0).std() > 5
    # A display of its width shows the middle of its rows.
    wide = staged(None, scene, display={"width": 80, "height": 30})
    np.testing.assert_array_equal(Renderer(wide).grey(0), Renderer(FOOTAGE).grey(0)[15:45])


def test_a_video_that_does_not_fit_into_memory_is_refused(
    footage: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(background, "_MOST_BYTES", 19 * 80 * 60)
    with pytest.raises(StimulusError, match="it does not fit into memory; shorten timing"):
        in_footage(footage, background_end="loop")
    monkeypatch.setattr(background, "_MOST_BYTES", 20 * 80 * 60)
    in_footage(footage, background_end="loop")


@pytest.mark.parametrize(
    ("scene", "rate", "said"),
    [
        ({"background_start_s": 0.05}, 20, "ends at 1 s, before the last frame"),
        ({"background_start_s": 0.5}, 20, "ends at 1 s, before the last frame"),
        ({}, 21, "it has 20 frames/s and the display 21; change display.frame_rate"),
        ({"background_rate": "own"}, 30, ""),
    ],
)
def test_a_video_that_does_not_fit_is_refused(
    footage: Path, scene: dict[str, Any], rate: int, said: str
) -> None:
    if not said:
        in_footage(footage, rate, **scene)
        return
    with pytest.raises(StimulusError, match=said) as caught:
        in_footage(footage, rate, **scene)
    assert f"scene: background = '{footage}'" in str(caught.value)


def test_a_video_of_another_size_is_refused(footage: Path) -> None:
    wanted = r"pictures are 80 x 60 px and the display has 160 x 120; .* background_fit = 'cover'"
    with pytest.raises(StimulusError, match=wanted):
        Renderer(staged(None, {"background": str(footage), "background_rate": "own"}))


def write_still(path: Path) -> NDArray[np.uint8]:
    """Write a picture of 60 rows and 80 columns without two equal neighbours; return its grey."""
    grey = np.arange(60 * 80, dtype=np.uint32).reshape(60, 80) * 7 % 251
    assert cv2.imwrite(str(path), grey.astype(np.uint8))
    return grey.astype(np.uint8)


def test_a_still_picture_is_shown_in_all_frames(tmp_path: Path) -> None:
    grey = write_still(tmp_path / "bg.png")
    shown = in_footage(tmp_path / "bg.png")
    for index in (0, 11, 19):
        np.testing.assert_array_equal(shown.grey(index), grey)
    display = {"width": 40, "height": 40}
    scene = {"background": str(tmp_path / "bg.png"), "background_fit": "cover"}
    covered = Renderer(staged(None, scene, display=display)).grey(0)
    # Scaled by 2/3 to 40 rows, the middle 40 of 53 columns.
    assert covered.shape == (40, 40)
    assert covered.mean() == pytest.approx(grey[:, 10:70].mean(), abs=1)
    edge = np.zeros((60, 80), np.uint8)
    edge[:, 60:] = 200
    assert cv2.imwrite(str(tmp_path / "bg.png"), edge)
    covered = Renderer(staged(None, scene, display=display)).grey(0)
    assert int(covered[:, :33].max()) == 0
    assert int(covered[:, 35:].min()) == 200  # the edge lies at (60 - 10) * 2 / 3


def test_a_transparent_still_picture_lies_on_the_even_ground(tmp_path: Path) -> None:
    picture = np.zeros((60, 80, 4), np.uint8)
    picture[:, 40:] = (255, 255, 255, 255)
    assert cv2.imwrite(str(tmp_path / "half.png"), picture)
    display = {"width": 80, "height": 60, "background": 0.4}
    grey = Renderer(staged(None, {"background": str(tmp_path / "half.png")}, display=display))
    assert {*grey.grey(0)[:, :40].ravel()} == {102}
    assert {*grey.grey(0)[:, 40:].ravel()} == {255}


@pytest.mark.parametrize(
    ("key", "value"),
    [("background_end", "loop"), ("background_start_s", 1), ("background_rate", "own")],
)
def test_a_still_picture_has_no_times(tmp_path: Path, key: str, value: Any) -> None:
    write_still(tmp_path / "bg.png")
    with pytest.raises(StimulusError, match=f"is a still picture; {key} goes with a video"):
        in_footage(tmp_path / "bg.png", **{key: value})
    with pytest.raises(StimulusError, match=r"are 80 x 60 px and the display has 160 x 120"):
        Renderer(staged(None, {"background": str(tmp_path / "bg.png")}))


def test_a_file_that_is_missing_is_named(tmp_path: Path) -> None:
    with pytest.raises(
        StimulusError,
        match=r"scene: background = '.*gone.mp4': cannot be read \(no such file.*; check the path$",
    ):
        Renderer(staged(None, {"background": str(tmp_path / "gone.mp4")}))
    with pytest.raises(StimulusError, match=r"cannot be read \(no .*; did you mean 'forest'\?$"):
        Renderer(staged(None, {"background": str(tmp_path / "forrest")}))
    course = {"kind": "hovering", "distance_m": 1.0}
    with pytest.raises(StimulusError, match=r"object 'thing': file = '.*gone.png'"):
        Renderer(staged(course, file=str(tmp_path / "gone.png")))


@pytest.mark.parametrize(
    ("alpha", "said"), [(255, "has no transparency"), (0, "everywhere"), (127, "everywhere")]
)
def test_a_picture_needs_transparency(tmp_path: Path, alpha: int, said: str) -> None:
    path = tmp_path / "flat.png"
    cv2.imwrite(str(path), np.full((20, 20, 4), alpha, np.uint8))
    with pytest.raises(StimulusError, match=said) as caught:
        Renderer(staged({"kind": "hovering", "distance_m": 1.0}, file=str(path)))
    assert f"object 'thing': file = '{path}'" in str(caught.value)


HIT = {"kind": "collision", "speed_m_s": 2.0}


@pytest.mark.parametrize(
    ("course", "others", "said"),
    [
        (
            {"kind": "straight", "start_m": [0, 0, -2], "velocity_m_s": [0, 0, -1]},
            {},
            "object 'thing': course: it starts 2 m behind the camera; change start_m",
        ),
        (
            HIT | {"contact_s": 1.5},
            {"timing": {"motion_s": 1.0, "after_s": 1.0}},
            r"its contact, at 1\.5 s, lies inside the pause after its motion \(1 to 2 s\)",
        ),
        (
            {"kind": "receding", "speed_m_s": 2.0, "distance_m": 1.0, "bearing_deg": [60, 0]},
            {},
            "object 'thing': it is outside the field .* in every frame; change its course",
        ),
        *(
            (
                {"kind": "hovering", "distance_m": 3.0, "bearing_deg": [0, up]},
                {},
                "object 'thing': it is outside the field .* in every frame; change its course",
            )
            for up in (-35, 35)  # just below it, and just above
        ),
        (
            {"kind": "straight", "start_m": [0, 0, 2], "velocity_m_s": [0, 0, 0]},
            {},
            "velocity_m_s is 0; use kind 'hovering'",
        ),
        (HIT, {"display": {"projection": "flat"}}, "projection must be 'perspective'"),
        (HIT, {"drawing": None}, "needs either file or drawing"),
        (HIT, {"motion": {"speed_deg_s": 2.0}}, "motion does not go with kind 'picture'"),
        (HIT, {"axis_deg": 45}, "axis_deg does not go with kind 'picture'; use course"),
        (HIT, {"centre_deg": [0, 5]}, "centre_deg does not go with kind 'picture'; use course"),
        (HIT, {"luminance": 0.3}, "luminance does not go with kind 'picture'; use relative_lum"),
        ({"kind": "collision"}, {}, "course: kind 'collision' needs speed_m_s; add it"),
        (
            HIT,
            {"scene": {"background": "a.mp4"}, "camera": {"pan_deg_s": 2.0}},
            "camera: .* need drawn surroundings; scene.background = 'a.mp4', an image or a video,",
        ),
        (HIT, {"scene": {"background": ""}}, "scene: background is empty"),
        (
            HIT,
            {"scene": {"background": "a\0.mp4"}},
            "scene: background is empty or has a zero char",
        ),
        (HIT, {"scene": {"background_end": "loop"}}, "background_end goes with a video"),
        (HIT, {"scene": {"cut_s": 0.5}}, "cut_s goes with drawn surroundings"),
    ],
)
def test_what_is_wrong_is_named_with_its_key_and_file(
    course: dict[str, Any], others: dict[str, Any], said: str
) -> None:
    with pytest.raises(StimulusError, match=f"^own.toml: .*{said}"):
        staged(course, **others)


def test_a_camera_needs_a_stage() -> None:
    table = {
        "display": {"width": 64, "height": 64, "field_of_view_deg": 60},
        "timing": {"motion_s": 1.0},
        "camera": {},
        "object": [{"id": "a", "kind": "disk", "size_deg": 5}],
    }
    with pytest.raises(StimulusError, match=r"camera goes with scene\.background"):
        stimulus.Protocol.from_table(table, "own.toml")


def test_files_are_taken_from_the_folder_of_the_protocol(tmp_path: Path, footage: Path) -> None:
    (tmp_path / "street.avi").write_bytes(footage.read_bytes())
    white_disk(tmp_path)
    own = tmp_path / "own.toml"
    own.write_text(
        "display = {width = 80, height = 60, frame_rate = 20, field_of_view_deg = 60, "
        "projection = 'perspective'}\n"
        "timing = {motion_s = 0.5}\n"
        "[[object]]\nid = 'a'\nkind = 'picture'\nfile = 'disk.png'\nsize_m = 1\n"
        "course = {kind = 'collision', speed_m_s = 3}\n"
        "[sweep]\nscene.background = ['street.avi', 'room']\n"
    )
    first, second = stimulus.load_all(own)
    assert first.scene.background == str(tmp_path / "street.avi")
    assert second.scene.background == "room"
    assert first.objects[0].file == str(tmp_path / "disk.png")
    assert Renderer(first).grey(3).std() > 5
