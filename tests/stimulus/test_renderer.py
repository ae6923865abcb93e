"""Pixels: areas, smooth motion, effects, and the same bytes every time."""

from __future__ import annotations

import dataclasses
import hashlib
import itertools
import math
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from oppload_cli import stimulus
from oppload_cli.errors import StimulusError
from oppload_cli.stimulus import Brightness, Effects, Growth, Motion, Object, Renderer, Scene
from oppload_cli.stimulus.coverage import disk_coverage
from oppload_cli.stimulus.geometry import Projection
from tests.cli.process import python
from tests.stimulus.measuring import made


def dark_area(frame: stimulus.StimulusFrame) -> float:
    return float((1 - frame.luma.astype(np.float64)).sum())


@pytest.mark.parametrize("centre", [(0.31, -0.17), (0.0, 0.0)])
def test_area_of_a_growing_disk_at_every_frame(centre: tuple[float, float]) -> None:
    """After rounding to 8 bits within 0.3 % from a radius of 2 px on, within 0.1 % from 5 px on.

    In the middle of the display, pixels in all eight directions are rounded to the same side.
    """
    growth = Growth(kind="edge-speed", speed_deg_s=14.7)
    disk = Object(id="disk", kind="disk", size_deg=0.8, centre_deg=centre, growth=growth)
    for frame in stimulus.frames(made(disk)):
        size = frame.truth.objects[0].angular_size_deg
        assert size is not None
        radius = size * 5 / 2
        within = 1e-3 if radius >= 5 else 3e-3
        assert dark_area(frame) == pytest.approx(math.pi * radius**2, rel=within)


@pytest.mark.parametrize("exponent", [0, 1, 2])
def test_a_patch_has_its_mean_and_its_contrast_at_every_size(exponent: float) -> None:
    growth = Growth(kind="path", sizes_deg=(28,), times_s=(0.5,))
    values: dict[str, Any] = {"luminance": 0.5, "contrast": 0.3, "exponent": exponent}
    patch = Object(id="patch", kind="patch", size_deg=12, growth=growth, **values)
    for frame in stimulus.frames(made(patch)):
        size = frame.truth.objects[0].angular_size_deg
        assert size is not None
        x, y = (np.arange(side) + 0.5 - side / 2 for side in frame.luma.shape[::-1])
        inside = frame.luma[np.hypot(x, y[:, None]) < size * 5 / 2 - 0.7]
        assert inside.mean() == pytest.approx(0.5, rel=0.015)
        assert inside.std() == pytest.approx(0.15, rel=0.05)


@pytest.mark.parametrize("axis", [0, 17, 45, 90, 123])
def test_area_of_a_turned_bar_at_every_frame(axis: float) -> None:
    growth = Growth(kind="edge-speed", speed_deg_s=9.3, end_deg=28)
    bar = Object(
        id="bar",
        kind="bar",
        size_deg=3,
        width_deg=4.1,
        axis_deg=axis,
        centre_deg=(0.13, 0.29),
        growth=growth,
    )
    for frame in stimulus.frames(made(bar, seconds=1.5)):
        size = frame.truth.objects[0].angular_size_deg
        assert size is not None
        assert dark_area(frame) == pytest.approx(size * 4.1 * 25, rel=1e-3)


@pytest.mark.parametrize(
    ("kind", "keys", "area"),
    [
        ("square", {"size_deg": 10}, 100.0),
        ("cross", {"size_deg": 16, "width_deg": 3}, 2 * 16 * 3 - 9.0),
        ("cross", {"size_deg": 6, "width_deg": 9}, 36.0),
        ("ring", {"size_deg": 12, "width_deg": 2}, math.pi * (36 - 16)),
        ("ring", {"size_deg": 12, "width_deg": 7}, math.pi * 36),
    ],
)
def test_area_of_the_other_shapes(kind: str, keys: dict[str, float], area: float) -> None:
    shape = Object.from_table({"id": "f", "kind": kind, "axis_deg": 30, **keys}, "")
    frame = next(stimulus.frames(made(shape, scene=Scene(centre_deg=(1.1, -0.7)))))
    assert dark_area(frame) == pytest.approx(area * 25, rel=1e-3)


@pytest.mark.parametrize("axis", [0, 30, 45, 77, 90])
@pytest.mark.parametrize("pixels_per_frame", [1.0, 1.37, 2.0, 3.3])
def test_sum_of_p_is_constant_for_an_edge(axis: float, pixels_per_frame: float) -> None:
    """Within 0.5 % from 1 px/frame on; below, one grey level is more than that."""
    bar = Object(
        id="bar",
        kind="bar",
        size_deg=8,
        width_deg=24,
        axis_deg=axis,
        growth=Growth(kind="edge-speed", speed_deg_s=pixels_per_frame * 30 / 5, sides="forward"),
    )
    frames = [frame.luma.astype(np.float64) for frame in stimulus.frames(made(bar, seconds=0.5))]
    sums = [np.abs(after - before).sum() for before, after in itertools.pairwise(frames)]
    np.testing.assert_allclose(sums, 24 * 5 * pixels_per_frame, rtol=5e-3)


def test_sub_pixel_motion_is_smooth_before_rounding() -> None:
    bar = Object(
        id="bar",
        kind="bar",
        size_deg=8,
        width_deg=16,
        axis_deg=11,
        growth=Growth(kind="edge-speed", speed_deg_s=0.137 * 30 / 5),
    )
    renderer = Renderer(made(bar))
    frames = [renderer.luminance(index).astype(np.float64) for index in range(30)]
    sums = [np.abs(after - before).sum() for before, after in itertools.pairwise(frames)]
    np.testing.assert_allclose(sums, 2 * 16 * 5 * 0.137, rtol=1e-4)


def test_directions_are_counter_clockwise_and_y_grows_down() -> None:
    disk = Object(
        id="disk",
        kind="disk",
        size_deg=4,
        motion=Motion(speed_deg_s=10, direction_deg=90),
        centre_deg=(5, 0),
    )
    protocol = made(disk)
    last = list(stimulus.frames(protocol))[-1]
    rows, columns = np.nonzero(last.grey < 128)
    truth = last.truth.objects[0]
    assert columns.mean() + 0.5 == pytest.approx(truth.centre_x_px, abs=0.05)
    assert rows.mean() + 0.5 == pytest.approx(truth.centre_y_px, abs=0.05)
    assert truth.centre_x_px == 125
    assert truth.centre_y_px == pytest.approx(90 - 5 * 10 * 29 / 30)


def test_luminance_is_the_grey_level_over_255() -> None:
    for frame in stimulus.frames(stimulus.load("controls/looming-patch")):
        assert frame.luma.dtype == np.float32
        np.testing.assert_array_equal(frame.luma, frame.grey.astype(np.float32) / np.float32(255))
        break


def test_objects_cover_one_another_in_order() -> None:
    back = Object(id="back", kind="square", size_deg=20, luminance=0.2)
    front = Object(id="front", kind="square", size_deg=10, luminance=0.6)
    grey = next(stimulus.frames(made(back, front))).grey
    assert grey[90, 100] == 153
    assert grey[90, 60] == 51
    assert grey[5, 5] == 255


DOTS = {"dot_deg": 20, "dots_per_100deg2": 20, "luminance": 0.2, "contrast": -0.5}


@pytest.mark.parametrize(
    ("kind", "values"),
    [*((kind, {"size_deg": 10}) for kind in ("disk", "square", "field")), ("dots", DOTS)],
)
def test_an_object_has_the_grey_level_of_its_luminance_on_every_ground(
    kind: str, values: dict[str, Any]
) -> None:
    obj = Object(**{"id": "o", "kind": kind, "luminance": 0.1, **values})
    for ground in (0.0, 0.3, 0.5, 1.0):
        grey = Renderer(made(obj, display={"background": ground})).grey(0)
        assert grey[90, 100] == 26  # 25.5, rounded half to even


def test_invert_swaps_dark_and_light() -> None:
    disk = Object(id="disk", kind="disk", size_deg=9.7)
    plain, inverted = (
        next(stimulus.frames(made(disk, effects=Effects(invert=invert)))).grey.astype(int)
        for invert in (False, True)
    )
    np.testing.assert_array_equal(plain + inverted, 255)


def test_noise_has_the_stated_spread_and_differs_from_frame_to_frame() -> None:
    field = Object(id="field", kind="field", luminance=0.5)
    protocol = made(field, effects=Effects(noise=0.05), seed=3)
    first, second = (Renderer(protocol).luminance(index) for index in (0, 1))
    assert first.std() == pytest.approx(0.05, rel=0.02)
    assert np.corrcoef(first.ravel(), second.ravel())[0, 1] == pytest.approx(0, abs=0.02)
    other = Renderer(dataclasses.replace(protocol, seed=4)).luminance(0)
    assert not np.array_equal(first, other)


def test_motion_blur_averages_over_the_open_shutter() -> None:
    bar = Object(id="bar", kind="bar", size_deg=8, width_deg=16, motion=Motion(speed_deg_s=24))
    frame = Renderer(made(bar, effects=Effects(shutter=1.0, shutter_samples=64))).luminance(10)
    # 4 px/frame: the edges become ramps of 4 px whose middle is where the edge would be
    row = 1 - frame[90].astype(np.float64)
    assert row.sum() == pytest.approx(40, rel=1e-3)
    middle = (row * (np.arange(200) + 0.5)).sum() / row.sum()
    assert middle == pytest.approx(100 + 4 * 10, abs=0.02)
    assert np.count_nonzero((row > 0.01) & (row < 0.99)) == 8


def test_aperture_and_background() -> None:
    grating = Object(
        id="g", kind="sine-grating", period_deg=4, size_deg=20, motion=Motion(speed_deg_s=9)
    )
    frames = [frame.grey for frame in stimulus.frames(made(grating))]
    assert all(np.all(grey[:, :45] == 255) for grey in frames)
    assert frames[5][90].min() < 20


WIDE = {"field_of_view_deg": 100, "projection": "perspective"}


def test_perspective_is_the_tangent() -> None:
    eye = 150 / math.tan(math.radians(50))
    disk = Object(id="disk", kind="disk", size_deg=30, centre_deg=(25, 0))
    frame = next(stimulus.frames(made(disk, display={"width": 300, "height": 300, **WIDE})))
    radius = eye * math.tan(math.radians(15))
    assert dark_area(frame) == pytest.approx(math.pi * radius**2, rel=1e-3)
    assert frame.truth.objects[0].centre_x_px == pytest.approx(
        150 + eye * math.tan(math.radians(25))
    )
    ring = dataclasses.replace(disk, kind="ring", width_deg=5)
    frame = next(stimulus.frames(made(ring, display={"width": 300, "height": 300, **WIDE})))
    hole = eye * math.tan(math.radians(10))
    assert dark_area(frame) == pytest.approx(math.pi * (radius**2 - hole**2), rel=1e-3)


def test_in_perspective_a_point_lies_in_its_direction_at_the_tangent_of_its_eccentricity() -> None:
    disk = Object(id="d", kind="disk", size_deg=2, centre_deg=(12, 9))
    truth = stimulus.frame_truth(made(disk, display={"projection": "perspective"}), 0).objects[0]
    away = 5 * 180 / math.pi * math.tan(math.radians(15))
    assert truth.centre_x_px == pytest.approx(100 + away * 12 / 15)
    assert truth.centre_y_px == pytest.approx(90 - away * 9 / 15)


@pytest.mark.parametrize(("axis", "covered"), [(0, "left"), (90, "lower"), (180, "right")])
def test_an_edge_covers_what_lies_behind_it(axis: float, covered: str) -> None:
    """Also if its point is far away from the display, where it covers all of it, or nothing."""
    x, y = np.meshgrid(np.arange(200) + 0.5 - 100, 90 - np.arange(180) - 0.5)
    dark = {"left": x < 0, "lower": y < 0, "right": x > 0}[covered]
    edge = Object(id="e", kind="edge", axis_deg=axis)
    np.testing.assert_array_equal(Renderer(made(edge)).grey(0) == 0, dark)
    along = math.cos(math.radians(axis)), math.sin(math.radians(axis))
    for degrees in (-300, 300):
        far = dataclasses.replace(edge, centre_deg=(degrees * along[0], degrees * along[1]))
        assert (Renderer(made(far)).grey(0) == (0 if degrees > 0 else 255)).all()


def test_perspective_warps_patterns_the_same_way() -> None:
    """A cycle of a grating spans its angle wherever it is: edges lie at f tan(angle)."""
    grating = Object(id="g", kind="square-grating", period_deg=20)
    protocol = made(grating, display={"width": 400, "height": 40, **WIDE})
    row = Renderer(protocol).luminance(0)[20]
    crossings = np.nonzero(np.diff((row > 0.5).astype(int)))[0] + 1
    eye = 200 / math.tan(math.radians(50))
    expected = [200 + eye * math.tan(math.radians(angle)) for angle in range(-40, 41, 10)]
    np.testing.assert_allclose(crossings, expected, atol=1.0)


@pytest.mark.parametrize("moves", ["object", "scene"])
def test_an_aperture_turns_and_shifts_with_the_scene_and_then_stays(moves: str) -> None:
    """The truth says where it is: (64, 34) px of 80 x 60, at 2 px/deg."""
    motion = Motion(speed_deg_s=9)
    field = Object(
        id="f",
        kind="field",
        size_deg=8,
        luminance=0.0,
        centre_deg=(15, 0),
        motion=motion if moves == "object" else None,
    )
    scene = Scene(
        centre_deg=(12, -17), rotation_deg=90, motion=motion if moves == "scene" else None
    )
    protocol = made(field, display={"width": 80, "height": 60, "pixels_per_degree": 2}, scene=scene)
    for frame in (0, 20):
        rows, columns = np.nonzero(Renderer(protocol).grey(frame) < 128)
        truth = stimulus.frame_truth(protocol, frame).objects[0]
        assert (truth.centre_x_px, truth.centre_y_px) == pytest.approx((64, 34))
        assert (columns.mean() + 0.5, rows.mean() + 0.5) == pytest.approx((64, 34))


@pytest.mark.parametrize("kind", ["sine-grating", "square-grating", "plaid"])
@pytest.mark.parametrize(("size", "place"), [(0.4, (0.25, 0.25)), (10, (-23.3, 0)), (10, (0, 19))])
def test_an_aperture_shows_the_pixels_of_the_whole_grating(
    kind: str, size: float, place: tuple[float, float]
) -> None:
    """Also where it has one pixel, or reaches the display by one column or row."""
    display = {"width": 80, "height": 60, "pixels_per_degree": 2, "projection": "perspective"}
    whole = Object(id="g", kind=kind, period_deg=7, centre_deg=place)
    part = dataclasses.replace(whole, size_deg=size)
    full, seen = (Renderer(made(obj, display=display)).luminance(0) for obj in (whole, part))
    projection = Projection.of(made(part, display=display).display)
    window, covered = disk_coverage(*projection.to_px(*place), projection.reach(size / 2), 60, 80)
    assert 1 in window.shape
    expected = np.ones_like(full)
    expected[window.slices] += (full[window.slices] - 1) * covered.astype(np.float32)
    np.testing.assert_allclose(seen, expected, atol=1e-6)


def test_zoomed_dots_flow_outward() -> None:
    dots = Object(
        id="dots",
        kind="dots",
        dot_deg=1,
        dots_per_100deg2=1,
        contrast=-1,
        motion=Motion(zoom_per_s=0.5),
    )
    protocol = made(dots)
    renderer = Renderer(protocol)
    first, later = renderer.luminance(0), renderer.luminance(15)
    scale = math.exp(0.25)
    rows, columns = np.nonzero(first < 0.05)
    moved_rows = (rows + 0.5 - 90) * scale + 90
    moved_columns = (columns + 0.5 - 100) * scale + 100
    inside = (abs(moved_rows - 90) < 85) & (abs(moved_columns - 100) < 95)
    values = later[moved_rows[inside].astype(int), moved_columns[inside].astype(int)]
    assert inside.sum() > 50
    # a dot moved outward is at its expected place or next to it
    assert np.mean(values < 0.5) > 0.8


@pytest.mark.long
def test_turned_and_shrunk_dots_reach_the_corners() -> None:
    dots = Object(
        id="dots", kind="dots", dot_deg=1, dots_per_100deg2=400, contrast=-1, luminance=1.0
    )
    shrinks = dataclasses.replace(dots, motion=Motion(zoom_per_s=-1.0))
    turned = Renderer(made(dots, scene=Scene(rotation_deg=45))).luminance(0)
    shrunk = Renderer(made(shrinks)).luminance(29)
    for shown in (turned, shrunk):
        corners = shown[[*range(9), *range(-9, 0)]][:, [*range(9), *range(-9, 0)]]
        for corner in (corners[:9, :9], corners[:9, 9:], corners[9:, :9], corners[9:, 9:]):
            assert corner.mean() < 0.3  # dots cover 1 - exp(-4 pi / 4) of the display


def test_dots_that_reach_into_the_display_are_drawn() -> None:
    """Two dots to the square degree leave exp(-pi / 2) of the display, also along its borders."""
    dots = Object(
        id="dots", kind="dots", dot_deg=1, dots_per_100deg2=200, contrast=-1, luminance=1.0
    )
    shown = Renderer(made(dots)).luminance(0)
    for lines in (shown[[0, -1]], shown[:, [0, -1]]):
        assert lines.mean() == pytest.approx(math.exp(-math.pi / 2), abs=0.1)


@pytest.mark.parametrize(
    "values",
    [
        {"kind": "disk", "size_deg": 9, "brightness": Brightness(kind="ramp", to=0.8)},
        {"kind": "bar", "size_deg": 9, "width_deg": 3, "motion": Motion(rotation_deg_s=30)},
        {"kind": "disk", "size_deg": 9, "motion": Motion(speed_deg_s=3)},
        {"kind": "disk", "size_deg": 9, "growth": Growth(kind="edge-speed", speed_deg_s=3)},
        {"kind": "texture", "contrast": 0.3, "motion": Motion(zoom_per_s=1)},
    ],
)
def test_no_change_of_an_object_leaves_the_picture_of_before(values: dict[str, Any]) -> None:
    protocol = made(Object(id="o", **values))
    renderer = Renderer(protocol)
    before, after = renderer.luminance(5).copy(), renderer.luminance(8)
    assert not np.array_equal(after, before)
    np.testing.assert_array_equal(after, Renderer(protocol).luminance(8))


def test_texture_moves_with_its_stated_speed() -> None:
    ground = Object(id="g", kind="texture", contrast=0.3, motion=Motion(speed_deg_s=12))
    renderer = Renderer(made(ground, seed=5))
    # 12 deg/s at 5 px/deg and 30 Hz: 2 px/frame
    first, fourth = renderer.luminance(0), renderer.luminance(4)
    np.testing.assert_allclose(first[:, :-8], fourth[:, 8:], atol=1e-4)


def test_texture_falls_as_one_over_frequency() -> None:
    ground = Object(id="g", kind="texture", contrast=0.15, finest_deg=0.4)
    protocol = made(ground, display={"width": 256, "height": 256}, seed=1)
    picture = Renderer(protocol).luminance(0).astype(np.float64)
    assert picture.mean() == pytest.approx(0.5, abs=0.01)
    assert picture.std() == pytest.approx(0.075, rel=0.05)
    power = np.abs(np.fft.rfft2(picture - picture.mean())) ** 2
    frequency = np.hypot(np.fft.fftfreq(256)[:, None], np.fft.rfftfreq(256)[None, :])
    middle = (frequency > 0.02) & (frequency < 0.15)
    slope = np.polyfit(np.log(frequency[middle]), np.log(power[middle]), 1)[0]
    assert slope == pytest.approx(-2, abs=0.25)


@pytest.mark.long
def test_same_bytes_in_another_process() -> None:
    names = (
        "klapoetke2017/bar-expand-10/axis-45",
        "controls/camera-shake/shake-1",
        "controls/dots-coherence/coherence-0.25",
        "controls/looming-noise/noise-0.1",
    )
    code = (
        "import hashlib, sys\n"
        "from oppload_cli import stimulus\n"
        "for name in sys.argv[1:]:\n"
        "    protocol = stimulus.load(name)\n"
        "    for index in (0, 9, 20):\n"
        "        picture = stimulus.Renderer(protocol).grey(index).tobytes()\n"
        "        print(name, index, hashlib.sha256(picture).hexdigest())\n"
    )
    there = python(code, *names).stdout.splitlines()
    assert len(there) == 12
    for name in names:
        renderer = Renderer(stimulus.load(name))
        # another order, and one renderer for all: a frame does not depend on those before it
        for index in (20, 0, 9):
            digest = hashlib.sha256(renderer.grey(index).tobytes()).hexdigest()
            assert f"{name} {index} {digest}" in there


def test_frame_times_are_exact() -> None:
    rate = Fraction(30000, 1001)
    protocol = made(Object(id="f", kind="field"), display={"frame_rate": rate})
    times = [frame.time_s for frame in stimulus.frames(protocol)]
    assert times == [float(Fraction(index * 1001, 30000)) for index in range(30)]


def test_too_many_dots_are_an_error() -> None:
    dots = Object(id="dots", kind="dots", dot_deg=0.1, dots_per_100deg2=10_000)
    protocol = made(dots, display={"field_of_view_deg": 360})
    with pytest.raises(StimulusError, match="object 'dots': dots_per_100deg2 = 10000 makes"):
        next(stimulus.frames(protocol))


@pytest.mark.parametrize("shape", [{"kind": "square"}, {"kind": "bar", "width_deg": 20}])
def test_a_shape_of_which_one_corner_enters_the_display_is_drawn(shape: dict[str, Any]) -> None:
    """Turned by 45 degrees, it reaches sqrt(2) times half of its side: 2 deg into the display."""
    x = 20 + 10 * math.sqrt(2) - 2
    turned = Object(id="s", size_deg=20, axis_deg=45, centre_deg=(x, 0), **shape)
    frame = next(stimulus.frames(made(turned)))
    assert dark_area(frame) == pytest.approx(2 * 2 * 25, rel=1e-2)


def test_a_name_is_no_stimulus() -> None:
    name: Any = "controls/size-steps"
    for call in (stimulus.Renderer, stimulus.ground_truth, lambda given: stimulus.write(given, "")):
        with pytest.raises(StimulusError, match=r"str: is no stimulus; give what .*load returns"):
            call(name)


def test_a_frame_is_found_in_a_list() -> None:
    protocol = made(Object(id="f", kind="field"))
    first, again = (next(stimulus.frames(protocol)) for _ in range(2))
    assert [first, again].index(again) == 1


@pytest.mark.parametrize("frame", [-1, 30])
def test_a_frame_outside_the_clip_is_refused(frame: int) -> None:
    """Without this check, -1 would be a frame before the first one, not the last one."""
    protocol = made(Object(id="disk", kind="disk", size_deg=10.0))
    assert protocol.frame_count == 30
    with pytest.raises(StimulusError, match=rf"has no frame {frame}; give a number from 0 to 29"):
        Renderer(protocol).grey(frame)
    with pytest.raises(StimulusError, match=rf"has no frame {frame}; give a number from 0 to 29"):
        stimulus.frame_truth(protocol, frame)
