"""What changes the picture and is no approach: frame by frame, and through an analysis."""

from __future__ import annotations

from functools import cache, partial
from itertools import product
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest

from oppload_cli.detection.alarm import AlarmParams, Cuts
from oppload_cli.pipeline.analysis import analyse
from oppload_cli.pipeline.sources import open_source
from tests.detection import scenes
from tests.detection.scenes import BEFORE, SIZE, STILL, Film, alarms
from tests.media import texture

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from tests.media import Luma

VERSIONS = ("opplod_reference", "opplod")


def changed(mean: float, share: float) -> tuple[Luma, float]:
    """P of ten by ten pixels, of which a share changes by as much as gives the mean."""
    p = np.zeros(100, np.float32)
    p[: round(100 * share)] = mean / share
    return p.reshape(10, 10), mean


def blind(changes: list[tuple[Luma, float]], rate: int = 30, **params: object) -> list[int]:
    cuts = Cuts(AlarmParams().replaced(**params))
    for t in range(20):  # the beginning is held against nothing
        cuts.step(*changed(0.01, 0.3), (t - 20) / rate)
    return [t for t, change in enumerate(changes) if cuts.step(*change, t / rate)]


MOTION = [changed(0.01, 0.3)] * 8


def test_a_cut_changes_most_of_the_frame_far_more_than_before() -> None:
    after = [*MOTION, *MOTION]
    assert blind([*MOTION, changed(0.041, 0.5), *after]) == list(range(8, 18))
    assert blind([*MOTION, changed(0.040, 0.5), *after]) == []
    assert blind([*MOTION, changed(0.041, 0.49), *after]) == []
    assert blind([*MOTION, changed(0.041, 0.5), *after], cut_ratio=4.2) == []
    assert blind([*MOTION, changed(0.041, 0.5), *after], cut_ratio=0) == []
    assert blind([*MOTION, changed(0.041, 0.3), *after], cut_share=0.3, blind_s=0.07) == [8, 9]


def test_over_a_longer_interval_the_pixels_are_compared_with_their_own_mean() -> None:
    # At 15 frames/s the mean is halved, because the interval is twice as long, but P is not.
    p, mean = changed(0.2, 0.4)
    moving = np.maximum(p, 0.03), mean / 2
    assert blind([*MOTION, moving, *MOTION], rate=15) == []
    p, mean = changed(0.2, 0.5)
    assert blind([*MOTION, (p, mean / 2), *MOTION], rate=15)[0] == len(MOTION)


def test_it_is_held_against_the_largest_of_five_frames() -> None:
    large = changed(0.02, 0.3)
    cut = changed(0.041, 0.9)
    assert blind([*MOTION, large, *MOTION[:5], cut], blind_s=0.04) == [14]
    assert blind([*MOTION, large, *MOTION[:4], cut], blind_s=0.04) == []


def test_rounded_times_do_not_decide_how_many_frames_a_cut_is_held_against() -> None:
    """Of 50 frames/s nine last for 0.18 s, in floats now a little less, now more."""
    large, small, cut = changed(0.02, 0.3), changed(0.009, 0.3), changed(0.041, 0.9)
    for before in range(10, 20):
        after = [*[small] * 8, cut]
        assert before + 9 not in blind([*[small] * before, large, *after], rate=50, blind_s=0.04)


def test_the_latest_three_changes_count_however_old_they_are() -> None:
    """Frames come once in 0.2 s, so that only one change is less than 0.18 s old."""
    large, small, cut = changed(0.02, 0.3), changed(0.009, 0.3), changed(0.041, 0.9)
    assert blind([large, small, small, cut], rate=5, hold_s=1, blind_s=0.04) == []
    assert blind([large, *[small] * 3, cut], rate=5, hold_s=1, blind_s=0.04) == [4]


def test_pixels_that_change_less_than_a_quarter_of_the_mean_do_not_count() -> None:
    p = np.full((10, 10), 0.0099, np.float32)
    p[:4] = 0.09
    assert float(p.mean()) > 0.04
    assert blind([*MOTION, (p, float(p.mean()))]) == []
    p[4] = 0.0125  # a quarter of the mean is 0.0106
    assert blind([*MOTION, (p, float(p.mean()))]) == [8]


def test_any_motion_out_of_rest_is_blind_however_small_it_is() -> None:
    rest = [changed(5e-4, 1)] * 6
    moving = [changed(0.0021, 0.05)] * 8
    assert blind([*rest, *moving]) == list(range(6, 14))
    assert blind([*rest, *moving], rest=4e-4) == []
    assert blind([*rest, *([changed(0.0019, 0.05)] * 8)]) == []


def test_a_second_cut_begins_anew() -> None:
    cut = changed(0.3, 0.9)
    assert blind([*MOTION, cut, *MOTION[:6], cut, *MOTION], blind_s=0.12) == [8, 9, 10, 15, 16, 17]


@pytest.mark.parametrize("without", ["cut_ratio", "blind_s"])
def test_without_blind_frames_the_first_frame_counts(without: str) -> None:
    p, mean = changed(0.01, 0.1)
    cuts = Cuts(AlarmParams().replaced(**{without: 0}))
    assert [cuts.step(p, change, t / 30) for t, change in enumerate((None, mean))] == ["", ""]


@pytest.mark.parametrize(
    ("rate", "stood_still", "frames"), [(30, False, 4), (10, False, 1), (10, True, 2)]
)
def test_a_video_starts_with_its_first_frame(rate: int, stood_still: bool, frames: int) -> None:
    """If the picture stood still before, motion begins at most 1/30 s before it is seen."""
    cuts = Cuts(AlarmParams(blind_s=0.15))
    p, mean = changed(0.01, 0.1)
    assert cuts.step(p, None, 0.0) == "start"
    seen = [cuts.step(p, mean, 1 / rate, stood_still=stood_still)]
    seen += [cuts.step(p, mean, t / rate) for t in range(2, 6)]
    assert seen == ["start"] * frames + [""] * (5 - frames)


def test_a_blind_frame_has_its_latest_cause() -> None:
    def causes(*events: tuple[float, float, float]) -> list[str]:
        cuts = Cuts(AlarmParams(blind_s=0.15, hold_s=0.5))
        assert cuts.step(changed(0.01, 0.3)[0], None, 0.0) == "start"
        seen = [cuts.step(*changed(0.01, 0.3), t / 10) for t in range(1, 10)]
        assert seen == ["start", *[""] * 8]
        return [cuts.step(*changed(mean, share), time_s) for time_s, mean, share in events]

    assert causes((1.0, 0.041, 0.5), (1.05, 0.01, 0.3), (1.2, 0.01, 0.3)) == ["cut", "cut", ""]
    assert causes((1.6, 0.01, 0.3)) == ["gap"]
    still = [(1 + t / 10, 0.0, 1.0) for t in range(4)]
    assert causes(*still, (1.4, 0.01, 0.3)) == [*[""] * 4, "rest"]
    assert causes((1.0, 0.041, 0.5), (1.6, 0.01, 0.3)) == ["cut", "gap"]
    # A gap is longer than the hold, and than the time in which frames are blind.
    for hold_s, blind_s in ((0.5, 0.1), (0.1, 0.5)):
        cuts = Cuts(AlarmParams(blind_s=blind_s, hold_s=hold_s, cut_ratio=0))
        times_s = (0, 0.1, 0.2, 0.7, 0.8, 1.4)
        assert [cuts.step(*changed(0.01, 0.3), time_s) for time_s in times_s] == [*[""] * 5, "gap"]


@pytest.mark.parametrize("rate", [10, 24, 25, 30, 60, 240])
def test_frames_count_again_at_the_same_time_at_any_rate(rate: int) -> None:
    found = blind([*MOTION * 20, changed(0.041, 0.5), *MOTION * 20], rate=rate)
    found = [t for t in found if t >= 160]  # the beginning is blind too
    assert found == list(range(160, 160 + len(found)))
    from_before_s = min(1 / rate, 1 / 30) + len(found) / rate
    assert 0.35 - 1e-9 <= from_before_s < 0.35 + 1 / rate - 1e-9


SCENES: dict[str, Callable[[], list[Luma]]] = {
    "a cut": scenes.cut,
    "a cut between textures": scenes.cut_between_textures,
    "a bright flash of one frame": partial(scenes.bright_flash, 1),
    "a bright flash of two frames": partial(scenes.bright_flash, 2),
    "a dark flash of one frame": partial(scenes.dark_flash, 1),
    "a dark flash of two frames": partial(scenes.dark_flash, 2),
    "a step of luminance": partial(scenes.dark_flash, scenes.AFTER),
    "every frame twice": partial(scenes.copied, 2),
    "every frame three times": partial(scenes.copied, 3),
    "one frame twice": scenes.one_copied,
    "a slow pan out of rest": lambda: scenes.out_of_rest(scenes.pan(BEFORE, 2)),
    "a pan out of rest": lambda: scenes.out_of_rest(scenes.pan(BEFORE, 4)),
    "a pan out of a rest with noise": lambda: scenes.noisy(
        scenes.out_of_rest(scenes.pan(BEFORE, 4))
    ),
}


# Each has a shorter scene of its kind.
LONGER = frozenset(
    {"a bright flash of two frames", "a dark flash of two frames", "every frame three times"}
)
# With a second detector, one scene of each kind is enough: a cut, flashes, a copy, and a rest.
LIKE = LONGER | {"a cut", "every frame twice", "a slow pan out of rest", "a pan out of rest"}


@cache
def shown_in(scene: str) -> Film:
    return Film(SCENES[scene]())


def case(scene: str, *more: str, likened: frozenset[str] = LONGER) -> Any:
    """A scene as a case of a test, which is slow if another case is like it."""
    return pytest.param(scene, *more, marks=[pytest.mark.slow] if scene in likened else [])


@pytest.mark.long
@pytest.mark.parametrize(
    ("scene", "name"),
    [
        *(case(scene, "opplod") for scene in SCENES),
        *(case(scene, "opplod_reference", likened=LIKE) for scene in SCENES),
    ],
)
def test_no_alarm(scene: str, name: str) -> None:
    assert alarms(shown_in(scene), name) == []


@pytest.mark.parametrize(
    ("scene", "name"),
    [
        # Light that changes everywhere moves nothing: OppLoD leaves it out by itself.
        *(case(scene, "opplod_reference") for scene in SCENES if "flash" in scene),
        case("a step of luminance", "opplod_reference"),
        case("a cut", "opplod"),
    ],
)
def test_there_would_be_one_without_blind_frames(scene: str, name: str) -> None:
    assert alarms(shown_in(scene), name, blind_s=0, enough_s=0)[0] == BEFORE


def test_out_of_rest_no_alarm_before_the_models_have_a_memory() -> None:
    """Patches at 8 px/frame are too fast for the units, but the first ten frames are blind."""
    moving = Film(scenes.out_of_rest(scenes.patches(12, 8, sigma=12)))
    first = set(range(STILL + 1, STILL + 11))
    assert first & set(alarms(moving, "opplod_reference", blind_s=0))
    assert not first & set(alarms(moving, "opplod_reference"))
    assert alarms(moving, "opplod", blind_s=0) == []


@pytest.mark.long
@pytest.mark.parametrize(
    ("speed", "sigma", "seed"),
    [
        (8, 6, 2),
        (12, 12, 4),
        *(
            pytest.param(*film, marks=pytest.mark.slow)
            for film in ((8, 18, 2), (8, 18, 4), (12, 12, 2))
        ),
    ],
)
def test_a_pan_that_begins_at_once_gives_no_alarm(speed: int, sigma: int, seed: int) -> None:
    """The units alone take the fast patches for an approach, but the flow does not grow."""
    moving = Film(scenes.out_of_rest(scenes.patches(40, speed, sigma, seed)))
    assert alarms(moving, "opplod") == []
    assert alarms(moving, "opplod_reference")[0] == STILL + 12


@pytest.mark.slow
@pytest.mark.parametrize(("speeds", "rise"), [((3, 4, 5, 6, 8, 10, 12), 1), ((8, 12), 12)])
def test_pans_over_patches_give_no_alarm(speeds: Sequence[int], rise: int) -> None:
    for pan in product(speeds, (6, 12, 18), range(1, 5)):
        assert alarms(Film(scenes.out_of_rest(scenes.patches(60, *pan, rise))), "opplod") == []


@pytest.mark.parametrize("name", VERSIONS)
@pytest.mark.parametrize("ground", ["white", "texture"])
def test_a_looming_disk_over_a_ground_at_rest_alarms(ground: str, name: str) -> None:
    behind = np.ones((SIZE, SIZE), np.float32)
    if ground == "texture":
        behind = 0.5 + np.float32(0.5) * texture(SIZE, SIZE, 3)
    on = alarms(Film(scenes.looming_over([behind] * 60)), name)
    # Contact is at frame 60.
    assert on
    assert 40 <= on[0] <= 52


@pytest.mark.long
@pytest.mark.parametrize("speed", [4, 8])
def test_a_looming_disk_over_a_ground_that_moves_alarms(speed: int) -> None:
    """The motion of the ground hides the disk from the units alone."""
    film = Film(scenes.looming_over(scenes.pan(60, speed)))
    on = alarms(film, "opplod")
    assert on
    assert 40 <= on[0] <= 56
    assert alarms(film, "opplod_reference") == []


@pytest.mark.long
@pytest.mark.parametrize("name", VERSIONS)
def test_a_looming_disk_after_a_cut_alarms(name: str) -> None:
    behind = np.ones((SIZE, SIZE), np.float32)
    shown = Film([*scenes.patches(BEFORE), *scenes.looming_over([behind] * 60)])
    assert BEFORE + 40 <= alarms(shown, name)[0] <= BEFORE + 52


@pytest.mark.long
@pytest.mark.parametrize("name", VERSIONS)
def test_the_beginning_of_a_video_gives_the_same_alarms(name: str) -> None:
    shown = scenes.looming_over([np.ones((SIZE, SIZE), np.float32)] * 60)
    whole = alarms(Film(shown), name)
    for end in (whole[0] + 1, 58):
        assert alarms(Film(shown[:end]), name) == [t for t in whole if t < end]


@pytest.mark.parametrize("lost", [5, 6, 9, 12])
def test_lost_frames_in_noise_are_no_cut(lost: int) -> None:
    """The change over a gap is per interval, and so small: the next one must not pass for a cut."""
    cuts = Cuts(AlarmParams())
    for t in range(-20, 0):
        cuts.step(*changed(0.005, 1.0), t / 30)
    after = (lost + 1) / 30
    assert not cuts.step(*changed(0.005 / (lost + 1), 1.0), after)
    assert not any(cuts.step(*changed(0.011, 1.0), after + t / 30) for t in range(1, 5))


@pytest.mark.slow
def test_light_that_flickers_hides_an_approach_from_what_does_not_leave_it_out() -> None:
    """P is the change of luminance: lamps at 100 Hz before 30 frames/s change all of it."""
    with open_source("controls/looming-perspective", height=240) as frames:
        lumas = np.stack([frame.luma for frame in frames])
    peaks = {}
    for share in (0.0, 0.02, 0.1):
        light = 1 + share * np.cos(2 * np.pi * 100 * np.arange(len(lumas)) / 30)
        shown = lumas * light[:, None, None].astype(np.float32) / (1 + share)
        names = ("opplod", "dlgmd", *(() if share == 0.02 else ("opplod_reference",)))
        records = list(analyse(shown, names, rate=30, rmo=False))
        for name in names:
            responses = [record[name].response for record in records]
            peaks[name, share] = max(value for value in responses if value is not None)
    kept = {key: peak / peaks[key[0], 0.0] for key, peak in peaks.items()}
    assert kept["opplod", 0.02] == pytest.approx(0.94, abs=0.03)
    assert kept["opplod", 0.1] == pytest.approx(0.45, abs=0.05)
    assert kept["opplod_reference", 0.1] == pytest.approx(0.003, abs=0.002)
    assert kept["dlgmd", 0.1] == pytest.approx(0, abs=1e-4)


def shaken_alarms(name: str, width: int, sigma: float, seed: int) -> int:
    """Return the number of alarms before patches of a width, seen by a shaking camera."""
    ground = scenes.patches(1, 1, width, seed)[0][:, :SIZE]
    on = alarms(Film(scenes.shaken(ground, 90, sigma, seed)), name)
    return sum(frame - 1 not in on for frame in on)


@pytest.mark.long
def test_a_jerk_of_the_camera_starts_no_alarm() -> None:
    """A shaking camera sets off the units, but the flow does not grow about a place for long."""
    assert shaken_alarms("opplod_reference", 4, 5, 2) == 1
    assert shaken_alarms("opplod", 4, 5, 2) == 0


@pytest.mark.slow
@pytest.mark.parametrize(("sigma", "by_units"), [(2, 0), (3, 0), (5, 21)])
def test_jerks_start_alarms_of_the_units_alone(sigma: float, by_units: int) -> None:
    films = list(product((4, 8, 16), (sigma,), range(8)))
    counts = [sum(shaken_alarms(name, *film) for film in films) for name in VERSIONS]
    assert counts == [by_units, 0]


def passing(seed: int, bar: int) -> Film:
    """A textured square that crosses a texture, with bars of so many pixels at both sides."""
    random = np.random.default_rng(seed)
    ground = 0.3 + 0.6 * texture(SIZE, SIZE, seed)
    side, speed = int(random.integers(40, 100)), float(random.uniform(3, 13))
    surface = 0.05 + 0.3 * texture(SIZE, SIZE, seed + 50)[:side, :side]
    top = int(random.integers(0, SIZE - side))
    frames = []
    for t in range(30 + int((SIZE + side) / speed)):
        move = np.array([[1, 0, speed * max(0, t - 30) - side], [0, 1, top]], np.float32)
        covered = cv2.warpAffine(np.ones_like(surface), move, (SIZE, SIZE))
        luma = ground * (1 - covered) + cv2.warpAffine(surface, move, (SIZE, SIZE))
        luma += random.normal(0, 0.003, luma.shape)
        if bar:
            luma[:, :bar] = luma[:, -bar:] = 0.06
        frames.append(np.clip(luma, 0, 1).astype(np.float32))
    return Film(frames)


@pytest.mark.slow
def test_objects_that_pass_between_bars_cause_no_alarm() -> None:
    """An edge that comes out from behind a bar meets no inhibition, as at the frame's edge."""
    counts = {
        bar: sum(bool(alarms(passing(n, bar), "opplod")) for n in range(12)) for bar in (0, 40)
    }
    assert counts == {0: 0, 40: 0}
