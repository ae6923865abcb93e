from __future__ import annotations

import csv
import json
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from oppload_cli import analyse, open_video
from oppload_cli.errors import OpploadError, ParameterError, StimulusError
from oppload_cli.models.opplod import OpplodResponse
from oppload_cli.pipeline.settings import resolve
from oppload_cli.stimulus import write
from oppload_cli.stimulus.catalogue import find, read_entry
from oppload_cli.stimulus.renderer import Renderer
from oppload_cli.tuning.measuring import doubts_about, faint, tune, tuning_sidecar, tuning_text
from oppload_cli.tuning.present import Condition, Measures, Responses, measure, present
from oppload_cli.tuning.sweeps import Sweep, parsed_over, sweeps
from tests.assigned import assigned
from tests.results.make import rows_of

if TYPE_CHECKING:
    from pathlib import Path

    from oppload_cli.pipeline.settings import Settings
    from oppload_cli.stimulus.catalogue import Entry
    from oppload_cli.tuning.measuring import Doubt

DISK = """
[display]
width = 80
height = 60
frame_rate = 25
pixels_per_degree = 2
[timing]
before_s = {before}
motion_s = 0.6
[[object]]
id = "disk"
kind = "disk"
size_deg = 2
centre_deg = [3, 1]
[object.growth]
kind = "edge-speed"
speed_deg_s = 25
[sweep]
disk.growth.speed_deg_s = [15, 25, 35]
"""


def disk(tmp_path: Path, before: float = 0) -> Entry:
    path = tmp_path / "disk.toml"
    path.write_text(DISK.format(before=before))
    return read_entry(path)


def swept(stimulus: str, over: list[str]) -> Entry:
    (one,) = sweeps(stimulus, (), {}, parsed_over(over), {})
    return one.entry


ASSIGNED = assigned(
    "opplod.receptive_field=24", "opplod.cell=2", "repeats.longest_s=0.04", "time.interval=frame"
)
EDGE = find("klapoetke2017/edge")[0].protocols()[0]  # without a size and without a contact


# A pause makes repeats, which `oppload run` skips: the numbers must be the same here.
@pytest.mark.parametrize(
    ("height", "before"),
    [
        # Each height and each pause at least once.
        pytest.param(height, before, marks=() if quick else pytest.mark.slow)
        for row, height in enumerate(("native", "48", "90"))
        for column, before in enumerate((0, 0.12, 0.4))
        for quick in [row == column or row + column == 2]
    ],
)
def test_the_numbers_are_those_of_a_run_over_the_video(
    before: float, height: str, tmp_path: Path
) -> None:
    settings = resolve(height=height, assignments=ASSIGNED)
    protocol = disk(tmp_path, before).protocols()[1]
    shown = present(protocol, settings)
    with open_video(write(protocol, tmp_path).video, height=settings.pixels) as video:
        params = settings.model_params()
        time = settings.time
        records = list(analyse(video, params, repeats=settings.repeats, rmo=None, time=time))
    for model, responses in shown.items():
        answers = [record[model].answer for record in records]
        expected = [np.nan if each is None else each.response for each in answers]
        np.testing.assert_array_equal(responses.response, expected)
    np.testing.assert_array_equal(shown["opplod"].time_s, [r.time_s for r in records])
    best = shown["opplod"].peak
    assert best is not None
    answer = records[best]["opplod"].answer
    assert isinstance(answer, OpplodResponse)
    assert answer.box is not None
    x, y = answer.box.x + answer.box.width / 2, answer.box.y + answer.box.height / 2
    np.testing.assert_allclose(shown["opplod"].centre[best], [x, y])
    # The disk is 3 deg right and 1 deg up of the middle, at 2 px/deg.
    np.testing.assert_allclose([x, y], [46, 28], atol=3)


def test_measures_of_known_responses() -> None:
    time = np.array([0.0, 0.1, 0.2, 0.4, 0.5])
    response = np.array([np.nan, 0.0, 0.3, 1.0, 0.5])
    box = np.array([[np.nan] * 4] * 3 + [[5.0, 6.0, 4.0, 4.0], [9.0, 9.0, 0.0, 0.0]])
    got = measure(Responses(np.arange(5.0), time, response, box), EDGE)
    area = 0.1 * 0.15 + 0.2 * 0.65 + 0.1 * 0.75
    assert got.area == pytest.approx(area)
    assert got == Measures(1.0, 3, 0.4, 0.45, got.area, 2, 0.2, 7.0, 8.0)


def test_of_equal_peaks_the_first_counts_and_a_tenth_of_it_is_the_onset() -> None:
    response = np.array([np.nan, 0.1, 0.5, 1.0, 1.0])
    frames = np.arange(5.0)
    got = measure(Responses(frames, frames / 10, response, np.full((5, 4), np.nan)), EDGE)
    assert (got.peak_frame, got.onset_frame, got.onset_time_s) == (3, 1, 0.1)


def test_contact_and_size_at_the_peak() -> None:
    (protocol,) = (
        find("loom-l-over-v")[0].with_settings({"disk.growth.l_over_v_ms": 100}).protocols()[:1]
    )
    frames = np.arange(float(protocol.frame_count))
    response = np.where(frames == 51, 1.0, 0.5)
    shown = Responses(frames, frames / 30, response, np.zeros((len(frames), 4)))
    got = measure(shown, protocol)
    # Contact at 2.2 s; 0.5 s before it, the size is 2 atan(0.1 / 0.5).
    assert got.peak_before_contact_s == pytest.approx(0.5)
    assert got.size_at_peak_deg == pytest.approx(2 * np.degrees(np.arctan(0.2)))
    # An object that is not drawn has no size.
    (disk_,) = protocol.objects
    gone = replace(disk_, id="gone", growth=None, size_deg=80.0, duration_s=0.1, vanishes="end")
    again = measure(shown, replace(protocol, objects=(disk_, gone)))
    assert again.size_at_peak_deg == got.size_at_peak_deg
    # Of two objects the larger one counts.
    small = replace(disk_, id="small", growth=None, size_deg=3.0)
    assert measure(shown, replace(protocol, objects=(disk_, small))) == got


def test_measures_without_a_response() -> None:
    times, blank = np.arange(4.0), np.full((4, 4), np.nan)
    assert measure(Responses(times, times, blank[0], blank), EDGE) == Measures()
    silent = measure(Responses(times, times, np.array([np.nan, 0, 0, 0]), blank), EDGE)
    assert silent == Measures(peak=0, mean=0, area=0)  # and no time of a peak


@pytest.mark.long
def test_processes_change_no_byte(tmp_path: Path) -> None:
    entry = disk(tmp_path)
    settings = resolve(
        models=["opplod_reference", "dlgmd"],
        height="native",
        assignments={"opplod_reference.receptive_field": "24"},
    )
    counted: list[int] = []
    for jobs in (1, 2):
        conditions = tune(Sweep(entry, settings), jobs=jobs, progress=lambda: counted.append(1))
        (tmp_path / f"{jobs}.csv").write_text(tuning_text(conditions))
        assert len(counted) == 3 * jobs
    text = (tmp_path / "1.csv").read_bytes()
    assert text == (tmp_path / "2.csv").read_bytes()
    rows = list(csv.DictReader(text.decode().splitlines()))
    assert [(row["disk.growth.speed_deg_s"], row["model"]) for row in rows] == [
        (speed, model) for speed in ("15", "25", "35") for model in ("opplod_reference", "dlgmd")
    ]
    opplod = [float(row["peak"]) for row in rows if row["model"] == "opplod_reference"]
    assert opplod == sorted(opplod)
    assert opplod[2] > 2 * opplod[0] > 0
    assert rows[1]["centre_x"] == ""


def test_a_position_becomes_two_columns(tmp_path: Path) -> None:
    entry = swept(str(disk(tmp_path).path), ["position=[[0, 0], [4, -2]]"])
    settings = resolve(height="native", models=["opplod_reference"])
    (tmp_path / "a.csv").write_text(tuning_text(tune(Sweep(entry, settings))))
    rows = rows_of(tmp_path / "a.csv")
    places = [(row["disk.centre_deg.right"], row["disk.centre_deg.up"]) for row in rows]
    assert places == [("0", "0"), ("4", "-2")]
    moved = [float(rows[1][key]) - float(rows[0][key]) for key in ("centre_x", "centre_y")]
    np.testing.assert_allclose(moved, [8, 4], atol=2)


def test_cells_hold_whole_numbers_with_all_digits_and_words_as_they_are(tmp_path: Path) -> None:
    values = {"seed": 4294967295, "disk.size_deg": 2.5, "disk.reverse": True, "bar.kind": "bar"}
    conditions = [Condition("a", values, {"opplod": Measures()})]
    (tmp_path / "a.csv").write_text(tuning_text(conditions))
    (row,) = rows_of(tmp_path / "a.csv")
    assert [row[key] for key in values] == ["4294967295", "2.5", "True", "bar"]


def test_the_sidecar_holds_the_parameters_and_the_sweep(tmp_path: Path) -> None:
    settings = resolve(
        models=["opplod_reference", "dlgmd"],
        height="native",
        assignments={"opplod_reference.gain": "3"},
    )
    content = tuning_sidecar(Sweep(disk(tmp_path), settings), command=["oppload"])
    assert content["schema"] == "oppload.tuning/1"
    assert content["parameters"]["opplod_reference"]["gain"] == 3
    assert content["parameters"]["opplod_reference"]["receptive_field"] == 25  # 5/12 of 60
    assert content["changed"] == {"opplod_reference.gain": 3}
    path = tmp_path / "a.tuning.json"
    path.write_text(json.dumps(content))
    again = tuning_sidecar(Sweep(disk(tmp_path), resolve(config=path)), command=["oppload"])
    assert again == content  # defaults are not changed, though the file states them
    assert content["stimulus"]["sweep"] == {"disk.growth.speed_deg_s": [15, 25, 35]}


@pytest.mark.parametrize(("height", "field"), [("native", 25), ("30", 12)])
def test_the_sidecar_has_sizes_in_pixels_of_the_shorter_side(
    height: str, field: int, tmp_path: Path
) -> None:
    """The display of 60 x 80 px has 2 px/deg; 5/12 of its width are 25 px."""
    portrait = disk(tmp_path).with_settings({"display.width": 60, "display.height": 80})
    found = []
    for size in ({}, {"opplod_reference.receptive_field": "18deg"}):
        settings = resolve(models=["opplod_reference"], height=height, assignments=size)
        content = tuning_sidecar(Sweep(portrait, settings), command=[])
        found.append(content["parameters"]["opplod_reference"]["receptive_field"])
    assert found == [field, 36 if height == "native" else 18]
    assert content["changed"] == {"opplod_reference.receptive_field": "18deg"}


@pytest.mark.parametrize(
    ("stimulus", "word", "key"),
    [
        ("klapoetke2017/bar-expand-10", "axis", "bar.axis_deg"),
        ("controls/translating-disk-direction", "direction", "scene.rotation_deg"),
        ("klapoetke2017/bar-expand-10/axis-45", "direction", "bar.axis_deg"),
        ("controls/sine-grating", "direction", "grating.axis_deg"),
        ("controls/texture-pan", "direction", "ground.motion.direction_deg"),
        ("klapoetke2017/loom", "direction", "scene.rotation_deg"),
        ("klapoetke2017/bar-expand-10", "width", "bar.width_deg"),
        ("klapoetke2017/loom-speed", "speed", "disk.growth.speed_deg_s"),
        ("controls/translating-disk-speed", "speed", "disk.motion.speed_deg_s"),
        ("klapoetke2017/loom-l-over-v", "l/v", "disk.growth.l_over_v_ms"),
        ("klapoetke2017/loom", "position", "disk.centre_deg"),
        ("klapoetke2017/cross-inward", "position", "scene.centre_deg"),
        ("klapoetke2017/cross-inward", "axis", "scene.rotation_deg"),
        ("klapoetke2017/loom", "disk.luminance", "disk.luminance"),
    ],
)
def test_the_key_that_a_word_stands_for(stimulus: str, word: str, key: str) -> None:
    value = "[[1,0]]" if word == "position" else "1"
    assert list(swept(stimulus, [f"{word}={value}"]).sweep) == [key]


def test_a_member_of_a_sweep_keeps_its_values() -> None:
    entry = swept("klapoetke2017/loom-l-over-v/l-over-v-80", ["direction=0:270:90"])
    assert list(entry.sweep) == ["scene.rotation_deg"]
    disks = [each.as_table()["object"][0] for each in entry.protocols()]
    assert [disk["growth"]["l_over_v_ms"] for disk in disks] == [80] * 4
    grating = swept("controls/sine-grating", ["direction"])
    assert grating.sweep == find("controls/sine-grating")[0].sweep
    again = swept("klapoetke2017/bar-expand-10/axis-45", ["axis=0,90"])
    assert again.sweep == {"bar.axis_deg": [0, 90]}


def test_the_own_sweep_that_another_one_replaces_is_named() -> None:
    stimulus, over = "klapoetke2017/loom-l-over-v", ["direction=0,90"]
    (sweep,) = sweeps(stimulus, (), {}, parsed_over(over), {"models": ["opplod"]})
    assert sweep.fixed == {"disk.growth.l_over_v_ms": 40}
    (sweep,) = sweeps(stimulus, (), {}, parsed_over(["l/v=10,20"]), {"models": ["opplod"]})
    assert not sweep.fixed


def test_a_change_replaces_the_own_sweep_that_another_one_drops() -> None:
    (sweep,) = sweeps(
        "staged/collision/background-sky_speed-m-3_bearing-15x4_relative-luminance-0.4",
        (),
        {"scene.background": "room"},
        {"thing.size_m": [1, 2]},
        {"models": ["opplod"]},
    )
    assert (sweep.entry.sweep, sweep.fixed) == ({"thing.size_m": [1, 2]}, {})
    for protocol in sweep.entry.protocols():
        (thing,) = protocol.objects
        assert thing.course is not None
        assert (protocol.scene.background, thing.course.bearing_deg) == ("room", (15, 4))


@pytest.mark.parametrize(
    ("changes", "over", "message"),
    [
        ({}, ["l/v=10,20", "l/v=30"], "'l/v' is swept already"),
        ({}, ["l/v=10,20", "disk.growth.l_over_v_ms=30"], "l_over_v_ms' is swept already"),
        ({}, ["l/v=10,20,10"], "10 is there twice"),
        ({"disk.growth.l_over_v_ms": 30}, ["l/v=10,20"], "--over sweeps it; leave one"),
        ({"l/v": [30, 40]}, ["direction=0,90"], "several values beside --over; give one of them"),
    ],
)
def test_options_that_contradict_each_other(
    changes: dict[str, object], over: list[str], message: str
) -> None:
    with pytest.raises(ParameterError, match=message):
        sweeps(
            "klapoetke2017/loom-l-over-v", (), changes, parsed_over(over), {"models": ["opplod"]}
        )


def test_l_over_v_is_also_that_of_an_object_that_dims(tmp_path: Path) -> None:
    growth = '[object.growth]\nkind = "edge-speed"\nspeed_deg_s = 25'
    dimming = '[object.brightness]\nkind = "approach"\nto = 0\nl_over_v_ms = 40\nmost_deg = 9'
    text = DISK.format(before=0).replace(growth, dimming).partition("[sweep]")[0]
    (tmp_path / "dim.toml").write_text(text)
    entry = swept(str(tmp_path / "dim.toml"), ["l/v=10,20"])
    assert entry.sweep == {"disk.brightness.l_over_v_ms": [10, 20]}


def at_the_start(entry: Entry, settings: Settings, presentations: int = 1) -> list[Doubt]:
    sweep = Sweep(entry, settings, presentations)
    doubts = doubts_about(tune(sweep), sweep)
    return [doubt for doubt in doubts if "the start of the motion" in doubt.note]


@pytest.mark.long
def test_peaks_at_the_start_of_motion_are_named() -> None:
    """D-LGMD meets no inhibition there; OppLoD leaves such edges out."""
    entry = swept("klapoetke2017/bar-expand-10", ["axis=0,45"])
    settings = resolve(height="60", models=["opplod_reference", "dlgmd"])
    (doubt,) = at_the_start(entry, settings)
    assert doubt.text.startswith("D-LGMD: 2 of 2 peaks come within 0.083 s after the start")
    assert "inhibition" not in doubt.text  # some detectors have none
    assert doubt[:2] == ("dlgmd", "2 of 2 peaks at the start of the motion: no tuning")
    without = entry.with_settings({"timing.before_s": 0})
    assert not at_the_start(without, settings)
    assert "; --change timing.before_s=0 leaves" in doubt.text
    late = entry.with_settings({"timing.before_s": 0, "bar.onset_s": 0.2})
    (doubt,) = at_the_start(late, settings)
    assert doubt.note == "2 of 2 peaks at the start of the motion: no tuning"
    assert "; --change bar.onset_s=0 leaves" in doubt.text
    # In presentations in a row a pause does not count.
    assert not at_the_start(entry, settings, 2)
    # LGMD2 has no long warm-up: leaving out the pause changes nothing, and is no advice.
    settings = resolve(height="60", models=["lgmd2"])
    for each in (entry, without):
        (doubt,) = at_the_start(each, settings)
        assert doubt.note == "2 of 2 peaks at the start of the motion: no tuning"
        assert "--change" not in doubt.text


@pytest.mark.parametrize(
    ("name", "changes", "start_s"),
    [
        ("staged/receding", {"thing.onset_s": 0.6}, 0.6),
        ("staged/collision-forward", {"thing.onset_s": 0.6}, 0),
        ("klapoetke2017/loom", {"disk.onset_s": 0.6}, 0.8),
        ("klapoetke2017/loom", {"disk.onset_s": 0.6, "scene.motion.speed_deg_s": 5}, 0.2),
    ],
)
def test_the_motion_starts_at_the_first_onset_if_scene_and_camera_rest(
    name: str, changes: dict[str, Any], start_s: float
) -> None:
    entry = replace(find(name)[0].with_settings(changes), sweep={})
    sweep = Sweep(entry, resolve(models=["frame_difference"]))
    for time_s in (start_s - 0.05, start_s + 0.05, start_s + 0.15):
        peak = Measures(peak=1, peak_frame=round(30 * time_s), peak_time_s=time_s)
        condition = Condition(entry.name, {}, {"frame_difference": peak})
        notes = [doubt.note for doubt in doubts_about([condition], sweep)]
        if time_s < start_s:  # noise causes such peaks
            assert notes == ["1 of 1 peaks before the motion: no tuning"]
        else:
            late = time_s == start_s + 0.15
            assert notes == ["1 of 1 peaks at the start of the motion: no tuning"] * (not late)


@pytest.mark.long
def test_peaks_that_the_warm_up_cuts_off_are_named(tmp_path: Path) -> None:
    """OppLoD responds from 0.1 s on; these disks grow for 0.07, 0.11 and 0.6 s."""
    changes = {"display.frame_rate": 100, "disk.growth.speed_deg_s": [140, 90, 15]}
    entry = disk(tmp_path, before=0.2).with_settings({**changes, "disk.growth.end_deg": 22})
    settings = resolve(height="native", models=["opplod_reference", "frame_difference"])
    conditions = tune(Sweep(entry, settings))
    fast, middle, _ = (each.measures["opplod_reference"] for each in conditions)
    assert fast.peak == 0
    assert middle.peak_time_s == pytest.approx(0.32)
    doubts = [
        each for each in doubts_about(conditions, Sweep(entry, settings)) if "warm-up" in each.note
    ]
    assert [each[:2] for each in doubts] == [
        ("opplod_reference", "2 of 3 peaks cut off by the warm-up: no tuning")
    ]
    assert "responds only from 0.1 s after the start of the motion on" in doubts[0].text
    # If an earlier frame has a response, the warm-up cuts nothing off.
    rising = replace(middle, onset_frame=(middle.peak_frame or 0) - 1)
    measures = {**conditions[1].measures, "opplod_reference": rising}
    others = [conditions[0], replace(conditions[1], measures=measures), conditions[2]]
    notes = [doubt.note for doubt in doubts_about(others, Sweep(entry, settings))]
    assert "1 of 3 peaks cut off by the warm-up: no tuning" in notes
    # In a longer motion the largest response may be the first one.
    longer = entry.with_settings({"disk.growth.speed_deg_s": [15]})
    first = [
        replace(each, measures=conditions[1].measures) for each in tune(Sweep(longer, settings))
    ]
    doubts = list(doubts_about(first, Sweep(longer, settings)))
    assert not any("warm-up" in each.note for each in doubts)


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"timing.after_s": 0}, "timing.after_s"),
        ({"timing.after_s": 0, "disk.growth.contact_s": 2.3}, "timing.motion_s"),
        ({"timing.after_s": 0.1}, ""),  # shows that no larger response comes later
        ({"timing.after_s": 0, "disk.growth.most_deg": 10}, ""),  # stops before the end
    ],
)
def test_peaks_in_the_last_frame_of_a_growth_are_named(changes: dict[str, Any], key: str) -> None:
    """With contact at the end or later, nobody sees when the response would fall."""
    (original,) = find("klapoetke2017/loom-l-over-v")
    common = {"disk.growth.l_over_v_ms": [10, 20], "disk.growth.most_deg": 180}
    entry = original.with_settings(common | changes)
    sweep = Sweep(entry, resolve(height="60", models=["frame_difference"]))
    doubts = [each for each in doubts_about(tune(sweep), sweep) if "last frame" in each.note]
    assert len(doubts) == bool(key)
    for doubt in doubts:
        assert doubt[:2] == ("frame_difference", "2 of 2 peaks in the last frame: cut off")
        assert "while an object still grows or shrinks: " in doubt.text
        assert doubt.text.endswith(f"cannot be seen; give a larger {key}")


@pytest.mark.parametrize(("contact", "key"), [({}, "after_s"), ({"contact_s": 3}, "motion_s")])
def test_a_picture_with_a_stated_contact_needs_a_longer_motion(
    contact: dict[str, float], key: str
) -> None:
    """In the pause after its motion, a picture may have no contact."""
    changes = {f"thing.course.{name}": value for name, value in contact.items()}
    entry = replace(find("staged/collision")[0].with_settings(changes), sweep={})
    sweep = Sweep(entry, resolve(models=["frame_difference"]))
    peak = Measures(peak=1, peak_frame=71, peak_time_s=71 / 30)
    condition = Condition(entry.name, {}, {"frame_difference": peak})
    (doubt,) = doubts_about([condition], sweep)
    assert doubt.text.endswith(f"give a larger timing.{key}")


@pytest.mark.long
def test_peaks_when_an_object_vanishes_are_named(tmp_path: Path) -> None:
    shown = disk(tmp_path).with_settings({"timing.after_s": 0.4})
    gone = shown.with_settings({"disk.vanishes": "end"})
    settings = resolve(height="native", models=["frame_difference"])
    (doubt,) = doubts_about(tune(Sweep(gone, settings)), Sweep(gone, settings))
    assert doubt[:2] == ("frame_difference", "3 of 3 peaks when an object vanishes: no tuning")
    assert doubt.text.endswith("; --change disk.vanishes=never keeps the object")
    # Its first frame without the object is the last one.
    short = gone.with_settings({"timing.after_s": 0.04, "disk.growth.speed_deg_s": [35]})
    (doubt,) = doubts_about(tune(Sweep(short, settings)), Sweep(short, settings))
    assert doubt.note == "1 of 1 peaks when an object vanishes: no tuning"
    assert not list(doubts_about(tune(Sweep(shown, settings)), Sweep(shown, settings)))
    early, *_ = tune(Sweep(gone, settings))
    before = replace(early.measures["frame_difference"], peak_time_s=0.3)
    conditions = [replace(early, measures={"frame_difference": before})] * 3
    assert not list(doubts_about(conditions, Sweep(gone, settings)))
    slow = tune(Sweep(gone, settings), indicator_s=1)  # its peak comes at the end of any motion
    assert not list(doubts_about(slow, Sweep(gone, settings), 1))


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("10,20,40.5", [10, 20, 40.5]),
        ("0:330:30", list(range(0, 331, 30))),
        ("1:0:-0.5", [1, 0.5, 0]),
        ("[[0, 0], [10, 0]]", [[0, 0], [10, 0]]),
        ('"a","b"', ["a", "b"]),  # refused when the stimuli are made
    ],
)
def test_values_are_lists_ranges_or_toml(text: str, values: list[object]) -> None:
    key = "disk.centre_deg" if text.startswith("[") else "scene.rotation_deg"
    assert swept("klapoetke2017/loom", [f"{key}={text}"]).sweep == {key: values}


def test_a_range_ends_at_its_end_although_its_steps_are_rounded() -> None:
    (values,) = swept("klapoetke2017/loom", ["scene.rotation_deg=0:0.3:0.1"]).sweep.values()
    assert values == pytest.approx([0, 0.1, 0.2, 0.3])


@pytest.mark.parametrize("values", ["", "a,b", "0:10", "0:10:0", "0:inf:1", "["])
def test_values_that_cannot_be_read(values: str) -> None:
    with pytest.raises(ParameterError, match="cannot be read; write values such as 10,20,40"):
        swept("klapoetke2017/loom-speed", [f"speed={values}"])


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ("0:10:-1", "steps of -1 from 0 lead away from 10; exchange the ends, or change the sign"),
        ("330:0:30", "steps of 30 from 330 lead away from 0; exchange the ends"),
        ("0:1e9:1e-3", "these are more than 1,000 values; take a larger step"),
        ("0:1000:1", "these are more than 1,000 values"),
    ],
)
def test_ranges_that_run_backwards_or_are_too_long(values: str, message: str) -> None:
    with pytest.raises(ParameterError, match=message):
        swept("klapoetke2017/loom-speed", [f"speed={values}"])


def test_a_sweep_of_the_seed_shows_other_noise() -> None:
    entry = swept("controls/looming-noise/noise-0.1", ["seed=1,2"])
    first, second = (Renderer(protocol).grey(0) for protocol in entry.protocols())
    assert list(entry.values().values()) == [{"seed": 1}, {"seed": 2}]
    assert (first != second).mean() > 0.9


@pytest.mark.parametrize(
    ("stimulus", "over", "message"),
    [
        ("klapoetke2017/loom", [], "has no sweep of its own; give one"),
        ("klapoetke2017/loom", ["size"], "for 'disk.size_deg'; write --over size=VALUES, with"),
        ("klapoetke2017/loom", ["sped=1,2"], r"no parameter 'sped'; did you mean 'speed'\?$"),
        ("klapoetke2017/loom", ["noise=0,1"], r"'noise'; did you mean 'effects\.noise'\?$"),
        ("klapoetke2017/loom", ["before=0,1"], r"'before'; did you mean 'timing\.before_s'\?$"),
        ("klapoetke2017/loom", ["luminance=0,1"], r"did you mean 'disk\.luminance'\?$"),
        ("klapoetke2017/loom", ["=0,1"], "no parameter ''; choose axis, direction, "),
        ("klapoetke2017/loom", ["coherence=0,1"], "'coherence'; choose axis, direction, "),
        (
            "klapoetke2017/loom",
            ["l/v=1,2"],
            "--over l/v: no object of klapoetke2017/loom has l_over_v_ms; choose axis, ",
        ),
        (
            "klapoetke2017/loom-l-over-v",
            ["width=10"],
            "--over width: no object of klapoetke2017/loom-l-over-v has width_deg; choose "
            "axis, direction, l/v, position, or a full key such as scene.rotation_deg",
        ),
        ("klapoetke2017/loom", ["position=0,10"], r"write position=\[\[0,0\],\[10,0\]\]$"),
        ("klapoetke2017/loom", ["position=[[0,1],2]"], r"write position=\[\[0,1\],\[2,0\]\]$"),
        ("klapoetke2017/cross-inward", ["width=1,2"], "that is inward-right.width_deg or"),
        (
            "klapoetke2017/loom",
            ["disc.size_deg=1,2"],
            "--over disc.size_deg: no key 'disc.size_deg'; did you mean 'disk'",
        ),
        ("klapoetke2017/*", [], "stands for 19 stimuli; name one"),
        (
            "klapoetke2017/bar-expand-10",
            ["axis=0:360:45"],
            "axis: 360 degrees are the same direction as 0; leave one of the two out",
        ),
        (
            "klapoetke2017/loom",
            ["scene.rotation_deg=-90,270"],
            "270 degrees are the same direction as -90",
        ),
    ],
)
def test_a_wrong_sweep(stimulus: str, over: list[str], message: str) -> None:
    with pytest.raises(OpploadError, match=message.replace("*", r"\*")):
        swept(stimulus, over)


def test_an_error_of_a_swept_value_names_the_stimulus(tmp_path: Path) -> None:
    entry = swept(str(disk(tmp_path).path), ["disk.size_deg=2,-5"])
    with pytest.raises(StimulusError, match=r"with disk\.size_deg = -5: .* at least 0 deg, not -5"):
        tune(Sweep(entry, resolve()))


@pytest.mark.parametrize(
    ("stimulus", "pause", "symmetric"),
    [
        ("klapoetke2017/bar-expand-10", "before_s", True),
        ("opplod2023/inward-motion", "before_s", True),
        ("klapoetke2017/bar-expand-10-one-end", "before_s", False),
        ("klapoetke2017/bar-sweep", "after_s", False),
        ("klapoetke2017/loom-speed", "before_s", False),
    ],
)
def test_frames_of_the_motion_decide_whether_a_stimulus_is_symmetric(
    stimulus: str, pause: str, symmetric: bool
) -> None:
    """Before its motion, a bar that will grow at one end looks the same after half a turn."""
    entry = swept(stimulus, []).with_settings({f"timing.{pause}": 4})
    content = tuning_sidecar(Sweep(entry, resolve()), command=[])
    assert content["stimulus"]["symmetric"] is symmetric
    # The text of the catalogue may contradict the changes.
    changed = f"(changed: timing.{pause} = 4)"
    for described in (content["stimulus"], content["stimulus"]["first"]):
        assert described["description"].endswith(changed)


def test_frames_of_a_late_motion_decide_too() -> None:
    """One and two thirds of the motion of the clip lie before the bar grows at one end."""
    changes = {"timing.motion_s": 12, "bar.onset_s": 10}
    entry = swept("klapoetke2017/bar-expand-10-one-end", []).with_settings(changes)
    content = tuning_sidecar(Sweep(entry, resolve()), command=[])
    assert content["stimulus"]["symmetric"] is False


def test_with_an_indicator_a_faint_response_is_no_doubt() -> None:
    settings = resolve(models=["dlgmd"])
    faint_one = [Condition("a", {}, {"dlgmd": Measures(peak=1e-4)})]
    entry = find("klapoetke2017/loom")[0]
    assert len([*doubts_about(faint_one, Sweep(entry, settings))]) == 1
    assert not [*doubts_about(faint_one, Sweep(entry, settings), 1.0)]


def test_alarms_that_are_off_change_what_is_said_of_faint_responses() -> None:
    for on, words in (
        ("true", "a tenth of the floor of its alarm, 0.01"),
        ("false", "a tenth of its least response of an object, 0.01"),
    ):
        settings = resolve(models=["dlgmd"], assignments={"alarm.on": str(on)})
        (doubt,) = faint({"dlgmd": 1e-4}, settings)
        assert words in doubt.text
        for peak, few in ((0.00099, 1), (0.00101, 0)):
            assert len([*faint({"dlgmd": peak}, settings)]) == few
        # As a polar plot, which says "no response" there too.
        (doubt,) = faint({"dlgmd": 9e-9}, settings)
        assert doubt.note == "below a millionth of its floor"
        assert doubt.text.startswith("D-LGMD does not respond to this stimulus: its largest")
        assert "9e-09" not in doubt.text


@pytest.mark.parametrize(
    ("model", "values", "indicator_s", "missing"),
    [
        ("opplod_lplc2", {}, 0.0, "no indicator and more than one unit"),
        ("opplod_lplc2", {"opplod_lplc2.units": "1x1"}, 0.0, "no indicator"),
        ("opplod_lplc2", {}, 1.0, "more than one unit"),
        ("opplod_lplc2", {"opplod_lplc2.units": "1x1"}, 1.0, None),
        ("opplod_reference", {}, 0.0, None),
    ],
)
def test_neurons_that_are_measured_unlike_the_study_are_named(
    model: str, values: dict[str, str], indicator_s: float, missing: str | None
) -> None:
    settings = resolve(models=[model, "dlgmd"], assignments=values)
    measures = {name: Measures(peak=1.0) for name in settings.models}
    condition = Condition("a", {}, measures)
    doubts = list(
        doubts_about([condition], Sweep(find("klapoetke2017/loom")[0], settings), indicator_s)
    )
    notes = [(each.detector, each.note) for each in doubts]
    expected = f"{missing}: larger for bars than in LPLC2 neurons"
    assert notes == ([("opplod_lplc2", expected)] if missing else [])
    advice = {"no indicator": "--indicator 1", "more than one unit": "--set opplod_lplc2.units=1x1"}
    for doubt in doubts:
        assert missing is not None
        named = [advice[each] for each in missing.split(" and ")]
        assert doubt.text.endswith(f"add {' and '.join(named)}")
