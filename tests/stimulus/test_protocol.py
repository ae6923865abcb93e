"""Protocol files: valid ones, and the message for each mistake."""

from __future__ import annotations

import math
import tomllib
from fractions import Fraction
from typing import TYPE_CHECKING

import pytest

from oppload_cli.errors import ExitCode, StimulusError
from oppload_cli.stimulus import Display, Object, Protocol, Timing, load_all, read_entry

if TYPE_CHECKING:
    from pathlib import Path

GOOD = """
description = "a disk"
[display]
width = 100
height = 80
pixels_per_degree = 4
[timing]
before_s = 0.5
motion_s = 1.0
after_s = 0.25
[[object]]
id = "disk"
kind = "disk"
[object.growth]
kind = "approach"
l_over_v_ms = 40
"""
SIZED = GOOD.replace(
    '[object.growth]\nkind = "approach"\nl_over_v_ms = 40',
    'size_deg = 4\n[object.growth]\nkind = "edge-speed"\nspeed_deg_s = 5',
)


def protocol_of(text: str) -> Protocol:
    return Protocol.from_table(tomllib.loads(text), "my.toml")


def test_defaults_and_frame_count() -> None:
    protocol = protocol_of(GOOD)
    assert protocol.display.frame_rate == 30
    assert protocol.display.background == 1
    assert protocol.objects[0].luminance == 0
    assert protocol.frame_count == 53  # 52.5 frames: the last starts within the clip
    assert protocol.time_of(52) == 52 / 30


def test_resolved_table_makes_the_same_protocol() -> None:
    for text in (GOOD, SIZED):
        protocol = protocol_of(text)
        assert Protocol.from_table(protocol.as_table(), "again") == protocol


def test_frame_rate_is_exact() -> None:
    for written, rate in (("29.97", Fraction(2997, 100)), ('"30000/1001"', Fraction(30000, 1001))):
        text = GOOD.replace("width = 100", f"width = 100\nframe_rate = {written}")
        assert protocol_of(text).display.frame_rate == rate
    tenths = Timing(before_s=0.1, motion_s=0.2)
    display = Display(width=10, height=10, frame_rate=Fraction(10), pixels_per_degree=1)
    obj = Object(id="f", kind="field")
    # 0.1 + 0.2 is more than 0.3 in binary, and still 3 frames
    assert Protocol(display=display, timing=tenths, objects=(obj,)).frame_count == 3


def test_field_of_view() -> None:
    flat = Display(width=360, height=200, field_of_view_deg=72)
    assert flat.scale == 5
    wide = Display(width=400, height=300, field_of_view_deg=90, projection="perspective")
    assert wide.scale == pytest.approx(200 * 3.14159265358979 / 180)
    assert Display(width=8, height=8, field_of_view_deg=360).scale == 8 / 360
    with pytest.raises(StimulusError, match="must be below 179 deg"):
        Display(width=8, height=8, field_of_view_deg=179, projection="perspective")


NO_SIZES = "sizes_deg = []\ntimes_s = []"
MISTAKES = [
    # an unknown key, a missing one, a wrong type
    ("id = ", "size_dg = 3\nid = ", "size_dg", "did you mean 'size_deg'"),
    ("id = ", "size_px = 3\nid = ", "size_px", "did you mean 'size_deg'"),  # not size_m
    ("l_over_v_ms = 40", "l_over_v_ms = 40\nend_dg = 3", "end_dg", "least_deg, most_deg"),
    ('kind = "disk"', 'kind = "dsik"\nfinest = 1', "finest", "did you mean 'finest_deg'"),
    ("width = 100", "widht = 100", "widht", "did you mean 'width'"),
    ('kind = "disk"', 'kind = "dsik"', "dsik", "did you mean 'disk'"),
    ("motion_s = 1.0", "", "motion_s is missing", "add it"),
    ("motion_s = 1.0", 'motion_s = "long"', "motion_s", "takes a number"),
    ("width = 100", "width = 100.5", "width", "a whole number"),
    ("[timing]", "[timings]", "unknown key 'timings'", "did you mean 'timing'"),
    ("[timing]", "[sweeps]\n[timing]", "unknown key 'sweeps'", "did you mean 'sweep'"),
    ('"approach"\nl_over_v_ms = 40', f'"path"\n{NO_SIZES}', "sizes_deg", "at least one value"),
    # values out of range
    ("width = 100", "width = -100", "width", "at least 8 px"),
    ("width = 100", "width = 100\nframe_rate = 0", "frame_rate", "above 0 Hz"),
    ("width = 100", 'width = 100\nframe_rate = "30/0"', "frame_rate", "30000/1001"),
    ("width = 100", "width = 100\nbackground = 1.5", "background", "at most 1"),
    ("width = 100", "width = 100\nbackground = nan", "background", "finite"),
    ("pixels_per_degree = 4", "", "pixels_per_degree", "field_of_view_deg"),
    ("l_over_v_ms = 40", "l_over_v_ms = -40", "l_over_v_ms", "above 0 ms"),
    ("l_over_v_ms = 40", "", "l_over_v_ms", "add it"),
    ("l_over_v_ms = 40", "l_over_v_ms = 40\nspeed_deg_s = 3", "speed_deg_s", "edge-speed"),
    ("id = ", "size_deg = 3\nid = ", "size_deg", "remove it"),
    ("id = ", "period_deg = 3\nid = ", "period_deg", "remove it"),
    # contact inside the pauses, or before the motion's end
    ("l_over_v_ms", "contact_s = 0.3\nl_over_v_ms", "contact_s", "inside the pause before"),
    ("l_over_v_ms", "contact_s = 1.0\nl_over_v_ms", "contact_s", "before the end of its motion"),
    ("l_over_v_ms", "contact_s = 1.6\nl_over_v_ms", "contact_s", "inside the pause after"),
    # places and times
    ("id = ", "centre_deg = [40]\nid = ", "centre_deg", "2 values"),
    ("id = ", "onset_s = 2\nid = ", "onset_s", "motion_s"),
    ("id = ", "onset_s = 0.5\nduration_s = 0.6\nid = ", "onset_s + duration_s", "shorten"),
    ('id = "disk"', 'id = "display"', "display", "must be a letter"),
    ("motion_s = 1.0", "motion_s = 3600\n", "", ""),
    ("width = 100", "width = 100\nframe_rate = 5000", "", ""),
    (
        GOOD[GOOD.index("[[object]]") :],
        '[[object]]\nid = "t"\nkind = "texture"\nmotion = {zoom_per_s = -7.0}\n',
        "zoom_per_s = -7",
        "keep it below 6",
    ),
]


@pytest.mark.parametrize(("old", "new", "names", "remedy"), MISTAKES)
def test_mistakes(old: str, new: str, names: str, remedy: str) -> None:
    text = GOOD.replace(old, new, 1)
    assert text != GOOD
    if not names:
        assert protocol_of(text).frame_count > 5000
        return
    with pytest.raises(StimulusError) as caught:
        protocol_of(text)
    message = str(caught.value)
    assert message.startswith("my.toml")
    assert names in message
    assert remedy in message
    assert message.count("\n") == 0
    assert caught.value.exit_code == ExitCode.USAGE


def test_negative_sizes_and_missing_ones() -> None:
    for new, words in (("size_deg = -4", "at least 0 deg"), ("", "needs size_deg")):
        with pytest.raises(StimulusError, match=words):
            protocol_of(SIZED.replace("size_deg = 4", new))


def test_a_contact_at_the_end_of_the_motion_may_be_rounded() -> None:
    assert protocol_of(GOOD + "contact_s = 1.4999999999999998").frame_count == 53


def test_an_object_outside_of_the_field() -> None:
    for place in ("[40, 0]", "[0, -18]", "[-22, 20]"):
        text = SIZED.replace("size_deg = 4", f"size_deg = 4\ncentre_deg = {place}")
        with pytest.raises(StimulusError) as caught:
            protocol_of(text)
        assert "object 'disk': it is outside the field (25 x 20 deg)" in str(caught.value)
        assert "change centre_deg" in str(caught.value)
    wide = 2 * math.degrees(math.atan(math.radians(25 / 2)))  # the angle of a flat screen
    screen = text.replace("[timing]", 'projection = "perspective"\n[timing]')
    with pytest.raises(StimulusError, match=rf"outside the field \({wide:.4g} x "):
        protocol_of(screen)
    with pytest.raises(StimulusError, match="or of size 0 in every frame; change centre_deg, its"):
        protocol_of(GOOD[: GOOD.index("[object.growth]")] + "size_deg = 0")
    # A cross reaches only to the ends of its arms: to 7.1 deg, and it lies 8 deg outside.
    cross = SIZED.replace("size_deg = 4", "size_deg = 4\ncentre_deg = [20.5, 0]\nwidth_deg = 2")
    with pytest.raises(StimulusError, match="outside the field"):
        protocol_of(cross.replace('kind = "disk"', 'kind = "cross"'))
    # one that moves in is not outside
    moving = text + "[object.motion]\nspeed_deg_s = 30\ndirection_deg = -45\n"
    assert protocol_of(moving).frame_count > 0


def test_the_message_names_the_table_that_is_wrong() -> None:
    with pytest.raises(StimulusError, match=r"^my.toml: unknown key 'growth'"):
        protocol_of(SIZED.replace("size_deg = 4\n[object.growth]", "[growth]"))
    nameless = GOOD[GOOD.index("[[object]]") :].replace('id = "disk"\n', "")
    with pytest.raises(StimulusError, match="object number 2: id is missing; add it"):
        protocol_of(GOOD + nameless)


def test_no_objects_or_too_many_frames() -> None:
    with pytest.raises(StimulusError, match=r"no object; add one as \[\[object\]\]"):
        protocol_of(GOOD[: GOOD.index("[[object]]")])
    with pytest.raises(StimulusError, match="the most is 1000000"):
        protocol_of(GOOD.replace("width", "frame_rate = 10000\nwidth").replace("= 1.0", "= 3600"))
    with pytest.raises(StimulusError, match="two objects have the id 'disk'"):
        protocol_of(GOOD + GOOD[GOOD.index("[[object]]") :])


@pytest.mark.parametrize(
    ("kind", "keys", "words"),
    [
        ("sine-grating", {"period_deg": 4, "luminance": 0.8}, "out of 0 to 1"),
        ("plaid", {"period_deg": 4, "luminance": 0.2, "contrast": 1.5}, "out of 0 to 1"),
        ("sine-grating", {"period_deg": 4, "contrast": -0.5}, "must be at least 0, not -0.5"),
        ("sine-grating", {}, "needs period_deg"),
        ("sine-grating", {"period_deg": 1e-9}, "at least 0.001 deg"),
        ("dots", {"dot_deg": 1, "dots_per_100deg2": 1, "luminance": 0.9}, "brighter than 1"),
        ("texture", {"contrast": -0.5}, "at least 0"),
        ("bar", {"size_deg": 4}, "needs width_deg"),
        ("disk", {"size_deg": 4, "width_deg": 2}, "width_deg is not a key of kind 'disk'"),
        ("disk", {"size_deg": 4, "motion": {"zoom_per_s": 1}}, "use growth"),
        ("disk", {"size_deg": 4, "motion": {"path_s": [0, 1]}}, "same length"),
        ("disk", {"size_deg": 4, "motion": {"path_s": [1, 0], "path_deg": [[0, 0]] * 2}}, "rise"),
        (
            "disk",
            {"size_deg": 4, "growth": {"kind": "edge-speed", "speed_deg_s": 1, "sides": "forward"}},
            "for kind 'bar'",
        ),
        ("disk", {"growth": {"kind": "approach", "l_over_v_ms": 4, "least_deg": 180}}, "below"),
    ],
)
def test_mistakes_of_an_object(kind: str, keys: dict[str, object], words: str) -> None:
    with pytest.raises(StimulusError, match=words):
        Object.from_table({"id": "obj", "kind": kind, **keys}, "my.toml: object 'obj'")


def test_files(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(GOOD + "[sweep]\ndisk.growth.l_over_v_ms = [10, 40]\n")
    entry = read_entry(str(path))
    assert entry == read_entry(path)
    assert list(entry.values()) == ["mine/l-over-v-10", "mine/l-over-v-40"]
    first, second = load_all(path)
    assert (first.name, second.name) == ("mine/l-over-v-10", "mine/l-over-v-40")
    assert second.objects[0].growth is not None
    assert second.objects[0].growth.l_over_v_ms == 40


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (GOOD + "[sweep]\ndisk.axis_deg = []\n", "sweep: disk.axis_deg has no values"),
        (GOOD + "[sweep]\ndisk.axis_deg = 3\n", "takes a list of values"),
        (GOOD + "[sweep]\ndsik.axis_deg = [3]\n", "did you mean 'disk'"),
        (GOOD + "[sweep]\naxis = [3]\n", "no key 'axis'; did you mean 'disk.axis_deg'?"),
        (
            GOOD + "[sweep]\ncoherence = [3]\n",
            "no key 'coherence'; a key starts with display.KEY, timing.KEY",
        ),
        (GOOD + "[sweep]\ndisk.axes_deg = [3]\n", "did you mean 'axis_deg'"),
        ("sweep = 3\n" + GOOD, "must be a table"),
        (GOOD + "[", "not valid TOML"),
    ],
)
def test_mistakes_of_a_file(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(text)
    with pytest.raises(StimulusError, match=r"mine\.toml") as caught:
        load_all(path)
    assert words in str(caught.value)


def test_a_grating_may_be_as_bright_as_the_display() -> None:
    """In floats, 0.25 x 0.8 is above 1 - 0.8."""
    brightest = Object(id="one", kind="sine-grating", period_deg=4, luminance=0.8, contrast=0.25)
    assert brightest.contrast == 0.25


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(StimulusError, match=r"cannot be read \(no such file"):
        load_all(tmp_path / "gone.toml")
