"""Alarms on the catalogue: what ``docs/alarms.md`` states."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from oppload_cli import open_video, stimulus
from oppload_cli.pipeline.analysis import analyse
from oppload_cli.pipeline.sources import StimulusVideo
from oppload_cli.stimulus.truth import contact_time
from tests.detection.scenes import alarms
from tests.media import write_video

if TYPE_CHECKING:
    from pathlib import Path

HEIGHT = 240
LOOM = "klapoetke2017/loom-l-over-v"
LEADS = {20: 5, 40: 9, 60: 13, 80: 16, 100: 18}  # frames before contact
EARLIEST, LEAD = 40, 3  # frames, for disks beside the middle
BESIDE = -18, 15  # deg
QUICK = (20, BESIDE), (40, (0, 0)), (100, BESIDE)
CONTROLS = (
    *("controls/translating-disk-direction", "controls/translating-disk-speed"),
    *("controls/translating-bar-speed", "controls/translating-patch", "controls/zigzag-disk"),
    *("klapoetke2017/edge", "klapoetke2017/bar-sweep"),
    *("controls/receding-disk", "controls/receding-patch", "klapoetke2017/loom-receding"),
    *("controls/texture-rotation", "controls/dots-rotation", "controls/rotating-bar"),
    *("controls/square-grating", "controls/sine-grating", "controls/grating-aperture"),
    *("klapoetke2017/grating", "controls/plaid"),
    *("controls/texture-pan", "controls/dots-drift", "controls/dots-coherence"),
    *("controls/luminance-step", "controls/luminance-ramp", "controls/flicker"),
    *("controls/flickering-disk", "controls/appearing-disk", "controls/size-steps"),
    *("controls/static-texture", "controls/camera-shake", "opplod2023/inward-motion"),
)
SOME = (
    *("controls/translating-disk-direction/rotation-0", "controls/receding-disk/l-over-v-40"),
    "controls/dots-rotation",
    *("klapoetke2017/grating/axis-0", "controls/texture-pan/direction-45"),
    *("controls/luminance-step/to-0", "controls/luminance-ramp/to-1"),
)


@pytest.mark.long
@pytest.mark.parametrize("name", SOME)
def test_a_control_gives_no_alarm(name: str) -> None:
    [protocol] = stimulus.load_all(name)
    assert alarms(StimulusVideo(protocol, HEIGHT), "opplod") == []


@pytest.mark.slow
@pytest.mark.parametrize("name", CONTROLS)
@pytest.mark.parametrize("model", ["opplod_reference", "opplod"])
def test_every_control_gives_no_alarm(name: str, model: str) -> None:
    for protocol in stimulus.load_all(name):
        assert alarms(StimulusVideo(protocol, HEIGHT), model) == [], protocol.name


MOVING, SHAKEN = "controls/looming-on-moving-texture", "controls/looming-with-shake"
SPEED, SHAKE = "ground.motion.speed_deg_s", "scene.motion.shake_deg"


def lead(name: str, model: str, **changes: float) -> float | None:
    """Return the time from the first alarm to contact in seconds; None without an alarm."""
    protocol = stimulus.load_all(name, changes)[0]
    contact_s = contact_time(protocol)
    assert contact_s
    video = StimulusVideo(protocol, HEIGHT)
    on = alarms(video, model)
    return contact_s - on[0] / float(video.facts.frame_rate or 0) if on else None


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "changes", "lead_s"),
    [
        (MOVING, {SPEED: 60}, 0.233),
        pytest.param(MOVING, {SPEED: 120}, 0.233, marks=pytest.mark.slow),
        (MOVING, {"display.frame_rate": 10}, 0.2),
        pytest.param(MOVING, {"display.frame_rate": 120}, 0.275, marks=pytest.mark.slow),
        (MOVING, {"effects.noise": 0.05}, 0.267),
        (SHAKEN, {SHAKE: 3.2}, 0.167),
    ],
)
def test_a_view_that_moves_does_not_hide_an_approach(
    name: str, changes: dict[str, float], lead_s: float
) -> None:
    """The ground moves by 15 deg/s and is seen at 30 frames/s, if nothing else is said.

    The motion of the ground hides the approach from the units alone.
    """
    assert lead(name, "opplod", **changes) == pytest.approx(lead_s, abs=0.04)
    assert lead(name, "opplod_reference", **changes) is None


@pytest.mark.long
@pytest.mark.parametrize(
    ("noise", "rate"),
    [
        (0.05, 30),
        (0.2, 30),
        (0.1, 15),
        *(pytest.param(0.1, rate, marks=pytest.mark.slow) for rate in (30, 60)),  # like the others
    ],
)
def test_noise_does_not_hide_an_approach(noise: float, rate: int) -> None:
    changes = {"effects.noise": noise, "display.frame_rate": rate}
    name = "controls/looming-noise"
    assert lead(name, "opplod", **changes) == pytest.approx(0.37, abs=0.08)
    assert lead(name, "opplod_reference", **changes) is None


NOISY = {  # controls with an alarm in noise
    0.03: {
        *("translating-bar-speed/speed-40", "translating-bar-speed/speed-80", "size-steps"),
        *("edge/rotation-45", "edge/rotation-135"),
        *("bar-sweep/rotation-0", "bar-sweep/rotation-270"),
    },
    0.1: {
        *("translating-bar-speed/speed-40", "translating-bar-speed/speed-80", "size-steps"),
        *("edge/rotation-0", "bar-sweep/rotation-0"),
    },
}


@pytest.mark.slow
@pytest.mark.parametrize("noise", NOISY)
@pytest.mark.parametrize("name", CONTROLS)
def test_controls_in_noise(name: str, noise: float) -> None:
    for protocol in stimulus.load_all(name, {"effects.noise": noise}):
        alarmed = any(protocol.name.endswith(known) for known in NOISY[noise])
        assert bool(alarms(StimulusVideo(protocol, HEIGHT), "opplod")) == alarmed, protocol.name


FAST = {  # controls with an alarm at other frame rates, as docs/time.md says
    ("opplod", 12): {"flickering-disk", "size-steps"},
    ("opplod", 24): {"bar-sweep/rotation-315"},
    ("opplod", 25): {"flickering-disk"},
    **{("opplod_reference", rate): {"translating-bar-speed/speed-80"} for rate in (12, 24, 25, 50)},
}


@pytest.mark.long
def test_a_re_encoded_pause_before_a_control_is_no_background(tmp_path: Path) -> None:
    """The encoder changes a still picture a little, and so gives small values of R."""
    [protocol] = stimulus.load_all("controls/dots-coherence/coherence-0.25")
    moving = [frame.luma for frame in StimulusVideo(protocol, HEIGHT)]
    frames = [(luma * 255).round().astype(np.uint8) for luma in [moving[0]] * 30 + moving]
    options = {"crf": "23"}
    path = write_video(
        tmp_path / "a.mp4", frames, codec="libx264", pixel_format="yuv420p", options=options
    )
    with open_video(path, height=HEIGHT) as video:
        assert alarms(video, "opplod") == []


@pytest.mark.slow
@pytest.mark.parametrize("rate", [12, 15, 20, 24, 25, 50, 60, 120])
@pytest.mark.parametrize("name", CONTROLS)
@pytest.mark.parametrize("model", ["opplod_reference", "opplod"])
def test_controls_at_other_frame_rates(name: str, model: str, rate: int) -> None:
    for protocol in stimulus.load_all(name, {"display.frame_rate": rate}):
        alarmed = any(protocol.name.endswith(known) for known in FAST.get((model, rate), ()))
        assert bool(alarms(StimulusVideo(protocol, HEIGHT), model)) == alarmed, protocol.name


@pytest.mark.long
@pytest.mark.parametrize(
    ("l_over_v", "centre"),
    [
        pytest.param(disk, centre, marks=() if (disk, centre) in QUICK else pytest.mark.slow)
        for disk in LEADS
        for centre in ((0, 0), BESIDE)
    ],
)
def test_a_looming_disk_alarms_before_contact(l_over_v: int, centre: tuple[int, int]) -> None:
    """Off the middle, at 25 and 29 % of the frame's width and height."""
    changes = {"disk.growth.l_over_v_ms": l_over_v, "disk.centre_deg": list(centre)}
    [protocol] = stimulus.load_all(LOOM, changes)
    contact = contact_time(protocol)
    assert contact is not None
    on = alarms(StimulusVideo(protocol, HEIGHT), "opplod")
    assert on
    ahead = contact * 30 - on[0]
    if centre == BESIDE:
        assert LEAD <= ahead <= EARLIEST
    else:
        assert round(ahead) == LEADS[l_over_v]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "largest", "contacts"),
    [
        ("controls/dots-coherence/coherence-0", 0.0576, 7),
        ("controls/dots-coherence/coherence-0.5", 0.0248, 0),
        ("controls/translating-disk-direction/rotation-0", 0.0013, 0),
        ("opplod2023/looming-disk-centre", 0.1616, None),
        ("opplod2023/looming-disk-off-centre", 0.1686, None),
    ],
)
def test_the_responses_from_which_the_floor_follows(
    name: str, largest: float, contacts: int | None
) -> None:
    """The largest response of OppLoD, and the frames with a time to contact."""
    [protocol] = stimulus.load_all(name)
    records = list(analyse(StimulusVideo(protocol, HEIGHT), ["opplod"], rmo=None))
    responses = [record["opplod"].response for record in records if not record.blind]
    found = max(response for response in responses if response is not None)
    assert found == pytest.approx(largest, rel=0.05, abs=1e-3)
    known = [
        record for record in records if any(one.time_to_contact_s for one in record.detections)
    ]
    assert contacts is None or len(known) == contacts
