"""Results in Python: the same numbers and files as those of the command line."""

from __future__ import annotations

import inspect
import json
import os
import re
import sys
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pandas as pd
import pytest

import oppload_cli as oppload
from oppload_cli.errors import OutputError, ParameterError, ResultError, SourceError, StimulusError
from oppload_cli.results.table import columns_for
from tests.cli import inside
from tests.media import looming, texture, write_video

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

FRAMES = [(frame * 255).round().astype(np.uint8) for frame in looming(120, 60, 60, 14)]
REFERENCE = ["opplod_reference", "dlgmd"]
NATIVE: dict[str, Any] = {"height": "native"}


@pytest.mark.long
def test_a_result_has_the_files_of_the_command_line(tmp_path: Path) -> None:
    video = write_video(tmp_path / "loom.avi", FRAMES)
    told = inside.oppload(
        "run", video, "-o", tmp_path / "cli", "-q", "--model", ",".join(REFERENCE),
        "--height", "native",
    )  # fmt: skip
    assert told.returncode == 0
    result = oppload.run(video, models=REFERENCE, **NATIVE)
    assert result.save(tmp_path / "api") == tmp_path / "api" / "loom.frames.csv"
    for name in ("loom.frames.csv", "loom.detections.jsonl"):
        assert (tmp_path / "api" / name).read_bytes() == (tmp_path / "cli" / name).read_bytes()
    own, other = (
        json.loads((tmp_path / folder / "loom.oppload.json").read_text())
        for folder in ("api", "cli")
    )
    assert own.keys() == other.keys()
    for key in ("schema", "models", "height", "parameters", "input", "working", "summary"):
        assert own[key] == other[key]
    again = oppload.read_result(tmp_path / "cli" / "loom.frames.csv")
    assert repr(again) == repr(result).replace("array", "loom")
    pd.testing.assert_frame_equal(again.frames, result.frames, rtol=1e-8)
    pd.testing.assert_frame_equal(again.detections, result.detections, rtol=1e-8)
    assert again.summary == result.summary
    with pytest.raises(OutputError, match="exists already; choose if_exists='overwrite' or 'skip'"):
        result.save(tmp_path / "api")
    result.save(tmp_path / "api", if_exists="overwrite")
    assert result.save(tmp_path / "api", "other").name == "other.frames.csv"
    plain = oppload.run(video, models=["frame_difference"], rmo=False)  # a detector without places
    plain.save(tmp_path / "api", "loom", if_exists="overwrite")
    assert oppload.read_result(tmp_path / "api" / "loom.frames.csv").detections.empty


def test_patterns_and_open_videos_give_the_names_of_the_command_line(tmp_path: Path) -> None:
    for index, frame in enumerate(FRAMES[:3]):
        assert cv2.imwrite(str(tmp_path / f"view_{index:04d}.png"), frame)
    pattern = tmp_path / "view_%04d.png"
    options: dict[str, Any] = {"models": ["frame_difference"], "rmo": False}
    assert oppload.run(pattern, **options).path.name == "view.frames.csv"
    with oppload.open_video(pattern) as video:
        assert oppload.run(video, **options).path.name == "view.frames.csv"


def as_path(folder: Path) -> Path:
    return write_video(folder / "loom.avi", FRAMES)


def as_colour(_: Path) -> np.ndarray:
    return np.repeat(np.stack(FRAMES)[..., None], 3, axis=3)


SOURCES: dict[str, Callable[[Path], Any]] = {
    "path": as_path,
    "text": lambda folder: str(as_path(folder)),
    "open": lambda folder: oppload.open_video(as_path(folder), height=None),
    "array": lambda _: np.stack(FRAMES),
    "list": lambda _: FRAMES,
    "colour": as_colour,
    "16 bits": lambda _: np.stack(FRAMES).astype(np.uint16) * 257,
    "big-endian": lambda _: (np.stack(FRAMES).astype(np.uint16) * 257).astype(">u2"),
    "float": lambda _: np.stack(FRAMES) / 255,
}


@pytest.mark.parametrize("kind", SOURCES)
def test_every_kind_of_source_gives_the_same(kind: str, tmp_path: Path) -> None:
    expected = oppload.run(np.stack(FRAMES), rate=30, models=["dlgmd"], rmo=False, **NATIVE)
    source = SOURCES[kind](tmp_path)
    made = oppload.run(source, rate=Fraction(30), models=["dlgmd"], rmo=False, **NATIVE)
    pd.testing.assert_frame_equal(made.frames, expected.frames, rtol=1e-5, atol=1e-7)
    if kind == "open":
        source.close()


def test_frames_of_an_open_source_can_be_run_again_except_those_of_a_video(tmp_path: Path) -> None:
    options: dict[str, Any] = {"models": ["frame_difference"], "rmo": False}
    with oppload.open_source(np.stack(FRAMES), rate=30) as frames:
        first, second = (oppload.run(frames, **options) for _ in range(2))
    pd.testing.assert_frame_equal(second.frames, first.frames)
    assert second.sidecar["time"]["not_after_the_one_before"] == 0
    assert second.sidecar["decode"]["decoded"] == len(FRAMES)
    with oppload.open_video(write_video(tmp_path / "a.avi", FRAMES)) as video:
        oppload.run(video, **options)
        with pytest.raises(SourceError, match=r"a\.avi: has no frame left, as .*; open it again$"):
            oppload.run(video, **options)


def test_a_span_after_the_last_frame_leaves_no_frame(tmp_path: Path) -> None:
    late = oppload.Span(start=oppload.Position(frame=90))
    with (
        oppload.open_video(write_video(tmp_path / "a.avi", FRAMES), span=late) as video,
        pytest.raises(SourceError, match=r"a\.avi: has no frame left in its span; open"),
    ):
        oppload.run(video, models=["frame_difference"], rmo=False)


def test_a_source_of_ones_own_needs_facts_a_size_and_frames() -> None:
    frames = looming(40, 30, 12, 12)
    expected = oppload.run(np.stack(frames), rate=30, height="native")
    facts = expected.sidecar["input"]
    with oppload.open_source(np.stack(frames), rate=30, height="native") as source:
        seen = list(source)

    class Own:
        facts, working = source.facts, source.working

        def __iter__(self) -> Iterator[oppload.Frame]:
            return iter(seen)

    result = oppload.run(Own())
    assert result.frames.equals(expected.frames)
    assert result.sidecar["input"] == facts


def test_a_video_keeps_its_own_rate(tmp_path: Path) -> None:
    told = "has times or a rate of its own; rate is for an array or images; for slow motion"
    with pytest.raises(ParameterError, match=told):
        oppload.run(as_path(tmp_path), rate=60, **NATIVE)


def test_a_video_in_slow_motion_has_the_times_of_its_true_rate(tmp_path: Path) -> None:
    slow = as_path(tmp_path)
    for wrong in (0, float("nan"), "240"):
        with pytest.raises(ParameterError, match="true_rate must be a number above 0 and at most"):
            oppload.open_video(slow, true_rate=wrong)  # type: ignore[arg-type]
    with oppload.open_video(slow, true_rate=240.0) as video:
        result = oppload.run(video, **NATIVE)
    expected = oppload.run(slow, **NATIVE).frames["time_s"] / 8
    assert result.frames["time_s"].to_numpy() == pytest.approx(expected, abs=1e-8)
    assert result.sidecar["input"]["rate_in_file"] == "30/1"
    assert result.sidecar["remarks"][0] == (
        "--true-rate (in Python true_rate) is 240 frames/s, and the rate of the file 30: all times "
        "are those of the file divided by 8"
    )


@pytest.mark.long
def test_a_stimulus_may_be_named_and_keeps_its_truth(tmp_path: Path) -> None:
    protocol = oppload.stimulus.load("klapoetke2017/loom-l-over-v/l-over-v-10")
    options: dict[str, Any] = {"models": ["dlgmd"], "rmo": False}
    result = oppload.run(protocol, **options)
    named = oppload.run(protocol.name, **options)
    pd.testing.assert_frame_equal(result.frames, named.frames)
    contact = result.sidecar["stimulus"]["contact_time_s"]
    path = result.save(tmp_path)
    assert path.name == "klapoetke2017_loom-l-over-v_l-over-v-10.frames.csv"
    again = oppload.read_result(path)
    assert again.sidecar["stimulus"]["contact_time_s"] == contact
    assert "frames" not in again.sidecar["stimulus"]
    for each in (result, again):
        _, (_, strip) = each.plot(align="contact")
        assert np.asarray(strip.lines[0].get_xdata(), float)[0] == pytest.approx(-contact)
    with pytest.raises(oppload.OpploadError, match="loom-l-over-v"):
        oppload.run("klapoetke2017/loom-l-over-v")  # eight of them


@pytest.mark.long
def test_the_truth_goes_with_a_result_that_is_saved_again(tmp_path: Path) -> None:
    first = oppload.run("controls/size-steps", rmo=False).save(tmp_path / "first")
    second = oppload.read_result(first).save(tmp_path / "second")
    shown = [path.with_name("controls_size-steps.stimulus.json") for path in (first, second)]
    assert shown[1].read_bytes() == shown[0].read_bytes()
    stated = oppload.read_result(second).sidecar["stimulus"]["path"]
    assert stated == str(shown[1])


def test_a_result_that_cannot_be_saved_completely_has_no_table(tmp_path: Path) -> None:
    protocol = oppload.stimulus.load("klapoetke2017/loom-l-over-v/l-over-v-10")
    result = oppload.run(protocol, models=["dlgmd"], rmo=False, height=24)
    truth = tmp_path / "a.stimulus.json"
    truth.write_text("mine")
    with pytest.raises(OutputError, match=r"a\.stimulus\.json: exists already"):
        result.save(tmp_path, "a")
    assert [path.name for path in tmp_path.iterdir()] == [truth.name]
    assert truth.read_text() == "mine"
    with pytest.raises(ParameterError, match="one of error, skip, overwrite, not 'bogus'"):
        result.save(tmp_path, "a", if_exists="bogus")
    part = tmp_path / "a.frames.csv.part"  # of an interrupted run
    part.touch()
    truth.unlink()
    with pytest.raises(OutputError, match=r"csv\.part: exists already; choose if_exists='overwr"):
        result.save(tmp_path, "a")
    path = result.save(tmp_path, "a", if_exists="overwrite")
    assert json.loads(truth.read_text())["frames"]
    (tmp_path / "a.oppload.json").unlink()
    (tmp_path / "a.oppload.json").mkdir()  # in the way
    with pytest.raises(OutputError, match=r"a\.oppload\.json: cannot be written"):
        result.save(tmp_path, "a", if_exists="overwrite")
    assert not path.exists()
    assert not list(tmp_path.glob("*.part"))


def test_each_detector_has_its_own_alarm() -> None:
    def floors(**options: Any) -> dict[str, float]:
        records = oppload.analyse(np.stack(FRAMES), rate=30, rmo=False, height="native", **options)
        record = list(records)[4]
        return {name: said.threshold for name, said in record.detectors.items()}

    own = {"opplod": 0.09, "opplod_reference": 0.0008, "dlgmd": 0.01}
    assert floors(models=list(own)) == own
    assert floors(models=[oppload.parameters_of(name) for name in own]) == own
    assert floors() == {"opplod": 0.09, "dlgmd": 0.01}
    without = floors(models=["opplod_paper", "opplod_lplc2"])
    assert without == dict.fromkeys(("opplod_paper", "opplod_lplc2"), np.inf)


@pytest.mark.long
def test_a_camera_that_is_turned_gives_the_same() -> None:
    """The working height is the shorter side of a frame, so that a turn changes only the places."""
    y, x = np.mgrid[:180, :320]
    frames = [
        np.where(
            np.hypot(x - 130, y - 100) < 2 + 400 / (35 - t), 0.1, 0.3 + 0.6 * texture(180, 320, 3)
        )
        for t in range(30)
    ]
    clip = np.asarray(frames, np.float32)
    turned = np.ascontiguousarray(np.rot90(clip, 1, (1, 2)))
    one, other = (oppload.run(each, rate=30, rmo=False).frames for each in (clip, turned))
    for name in ("opplod", "dlgmd"):
        expected = one[f"{name}_response"]
        # The search for the flow goes over the frame in one direction.
        within = (0.15 if name == "opplod" else 0.03) * expected.max()
        np.testing.assert_allclose(other[f"{name}_response"], expected, rtol=0, atol=within)
        assert one[f"{name}_alarm"].any()
        assert (one[f"{name}_alarm"] != other[f"{name}_alarm"]).sum() <= (name == "opplod")


def test_a_record_has_the_same_columns_in_every_frame() -> None:
    for rmo in (True, False):
        records = oppload.analyse(np.stack(FRAMES), rate=30, rmo=rmo, height="native")
        values = [record.values() for record in records]
        assert len({tuple(each) for each in values}) == 1
        names = [column.name for column in columns_for(["opplod", "dlgmd"], rmo=True)]
        assert set(names) <= set(values[0])
        assert values[0]["opplod_response"] is None
        assert str(values[0]["opplod_alarm"]) == "0"  # as in the table


@pytest.mark.long
def test_a_stimulus_of_a_file_is_a_source(tmp_path: Path) -> None:
    own = tmp_path / "mine.toml"
    table = next(e.path for e in oppload.stimulus.entries() if e.name == "controls/looming-ring")
    own.write_bytes(table.read_bytes())
    with oppload.open_source("controls/looming-ring", height=60) as frames:
        expected = [(each.time_s, each.luma.tobytes()) for each in frames]
    for source in (own, str(own)):
        with oppload.open_source(source, height=60) as frames:
            assert frames.facts.name == "mine"
            assert [(each.time_s, each.luma.tobytes()) for each in frames] == expected
    with pytest.raises(StimulusError, match="no member 'ring'"):
        oppload.run(f"{own}/ring")
    own.write_text("no = 1")
    with pytest.raises(StimulusError, match=r"mine\.toml: "):
        next(oppload.analyse(own))
    with pytest.raises(StimulusError, match=r"none\.toml: cannot be read"):
        oppload.run(tmp_path / "none.toml")


def test_open_sources_and_an_analysis_describe_themselves(tmp_path: Path) -> None:
    video = write_video(tmp_path / "a.avi", FRAMES)
    with oppload.open_video(video, height=30) as opened:
        assert repr(opened) == f"Video({str(video)!r}, 120 x 120 at 30 frames/s, seen at 30 x 30)"
        assert opened.decode.decoded == 0
    with oppload.open_source(np.stack(FRAMES), times=range(len(FRAMES)), height=60) as frames:
        assert repr(frames) == "ArrayVideo('array', 120 x 120 at 1 frames/s, seen at 60 x 60)"
    with oppload.open_source(Path("controls/size-steps")) as frames:
        assert repr(frames).startswith("StimulusVideo('controls/size-steps', 360 x 360 at ")
    analysis = oppload.Analysis((60, 80), [oppload.parameters_of("dlgmd")])
    size = "80 x 60, seen at 320 x 240, dlgmd"
    assert repr(analysis) == f"Analysis({size}; 0 frames so far)"
    analysis.step(np.zeros((60, 80)), 0.0)
    assert repr(analysis) == f"Analysis({size}; 1 frame so far)"


def test_the_layers_of_a_model() -> None:
    params = oppload.parameters_of("opplod_reference")
    assert isinstance(params, oppload.OpplodReferenceParams)
    opplod, dlgmd = oppload.OpplodReference((120, 120), params), oppload.Dlgmd((120, 120))
    for frame in looming(120, 60, 60, 6):
        opplod.step(frame)
        dlgmd.step(frame)
    maps = opplod.maps
    assert list(maps) == ["P", "E", "I", "S", "S_45", "S_135", "S_225", "S_315"]
    np.testing.assert_allclose(maps["S"], np.maximum(maps["E"] - maps["I"], 0), atol=1e-5)
    assert all((maps[name] >= maps["S"] - 1e-6).all() for name in list(maps)[4:])
    assert dlgmd.maps["G"] is dlgmd.grouped
    assert oppload.FrameDifference((9, 9)).maps == {}


@pytest.mark.parametrize(
    ("source", "options", "kind", "sentence"),
    [
        (np.zeros((4, 9, 9), np.uint8), {}, ParameterError, "give its rate"),
        (
            np.zeros((4, 9, 9), np.uint8),
            {"rate": 0},
            ParameterError,
            "rate must be a number above 0",
        ),
        (np.zeros((4, 9, 9), np.uint8), {"rate": "30"}, ParameterError, "not '30'"),
        (np.zeros((4, 9, 9), np.uint8), {"times": [0, 1, 2]}, ParameterError, "each of the 4 f"),
        (np.zeros((4, 9, 9), np.uint8), {"times": [0, 1, 2, np.nan]}, ParameterError, "finite"),
        (
            np.zeros((4, 9, 9), np.uint8),
            {"times": pd.timedelta_range(0, periods=4, freq="33ms")},
            ParameterError,
            "times must be finite numbers of seconds",
        ),
        ("controls/size-steps", {"times": [0, 1]}, ParameterError, "only an array of frames"),
        (np.zeros((9, 9), np.uint8), {"rate": 30}, SourceError, r"its shape is \(9, 9\)"),
        (np.zeros((4, 9, 9), np.int64), {"rate": 30}, SourceError, "its type is int64"),
        (np.full((4, 9, 9), 2.0), {"rate": 30}, SourceError, "frame 0 holds values outside"),
        (np.full((4, 9, 9), np.nan), {"rate": 30}, SourceError, "frame 0 holds NaN or infinite"),
        ([np.zeros((9, 9)), np.zeros((9, 8))], {"rate": 30}, SourceError, "differ in shape"),
        (3, {}, SourceError, "int: holds no frames; give a path, a camera such as 'camera:0'"),
        (["a.mp4", "b.mp4"], {}, SourceError, "a list of names .* take one name after the other"),
        ("missing.mp4", {}, SourceError, "missing.mp4: no such file; check the path$"),
        ("controls/plade", {}, SourceError, "did you mean the stimulus 'controls/plaid'"),
        ("size-steps", {}, SourceError, "did you mean the stimulus 'controls/size-steps'"),
        ("controls/size-steps", {"height": 0}, ParameterError, "height must be"),
        ("a\0b", {}, SourceError, "no such file"),
        ("controls/size-steps", {"models": "lgmd"}, ParameterError, "no model 'lgmd'"),
        ("controls/size-steps", {"models": ["paper"]}, ParameterError, "no model 'paper'"),
        (
            "controls/size-steps",
            {"models": "opplod:paper"},
            ParameterError,
            r"in place of 'paper' write .* \(in Python models=\['opplod_paper'\]\)",
        ),
        ("controls/size-steps", {"height": 60.0}, ParameterError, "a whole number of pixels from"),
        ("controls/size-steps", {"models": ["lgmd"]}, ParameterError, "no model 'lgmd'"),
        ("controls/size-steps", {"models": [oppload.Opplod]}, ParameterError, "list of names"),
        ("controls/size-steps", {"models": oppload.Opplod}, ParameterError, "list of names"),
        ("controls/size-steps", {"rmo": oppload.RmoParams()}, ParameterError, "rmo must be True"),
        ("controls/size-steps", {"settings": {"opplod.gian": 1}}, ParameterError, "'gain'"),
        ("controls/size-steps", {"settings": ["opplod.gain=2"]}, ParameterError, "must be a dict"),
        ("controls/size-steps", {"settings": {"gain": 2}}, ParameterError, r"not \{'gain': 2\}$"),
        (
            "controls/size-steps",
            {"settings": {"opplod": {"gain": 2}}},
            ParameterError,
            r"with their set, e.g. \{'rmo.grid': 20\}, not \{'opplod': \{'gain': 2\}\}$",
        ),
        ("controls/size-steps", {"models": ["OppLoD"]}, ParameterError, "did you mean 'opplod'"),
        (
            "controls/size-steps",
            {"models": ["dlgmd"], "settings": {"opplod.gain": 2}},
            ParameterError,
            "setting opplod.gain=2 has no effect, as 'opplod' does not run",
        ),
        (
            "controls/size-steps",
            {"rmo": False, "settings": {"rmo.grid": 20}},
            ParameterError,
            "setting rmo.grid=20 has no effect, as RMO is not measured",
        ),
        ("controls/size-steps", {"rate": 25}, ParameterError, "another display.frame_rate"),
    ],
)
def test_wrong_uses(
    source: Any, options: dict[str, Any], kind: type[Exception], sentence: str
) -> None:
    with pytest.raises(kind, match=sentence):
        oppload.run(source, **options)


@pytest.mark.parametrize("when", [{"rate": 1 / 60}, {"times": [0, 60, 120]}])
def test_an_array_whose_times_may_be_in_another_unit_has_a_remark(when: dict[str, Any]) -> None:
    frames = np.zeros((3, 24, 32), np.uint8)
    result = oppload.run(frames, models=["frame_difference"], rmo=False, **when)
    assert result.sidecar["remarks"][1].startswith("frames are 60 s apart; if that is wrong, give")


@pytest.mark.parametrize(
    "shape", [240, "240x320", (240, 320, 3), (240.0, 320), np.zeros((9, 9)), (0, 9)]
)
def test_a_model_needs_height_and_width(shape: Any) -> None:
    for make in (oppload.Dlgmd, oppload.Opplod, oppload.Analysis):
        with pytest.raises(ParameterError, match=r"^shape must be height and width.*shape\[:2\]$"):
            make(shape)
    frames, sides = np.zeros((3, 9, 9), np.float32), [np.int64(9), 9]
    for model in (oppload.Dlgmd(sides), oppload.DetectorBank(sides, [oppload.DlgmdParams()])):  # type: ignore[arg-type]
        assert [model.step(frame) for frame in frames]


@pytest.mark.parametrize("params", ["reference", {"gain": 2}, oppload.DlgmdParams(), 30])
def test_a_model_takes_its_own_parameters(params: Any) -> None:
    with pytest.raises(
        ParameterError, match=r"class OpplodParams, such as parameters_of\('opplod'"
    ):
        oppload.Opplod((60, 80), params)


def test_a_span_of_two_numbers_is_refused() -> None:
    with pytest.raises(ParameterError, match=r"span must be a Span, e\.g\..*, not \(1, 2\)"):
        oppload.open_video("missing.mp4", span=(1, 2))  # type: ignore[arg-type]


def test_a_rate_may_be_as_low_as_a_frame_a_week() -> None:
    *_, last = oppload.analyse(np.zeros((3, 9, 9), np.uint8), rate=1 / 604_800, rmo=False)
    assert last.time_s == pytest.approx(2 * 604_800)


@pytest.mark.parametrize(
    ("count", "sentence"),
    [(1, "a curve needs two"), (3, "'opplod_response' is empty in every row")],
    ids=["one frame", "warm-up alone"],
)
def test_a_result_without_a_response_gives_no_figure(count: int, sentence: str) -> None:
    result = oppload.run(np.zeros((count, 9, 9), np.uint8), rate=30, rmo=False, height="native")
    for plot in (oppload.plot_curves, oppload.plot_places):
        with pytest.raises(ResultError, match=sentence):
            plot(result)


def test_the_help_on_a_results_plot_names_every_option() -> None:
    named = re.findall(r"(?<!`)`(\w+)`(?!`)", oppload.Result.plot.__doc__ or "")
    assert named == [*inspect.signature(oppload.plot_curves).parameters][1:]


@pytest.mark.parametrize("name", ["curves", "places", "rmo", "tuning"])
def test_a_path_is_no_result(name: str) -> None:
    plot = getattr(oppload, f"plot_{name}")
    with pytest.raises(ParameterError, match=r"str: cannot be drawn; give what .*read_"):
        plot("results/video.frames.csv")


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"models": None}, "names must be a list of texts, not None"),
        ({"labels": [1]}, r"names must be a list of texts, not \[1\]"),
        ({"xlim": 3}, "xlim must be the first and the last time of the axis in seconds, not 3"),
        ({"xlim": (None, 1)}, r"time of the axis in seconds, not \(None, 1\)"),
        ({"marks": [0.5]}, r"marks must be a dict of times by label, .*, not \[0.5\]"),
        ({"axes": np.zeros(2)}, "axes must be one Axes of matplotlib, not ndarray; of an array of"),
    ],
)
def test_a_figure_refuses_options_of_another_type(options: dict[str, Any], said: str) -> None:
    frames = np.stack([texture(24, 32, seed) for seed in range(6)]).astype(np.float32)
    result = oppload.run(frames, rate=30, models=["frame_difference"], rmo=False)
    with pytest.raises(ParameterError, match=said):
        result.plot(**options)


@pytest.mark.parametrize("wrong", [None, 3, [], b"a.csv"])
def test_a_path_is_a_name_or_a_path(wrong: Any) -> None:
    tuning = oppload.Tuning(Path("a.tuning.csv"), pd.DataFrame(), ())
    result = oppload.Result(Path("a.frames.csv"), pd.DataFrame(), {}, saved=True)
    protocol = oppload.stimulus.load("controls/size-steps")
    uses: list[Callable[[Any], object]] = [
        oppload.read_result,
        oppload.read_tuning,
        oppload.stimulus.read_entry,
        oppload.stimulus.read_ground_truth,
        tuning.save,
        result.save,
        result.report,
        lambda path: oppload.stimulus.write(protocol, path),
    ]
    for use in uses:
        with pytest.raises(ParameterError, match="must be a name or a Path, not "):
            use(wrong)
    with pytest.raises(ParameterError, match=r"^video must be a name or a Path, not 3$"):
        result.report(video=3)  # type: ignore[arg-type]
    with pytest.raises(ParameterError, match=r"^the name of a file must be a text, not 3$"):
        result.save(stem=3)  # type: ignore[arg-type]


@pytest.mark.parametrize("wrong", [None, [], {}, 3, np.array(["paper", "opplod"])])
def test_a_name_that_is_no_text_is_an_unknown_name(wrong: Any) -> None:
    uses: list[tuple[Callable[[Any], object], str]] = [
        (oppload.parameters_of, "no model '"),
        (
            lambda name: oppload.stimulus.write(
                oppload.stimulus.load("controls/size-steps"), Path(), form=name
            ),
            "no video format '",
        ),
    ]
    for use, said in uses:
        with pytest.raises((ParameterError, StimulusError), match=said):
            use(wrong)
    with pytest.raises(ParameterError, match="the name of a detector must be a text, not "):
        oppload.forget(wrong)


@pytest.mark.parametrize("wrong", [["a", "b"], np.array(["a", "b"]), pd.Series([1.0, 2.0])])
def test_a_value_of_another_type_is_refused_in_a_sentence(wrong: Any) -> None:
    rows = pd.DataFrame({"stimulus": ["a/b"], "model": ["opplod"]})
    tuning = oppload.Tuning(Path("a.tuning.csv"), rows, ())
    result = oppload.Result(Path("a.frames.csv"), pd.DataFrame(), {})
    protocol = oppload.stimulus.load("controls/size-steps")
    uses: dict[str, Callable[[], object]] = {
        "threads must be a whole": lambda: oppload.open_video("a.avi", threads=wrong),
        "params must not be": lambda: oppload.Alarm("opplod", wrong),
        "give a list, such as": lambda: oppload.DetectorBank((9, 9), oppload.DlgmdParams()),  # type: ignore[arg-type]
        "'receptive_field' of opplod takes": lambda: oppload.OpplodParams(receptive_field=wrong),
        "model must be the name": lambda: tuning.of(wrong),
        "if_exists must be error or": lambda: tuning.save("a", if_exists=wrong),
        "no such figure": lambda: oppload.tune(figure=wrong),
        "title must be a text": lambda: oppload.plot_curves(result, title=wrong),
        "title must be a text, not 3": lambda: oppload.plot_rmo(result, title=3),  # type: ignore[arg-type]
        "title must be a text, not": lambda: oppload.plot_places(result, title=wrong),
        "no scale": lambda: oppload.plot_curves(result, scale=wrong),
        "cannot be aligned at": lambda: oppload.plot_curves(result, align=wrong),
        "scale peak or raw": lambda: oppload.plot_tuning(tuning, scale=wrong),
        "still must be luminance": lambda: oppload.plot_places(result, [[0.5]]),  # type: ignore[arg-type]
        "has no frame": lambda: oppload.stimulus.frame_truth(protocol, [wrong]),  # type: ignore[arg-type]
    }
    for said, use in uses.items():
        with pytest.raises((ParameterError, StimulusError), match=said):
            use()


def test_a_setting_may_be_an_array_of_one_number() -> None:
    gain = np.array(0.5)  # as np.load gives it
    result = oppload.run(np.zeros((3, 9, 9), np.uint8), rate=30, settings={"opplod.gain": gain})
    assert result.sidecar["parameters"]["opplod"]["gain"] == 0.5


def test_a_record_knows_the_detectors_that_ran() -> None:
    record = oppload.Analysis((60, 80), ["opplod"]).step(np.zeros((60, 80)), 0)
    assert record["opplod"].over_threshold is None  # warm-up
    wrong: Any
    names = np.array(["opplod", "dlgmd"])
    others: list[Any] = ["dlgmd", [], names]
    for wrong, hint in (("oplod", "did you mean"), *((each, "choose") for each in others)):
        with pytest.raises(ParameterError, match=f"has no response in .*; {hint} '?opplod"):
            _ = record[wrong]


def test_a_result_shows_that_its_input_is_doubtful(tmp_path: Path) -> None:
    video = write_video(tmp_path / "a.avi", FRAMES)
    whole = video.read_bytes()
    video.write_bytes(whole[: len(whole) * 3 // 4])
    result = oppload.run(video, models=["dlgmd"], rmo=False, height=240)
    said = "1 remark: see sidecar['remarks'])"
    assert repr(result).endswith(f", incomplete: see sidecar['decode'], {said}")
    assert len(result.sidecar["remarks"]) == 1


def test_a_run_leaves_the_number_of_opencv_threads() -> None:
    threads = cv2.getNumThreads()
    try:
        cv2.setNumThreads(3)
        oppload.run(np.zeros((4, 9, 9), np.uint8), rate=30)
        assert cv2.getNumThreads() == 3
        with pytest.raises(SourceError):
            oppload.run(np.full((4, 9, 9), 2.0), rate=30)
        assert cv2.getNumThreads() == 3
    finally:
        cv2.setNumThreads(threads)


def test_settings_reach_the_detectors() -> None:
    result = oppload.run(
        np.stack(FRAMES), rate=30, rmo=False, settings={"opplod.gain": 2, "alarm.on": False},
        height="native",
    )  # fmt: skip
    assert result.sidecar["parameters"]["opplod"]["gain"] == 2
    assert result.sidecar["parameters"]["alarm"]["on"] is False
    assert repr(result) == "Result('array', 14 frames, opplod, dlgmd, alarms are off)"


def test_versions_of_opplod_run_side_by_side_at_their_heights() -> None:
    names = ["opplod", "opplod_reference", "opplod_paper", "opplod_lplc2"]
    together = oppload.run(np.stack(FRAMES), models=names, rate=30, rmo=False)
    assert together.models == tuple(names)
    assert together.sidecar["working"]["height"] == 240
    for name in names:
        alone = oppload.run(np.stack(FRAMES), models=[name], rate=30, rmo=False)
        for column in (f"{name}_response", f"{name}_alarm"):
            pd.testing.assert_series_equal(together.frames[column], alone.frames[column])
        assert together.summary[name]["peak"] > 0
    native = oppload.run(np.stack(FRAMES), models=["opplod_paper"], rate=30, rmo=False, height=600)
    paper = "opplod_paper_response"
    pd.testing.assert_series_equal(native.frames[paper], together.frames[paper])


def test_detections_have_the_same_types_whatever_was_found(tmp_path: Path) -> None:
    options: dict[str, Any] = {"rate": 30, "rmo": False, "models": REFERENCE, **NATIVE}
    nothing = oppload.run(np.full((8, 60, 80), 128, np.uint8), **options).detections
    assert nothing.empty
    path = oppload.run(np.stack(FRAMES), **options).save(tmp_path, "a")
    lines = path.with_name("a.detections.jsonl")
    whole = lines.read_text().splitlines()
    untimed = [{**json.loads(line), "x": 4, "time_to_contact_s": None} for line in whole]
    lines.write_text("".join(json.dumps(each) + "\n" for each in untimed))
    found = oppload.read_result(path).detections
    assert len(found) == len(untimed) > 0
    kinds = {"frame": "i", "id": "i", "alarm": "b"}
    for table in (nothing, found):
        expected = [kinds.get(name, "f") for name in map(str, table.columns)]
        assert [kind.kind for kind in table.dtypes] == expected
    assert list(nothing[nothing["alarm"]]) == list(nothing)  # rows are chosen, not columns


def test_damaged_detections_are_named(tmp_path: Path) -> None:
    options: dict[str, Any] = {"rate": 30, "rmo": False, "models": REFERENCE, **NATIVE}
    path = oppload.run(np.stack(FRAMES), **options).save(tmp_path, "a")
    lines = path.with_name("a.detections.jsonl")
    whole = lines.read_text()
    for damaged in ('{"frame": ', "5", "null", "[1, 2]", '{"frame": 8}'):
        lines.write_text(f"{damaged}\n")
        with pytest.raises(ResultError, match=r"a\.detections\.jsonl: is not valid JSON Lines"):
            oppload.read_result(path)
    lines.write_text(whole[:-9])  # as a run leaves it that is killed
    count = whole.count("\n")
    assert len(oppload.read_result(path).detections) == count - 1 > 0
    lines.unlink()
    assert len(oppload.read_result(path).detections) == 0
    part = path.rename(path.with_name("a.frames.csv.part"))
    part.with_name("a.detections.jsonl.part").write_text(whole)
    assert len(oppload.read_result(part).detections) == count


@pytest.mark.skipif(sys.platform == "win32", reason="no POSIX pipes")
def test_a_pipe_in_the_place_of_detections_is_told(tmp_path: Path) -> None:
    options: dict[str, Any] = {"rate": 30, "rmo": False, "models": REFERENCE, **NATIVE}
    path = oppload.run(np.stack(FRAMES), **options).save(tmp_path, "a")
    lines = path.with_name("a.detections.jsonl")
    lines.unlink()
    os.mkfifo(lines)
    with pytest.raises(
        ResultError, match=r"jsonl: cannot be read \(a pipe or a device, not a file"
    ):
        oppload.read_result(path)


TUNED: dict[str, Any] = {
    "l/v": ("klapoetke2017/loom-l-over-v", {"l/v": np.array([20, 80])}, ["--over", "l/v=20,80"]),
    "words": (
        "controls/looming-square",
        {"square.reverse": [True, False], "axis": None},
        ["--over", "square.reverse=true,false", "--over", "axis"],
    ),
}


@pytest.mark.long
@pytest.mark.parametrize(("stimulus", "over", "options"), TUNED.values(), ids=TUNED)
def test_a_tuning_has_the_files_of_the_command_line(
    stimulus: str, over: dict[str, Any], options: list[str], tmp_path: Path
) -> None:
    told = inside.oppload(
        "tune", stimulus, *options, "-o", tmp_path / "cli", "-q", "--plot", "none",
        "--change", "timing.before_s=0.1", "--set", "opplod_reference.periphery=0.5",
        "--jobs", "1",
    )  # fmt: skip
    assert told.returncode == 0
    tuning = oppload.tune(
        stimulus,
        over,
        changes={"timing.before_s": 0.1},
        settings={"opplod_reference.periphery": 0.5},
    )
    table = tuning.save(tmp_path / "api")
    assert table.read_bytes() == (tmp_path / "cli" / table.name).read_bytes()
    own, of_command = (
        json.loads((tmp_path / folder / table.name).with_suffix(".json").read_text())
        for folder in ("api", "cli")
    )
    assert own == of_command | {"command": []}
    assert own["summary"]["opplod_reference"]["largest_peak"] > 0
    again = oppload.read_tuning(table)
    pd.testing.assert_frame_equal(again.rows, tuning.rows)
    assert (again.parameters, again.name) == (tuning.parameters, tuning.name)


@pytest.mark.long
def test_tune_takes_numbers_of_numpy(tmp_path: Path) -> None:
    over = {"disk.luminance": np.array([0, 0.4])}
    given: dict[str, Any] = {"models": ["dlgmd"], "height": 60}
    number: Any = np.float32(0.5)
    ours = oppload.tune("controls/looming-contrast", over, indicator_s=number, **given)
    usual = oppload.tune("controls/looming-contrast", over, indicator_s=0.5, **given)
    ours.save(tmp_path)
    assert ours.sidecar == usual.sidecar
    assert ours.rows.equals(usual.rows)


def test_tune_refuses_names_that_are_no_text() -> None:
    wrong: Any = {1: 2}
    with pytest.raises(ParameterError, match="changes: a parameter is a word or a key, not 1"):
        oppload.tune("klapoetke2017/loom-l-over-v", changes=wrong)
    figures: Any = ["peak-time"]
    with pytest.raises(ParameterError, match="no such figure"):
        oppload.tune(figure=figures)


@pytest.mark.long
def test_a_tuning_is_replaced_only_if_that_is_asked_for(tmp_path: Path) -> None:
    tuning = oppload.tune(figure="contrast", over={"disk.luminance": [0, 0.4]}, models=["dlgmd"])
    assert repr(tuning).startswith("Tuning('contrast.tuning.csv', 2 rows over disk.luminance: dlgm")
    before = tuning.save(tmp_path).read_bytes()
    with pytest.raises(OutputError, match="exists already; choose if_exists='overwrite', or ano"):
        tuning.save(tmp_path)
    with pytest.raises(ParameterError, match="error or overwrite, not 'skip'"):
        tuning.save(tmp_path, if_exists="skip")
    assert tuning.save(tmp_path, if_exists="overwrite").read_bytes() == before


@pytest.mark.long
def test_a_tuning_tells_that_a_curve_means_little() -> None:
    slow = oppload.tune("klapoetke2017/bar-expand-10", {"axis": [0, 45]}, models=["opplod"])
    assert "1 doubt: see sidecar['doubts']" in repr(slow)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({}, "give a stimulus or a figure, one of the two"),
        ({"stimulus": "loom-l-over-v", "figure": "contrast"}, "one of the two"),
        ({"figure": "all"}, "figure must be one figure"),
        ({"figure": "peak"}, "no such figure; did you mean 'peak-time'?"),
        ({"figure": "p"}, "no such figure; choose bar-ends, contrast"),
        ({"stimulus": "loom-l-over-v", "over": "l/v"}, "over must be a dict by parameter"),
        ({"stimulus": "loom-l-over-v", "over": {"l/v": 40}}, "'l/v' must be a list, not 40"),
        (
            {"stimulus": "loom-l-over-v", "over": {"l/v": []}},
            "over l/v: its values cannot be read; write values such as [10, 20, 40], range(",
        ),
        (
            {"stimulus": "loom-l-over-v", "over": {"axis": None}},
            "; write over axis=VALUES, with VALUES such as [10, 20, 40], range(0, 360, 30)",
        ),
        (
            {"stimulus": "bar-expand-60", "over": {"axis": [0, 360]}},
            "leave one of the two out, as in range(0, 360, 45)",
        ),
        (
            {"stimulus": "looming-perspective"},
            "has no sweep of its own; give one, e.g. over={'direction': range(0, 360, 45)}",
        ),
        (
            {"stimulus": "loom-l-over-v", "over": {"l/v": [40]}, "changes": {"l/v": 20}},
            "changes disk.growth.l_over_v_ms: over sweeps it; leave one of the two out",
        ),
        (
            {"stimulus": "loom-l-over-v", "over": {"l/v": np.array(40)}},
            "over: the values of 'l/v' must be a list",
        ),
        ({"stimulus": "loom-l-over-v", "changes": {"wrd": 4}}, ": changes wrd: no key 'wrd'"),
        ({"stimulus": "loom-l-over-v", "changes": ["a"]}, "changes must be a dict by parameter"),
        ({"stimulus": "loom-l-over-v", "indicator_s": 61}, "0 to 60 seconds, not 61"),
        ({"stimulus": "loom-l-over-v", "indicator_s": "1"}, "0 to 60 seconds, not '1'"),
        ({"stimulus": "loom-l-over-v", "models": ["nothing"]}, "no model 'nothing'"),
        ({"stimulus": "loom-l-over-v", "settings": {"rmo.grid": 9}}, "rmo"),
        ({"stimulus": "nothing"}, "no stimulus 'nothing' in the catalogue"),
    ],
)
def test_wrong_uses_of_tune(arguments: dict[str, Any], said: str) -> None:
    with pytest.raises((ParameterError, StimulusError), match=re.escape(said)) as error:
        oppload.tune(**arguments)
    options_of_command = re.findall("--(?!model)\\w+", str(error.value))
    assert options_of_command == []


def test_a_tuning_without_any_peak_says_what_to_do() -> None:
    short = {"timing.before_s": 0, "timing.motion_s": 0.05, "timing.after_s": 0}
    with pytest.raises(ResultError, match="make the stimulus longer than the warm-up of the det"):
        oppload.tune("klapoetke2017/loom-l-over-v", {"l/v": [40]}, changes=short)
