from __future__ import annotations

import json
import sys
from itertools import chain
from typing import TYPE_CHECKING

import pytest

from oppload_cli.cli.plot import plot
from oppload_cli.plots.tuning_plots import KINDS
from tests.cli import process
from tests.cli.inside import oppload
from tests.results.make import frame_rows, write_result, write_rows, write_tuning

if TYPE_CHECKING:
    from pathlib import Path

    Row = dict[str, str]


def without(*names: str) -> list[Row]:
    return [{k: v for k, v in row.items() if k not in names} for row in frame_rows()]


def changed(line: int, name: str, value: str) -> list[Row]:
    rows = frame_rows()
    rows[line][name] = value
    return rows


def emptied(name: str) -> list[Row]:
    return [{**row, name: ""} for row in frame_rows()]


@pytest.mark.parametrize(
    ("rows", "options", "sentence"),
    [
        ([{"t": "0", "v": "1"}], [], "has no column 'frame'"),  # of another tool
        (  # of a spreadsheet
            [{"frame;time_s": "0;0"}],
            [],
            "is not a CSV table (its cells are separated by semicolons, not by commas); save it",
        ),
        (without("time_s"), [], "has no column 'time_s'"),
        (without("opplod_response", "dlgmd_response"), [], "has no column 'opplod_response'"),
        (without("dlgmd_response"), ["--model", "dlgmd"], "has no column 'dlgmd_response'"),
        (frame_rows()[:1], [], "column 'frame' holds one row"),
        (frame_rows()[:3], [], "column 'opplod_response' is empty in every"),  # warm-up only
        (changed(9, "opplod_response", "inf"), [], "holds 'inf' in line 11"),
        (changed(4, "opplod_response", "much"), [], "holds 'much' in line 6"),
        (changed(4, "time_s", ""), [], "column 'time_s' is empty in line 6"),
        (without("rmo_index"), ["--kind", "rmo"], "has no column 'rmo_index'"),
        (emptied("rmo_mean"), ["--kind", "rmo"], "column 'rmo_mean' is empty"),
        (without("opplod_unit_x"), ["--kind", "map"], "has no column 'opplod_unit_x'"),
        (emptied("opplod_unit_x"), ["--kind", "map"], "column 'opplod_unit_x' is empty"),
        (frame_rows(), ["--kind", "polar"], "has no column 'stimulus'"),
        (frame_rows(), ["--onset", "f99"], "a.frames.csv ends at frame 39; give a later time"),
        (frame_rows(), ["--contact", "soon"], "--contact: 'soon' is no position"),
        (
            frame_rows(),
            ["--onset", "f20", "--contact", "0.5"],
            "the onset, 1 s, is after the contact, 0.5 s; correct --onset or --contact",
        ),
    ],
)
def test_a_wrong_result(rows: list[Row], options: list[str], sentence: str, tmp_path: Path) -> None:
    path = write_rows(tmp_path / "a.frames.csv", rows)
    done = oppload("plot", path, *options, "-o", tmp_path / "a.png")
    assert done.returncode == 2
    assert sentence in done.stderr
    assert str(path) in done.stderr or options[1:] == ["soon"]
    assert len(done.stderr.strip().splitlines()) == 1
    assert not (tmp_path / "a.png").exists()


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("stimulus,bar.axis_deg,model\na,0,opplod\n", "has no column 'peak'"),
        ("stimulus,model,peak\na,opplod,1\n", "has no column of a swept parameter"),
        ("stimulus,bar.axis_deg,model,peak\na,0,lgmd,1\n", "its detector 'lgmd' is not known here"),
        ("stimulus,bar.axis_deg,model,peak\na,0,opplod,\n", "column 'peak' is empty in line 2"),
        ("stimulus,bar.axis_deg,model,peak\na,0,opplod,x\n", "column 'peak' holds 'x' in line 2"),
        ("stimulus,bar.axis_deg,model,peak\n", "holds no row"),
    ],
)
def test_a_wrong_tuning_table(text: str, sentence: str, tmp_path: Path) -> None:
    path = tmp_path / "a.tuning.csv"
    path.write_text(text)
    done = oppload("plot", path)
    assert (done.returncode, done.stdout) == (2, "")
    assert sentence in done.stderr
    assert not list(tmp_path.glob("*.png"))


@pytest.mark.usefixtures("undrawn")
def test_results_of_different_lengths(tmp_path: Path) -> None:
    paths = [write_result(tmp_path / f"{n}.frames.csv", n) for n in (40, 30)]
    figure = tmp_path / "both.png"
    one = ("--model", "opplod")
    done = oppload("plot", *paths, *one, "-o", figure)
    assert done.returncode == 2
    assert "column 'frame' has 40 rows" in done.stderr
    assert oppload("plot", *paths, *one, "-o", figure, "--any-length").returncode == 0
    assert oppload("plot", *paths, "-o", figure).returncode == 0  # a panel each
    assert figure.exists()


@pytest.mark.usefixtures("undrawn")
def test_the_look_of_a_figure(tmp_path: Path) -> None:
    paths = [write_result(tmp_path / f"{name}.frames.csv") for name in "ab"]
    figure = tmp_path / "both.svg"
    look = ("--title", "My title", "--label", "first", "--label", "second", "--xlim", "-1", "0.5")
    done = oppload(
        "plot", *paths, "-o", figure, "--scale", "raw", "--align", "contact",
        "--contact", "1.5", *look,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    drawn = figure.read_text()
    for text in ("My title", "first", "second", "time from contact (s)"):
        assert f"<!-- {text} -->" in drawn
    done = oppload("plot", *paths, "-o", figure, "--label", "one")
    assert (done.returncode, "1 label for 2 results" in done.stderr) == (2, True)
    done = oppload("plot", *paths, "-o", figure, "--align", "contact")
    assert (done.returncode, "its time of contact is not known" in done.stderr) == (2, True)


@pytest.mark.usefixtures("undrawn")
def test_contacts_come_from_a_manifest(tmp_path: Path) -> None:
    for name, contact in (("a", 20), ("b", 30)):
        write_result(tmp_path / f"{name}.frames.csv", peak=contact)
        sidecar = {"input": {"name": f"{name}.avi"}}
        (tmp_path / f"{name}.oppload.json").write_text(json.dumps(sidecar))
        (tmp_path / f"{name}.avi").touch()
    manifest = tmp_path / "manifest.csv"
    manifest.write_text(
        "file,label,onset_frame,contact_frame\na.avi,looming,5,20\nb.avi,looming,6,30\n"
    )
    figure = tmp_path / "both.svg"
    arguments = ("plot", tmp_path / "a.frames.csv", tmp_path / "b.frames.csv", "-o", figure)
    aligned = (*arguments, "--align", "contact", "--model", "opplod", "--scale", "peak")
    done = oppload(*aligned, "--manifest", manifest)
    assert (done.returncode, done.stderr) == (0, "")
    drawn = figure.read_text()
    assert "<!-- a, peak 1 at 0.00 s -->" in drawn
    assert "<!-- b, peak 1 at 0.00 s -->" in drawn
    assert "<!-- onset -->" in drawn


@pytest.mark.usefixtures("undrawn")
def test_of_several_clips_of_one_name_the_path_decides(tmp_path: Path) -> None:
    for name, contact in (("a", 20), ("b", 30)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "clip.avi").touch()
        write_result(tmp_path / f"{name}.frames.csv", peak=contact)
        sidecar = {"input": {"name": f"{name}/clip.avi"}}
        (tmp_path / f"{name}.oppload.json").write_text(json.dumps(sidecar))
    manifest = tmp_path / "manifest.csv"
    rows = [f"{name}/clip.avi,looming,5,{contact}" for name, contact in (("a", 20), ("b", 30))]
    head = "file,label,onset_frame,contact_frame"
    manifest.write_text("\n".join([head, *rows, "c.avi,none,,"]) + "\n")
    figure = tmp_path / "one.svg"
    drawing = ("--align", "contact", "--model", "opplod", "--scale", "peak", "-o", figure)
    for name in "ab":
        done = oppload("plot", tmp_path / f"{name}.frames.csv", *drawing, "--manifest", manifest)
        assert done.returncode == 0
        assert "row 4: c.avi: there is no such file" in done.stderr
        assert "<!-- OppLoD, peak 1 at 0.00 s -->" in figure.read_text()
    (tmp_path / "a.oppload.json").write_text(json.dumps({"input": {"name": "z/clip.avi"}}))
    done = oppload("plot", tmp_path / "a.frames.csv", *drawing, "--manifest", manifest)
    assert (done.returncode, "are named 'clip.avi'; plot it from" in done.stderr) == (2, True)


@pytest.mark.usefixtures("undrawn")
def test_a_contact_after_the_end_is_given_in_seconds(tmp_path: Path) -> None:
    table = write_result(tmp_path / "a.frames.csv", 40)
    done = oppload("plot", table, "--contact", "f63")
    assert done.returncode == 2
    assert "ends at frame 39; give a later time in seconds, such as --contact " in done.stderr
    seconds = done.stderr.rpartition(" ")[2].strip()
    assert oppload("plot", table, "--contact", seconds).returncode == 0


@pytest.mark.long
def test_one_figure_beside_each_result(tmp_path: Path) -> None:
    paths = [write_result(tmp_path / f"{name}.frames.csv") for name in "ab"]
    done = oppload("plot", *paths, "--onset", "f10", "--contact", "1.5")
    made = [tmp_path / f"{name}.frames.png" for name in "ab"]
    assert done.returncode == 0
    assert done.stdout.split() == [str(path) for path in made]
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in made)


@pytest.mark.usefixtures("undrawn")
def test_each_figure_has_the_label_of_its_result(tmp_path: Path) -> None:
    paths = [write_result(tmp_path / f"{name}.frames.csv") for name in "ab"]
    figures = []
    for drawn, labels in ((paths[1:], ["right"]), (paths, ["left", "right"])):
        words = chain.from_iterable(("--label", label) for label in labels)
        assert oppload("plot", *drawn, *words, "--scale", "raw").returncode == 0
        figures.append((tmp_path / "b.frames.png").read_bytes())
    assert figures[0] == figures[1]
    done = oppload("plot", *paths, "--label", "both")
    assert done.returncode == 2
    assert "1 label for 2 figures; give one for each, or none" in done.stderr


def test_a_file_beside_a_table_is_no_table(tmp_path: Path) -> None:
    sidecar = tmp_path / "a.oppload.json"
    sidecar.write_text("{}")
    done = oppload("plot", sidecar)
    assert done.returncode == 2
    assert done.stderr == (
        f"oppload: {sidecar}: is not a CSV table; give a frames.csv of 'oppload run'\n"
    )


@pytest.mark.parametrize("name", ["a", "a.csv", "a.mp4", "a.oppload.json", "a.detections.jsonl"])
def test_a_message_names_the_table_of_another_file_of_a_result(tmp_path: Path, name: str) -> None:
    table = write_result(tmp_path / "a.frames.csv")
    given = tmp_path / name
    if given.suffix in {".mp4", ".json", ".jsonl"} and not given.exists():
        given.touch()
    done = oppload("plot", given)
    assert done.returncode == 2
    assert done.stderr.endswith(f"; did you mean '{table}'?\n")


def test_a_message_names_the_characters_that_no_font_has(tmp_path: Path) -> None:
    table = write_result(tmp_path / "a.frames.csv")
    done = oppload("plot", table, "-o", tmp_path / "a.svg", "--title", "disk \U00012000")
    assert done.returncode == 0
    assert "a.svg: no font has \U00012000, so that the figure shows boxes" in done.stderr


@pytest.mark.usefixtures("undrawn")
def test_lists_and_collected_tables_are_no_results(tmp_path: Path) -> None:
    """``oppload plot results/*.csv`` names them too."""
    own = write_result(tmp_path / "a.frames.csv")
    lists = [tmp_path / name for name in ("alarms.csv", "failures.csv", "alarms-2-of-3.csv")]
    for path in lists:
        path.write_text("video,model\n")
    lists.append(tmp_path / "all.csv")
    lists[-1].write_text("result,input,frame,time_s\n")
    for path in lists:
        assert oppload("plot", path).stderr == (
            f"oppload: {path}: lists several results; give a frames.csv of 'oppload run', or the "
            "folder of the results\n"
        )
    done = oppload("plot", *lists, own)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == f"{tmp_path / 'a.frames.png'}\n"


@pytest.mark.long
def test_the_settings_of_matplotlib_of_a_user_change_nothing(tmp_path: Path) -> None:
    table = write_result(tmp_path / "a.frames.csv")
    settings = tmp_path / "matplotlibrc"
    settings.write_text("text.usetex: True\nfont.size: 30\nsavefig.bbox: tight\n")
    plain, own = tmp_path / "plain.svg", tmp_path / "own.svg"
    assert oppload("plot", table, "-o", plain).returncode == 0
    words, rc = ("plot", table, "-o", own), str(settings)
    done = process.oppload(*words, MPLBACKEND="nosuch", MATPLOTLIBRC=rc, SOURCE_DATE_EPOCH="today")
    assert (done.returncode, done.stderr) == (0, "")
    assert plain.read_bytes() == own.read_bytes()


@pytest.mark.usefixtures("undrawn")
def test_polar_prints_peak_and_selectivity(tmp_path: Path) -> None:
    angles = {"scene.rotation_deg": [0.0, 90, 180, 270]}
    path = write_tuning(
        tmp_path / "a.tuning.csv", angles, {"opplod": [3.0, 1, 1, 1]}, name="controls/x"
    )
    done = oppload("plot", path, "--kind", "polar")
    assert done.returncode == 0
    assert (
        "OppLoD: peak 3 (arbitrary unit) at 0 deg, direction selectivity index 0.500" in done.stderr
    )
    assert "LPLC2" not in done.stderr
    overlaid = oppload("plot", path, "--lplc2", "60")
    assert "LPLC2, 60 deg bar: peak 0.23 (of the loom)" in overlaid.stderr


@pytest.mark.skipif(sys.platform == "win32", reason="Windows always has one")
@pytest.mark.usefixtures("undrawn")
def test_show_needs_a_display(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    path = write_result(tmp_path / "a.frames.csv")
    done = oppload("plot", path, "--show")
    assert (done.returncode, "--show needs a display" in done.stderr) == (2, True)
    shown: list[str] = []
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr("click.launch", shown.append)  # returns None, which counts as exit code 0
    assert oppload("plot", path, "--show").returncode == 0
    assert shown == [str(tmp_path / "a.frames.png")]


def test_a_wrong_name_of_a_figure_or_model(tmp_path: Path) -> None:
    path = write_result(tmp_path / "a.frames.csv")
    done = oppload("plot", path, "-o", "a.gif")
    assert (done.returncode, "ends in .png, .svg or .pdf" in done.stderr) == (2, True)
    done = oppload("plot", path, "--model", "dlgdm")
    assert (done.returncode, "did you mean 'dlgmd'" in done.stderr) == (2, True)


@pytest.mark.usefixtures("undrawn")
def test_detectors_may_be_named_with_commas(tmp_path: Path) -> None:
    path = write_result(tmp_path / "a.frames.csv")
    figures = []
    for words in (("--model", "opplod,dlgmd"), ("--model", "opplod", "--model", "dlgmd")):
        assert oppload("plot", path, *words, "-o", tmp_path / "a.png").returncode == 0
        figures.append((tmp_path / "a.png").read_bytes())
    assert figures[0] == figures[1]


@pytest.mark.long
def test_a_flat_video_gives_zeros(tmp_path: Path) -> None:
    import numpy as np

    from tests.media import write_video

    video = write_video(tmp_path / "flat.avi", [np.full((48, 64), 90, np.uint8)] * 12)
    assert oppload("run", video, "-o", tmp_path, "-q").returncode == 0
    table = tmp_path / "flat.frames.csv"
    assert "nan" not in table.read_text()
    for kind in ("curves", "rmo"):
        done = oppload("plot", table, "--kind", kind, "-o", tmp_path / f"{kind}.png")
        assert (done.returncode, done.stderr) == (0, "")
    done = oppload("plot", table, "--kind", "map", "-o", tmp_path / "map.png")
    assert (done.returncode, "OppLoD never responded" in done.stderr) == (2, True)


@pytest.mark.usefixtures("undrawn")
def test_a_damaged_ground_truth_is_left_out_and_told(tmp_path: Path) -> None:
    path = write_result(tmp_path / "clip.frames.csv")
    (tmp_path / "clip.stimulus.json").write_text("{")
    done = oppload("plot", path, "-o", tmp_path / "a.png")
    assert done.returncode == 0
    assert f"{path}: its ground truth is left out ({tmp_path / 'clip.stimulus.json'}" in done.stderr
    assert (tmp_path / "a.png").exists()


@pytest.mark.long
@pytest.mark.usefixtures("undrawn")
def test_a_result_without_a_response_does_not_keep_the_others_from_being_drawn(
    tmp_path: Path,
) -> None:
    good = write_result(tmp_path / "good.frames.csv")
    short = write_rows(tmp_path / "short.frames.csv", frame_rows()[:2])
    left_out = f"oppload: left out: {short}: column 'opplod_response' is empty in every row"
    done = oppload("plot", tmp_path)
    assert (done.returncode, done.stdout) == (4, f"{good.with_suffix('.png')}\n")
    assert done.stderr.startswith(left_out)
    both = tmp_path / "both.svg"
    names = ("--label", "first", "--label", "second", "--model", "opplod", "-o", both)
    done = oppload("plot", short, good, *names)
    assert (done.returncode, done.stdout) == (4, f"{both}\n")
    assert done.stderr.startswith(left_out)
    assert "<!-- second" in both.read_text()
    assert "<!-- first" not in both.read_text()
    # A plot of RMO needs no responses; RMO exists from the second frame.
    done = oppload("plot", tmp_path, "--kind", "rmo")
    assert (done.returncode, done.stderr) == (0, "")
    assert short.with_suffix(".rmo.png").exists()
    # If none of the results can be drawn, the command fails.
    assert oppload("plot", short).returncode == 2
    done = oppload("plot", short, short)
    assert (done.returncode, done.stdout) == (2, "")
    done = oppload("plot", short, short, "-o", both)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)


@pytest.mark.usefixtures("undrawn")
def test_another_kind_has_a_name_of_its_own(tmp_path: Path) -> None:
    table = write_result(tmp_path / "a.frames.csv")
    tuned = write_tuning(
        tmp_path / "b.tuning.csv", {"bar.axis_deg": [0.0, 90]}, {"opplod": [3.0, 1]}
    )
    for path, kind, name in (
        (table, "curves", "a.frames.png"), (table, "map", "a.frames.map.png"),
        (tuned, "polar", "b.tuning.png"), (tuned, "line", "b.tuning.line.png"),
    ):  # fmt: skip
        done = oppload("plot", path, "--kind", kind)
        assert done.returncode == 0
        assert done.stdout.splitlines()[-1] == str(tmp_path / name)
    assert len(list(tmp_path.glob("*.png"))) == 4


def test_every_kind_of_plot_of_a_tuning_table_is_offered() -> None:
    """The command repeats the kinds, so that its help loads no matplotlib."""
    (kind,) = (each for each in plot.params if each.name == "kind")
    assert kind.to_info_dict()["type"]["choices"] == ("curves", "rmo", "map", *KINDS)


@pytest.mark.parametrize(
    ("table", "options", "sentence"),
    [
        ("b", ["--align", "contact"], "--align has no effect on --kind polar"),
        ("b", ["--any-length"], "--any-length has no effect on --kind polar"),
        ("b", ["--kind", "line", "--lplc2", "10"], "--lplc2 has no effect on --kind line"),
        ("b", ["--no-published"], "--no-published has no effect on --kind polar"),
        ("a", ["--kind", "map", "--scale", "raw"], "--scale has no effect on --kind map"),
        ("a", ["--kind", "map", "--label", "x"], "--label has no effect on --kind map"),
        ("a", ["--kind", "rmo", "--no-threshold"], "--no-threshold has no effect on --kind rmo"),
        ("a", ["--video", "a.mp4"], "--video has no effect on --kind curves"),
    ],
)
def test_an_option_without_effect_is_an_error(
    table: str, options: list[str], sentence: str, tmp_path: Path
) -> None:
    write_result(tmp_path / "a.frames.csv")
    write_tuning(tmp_path / "b.tuning.csv", {"bar.axis_deg": [0.0, 90]}, {"opplod": [3.0, 1]})
    suffix = "frames" if table == "a" else "tuning"
    done = oppload("plot", tmp_path / f"{table}.{suffix}.csv", *options)
    assert (done.returncode, done.stdout) == (2, "")
    assert f"oppload: {sentence}; leave it out\n" == done.stderr
    assert not list(tmp_path.glob("*.png"))


@pytest.mark.usefixtures("undrawn")
def test_a_map_without_a_sidecar_says_so(tmp_path: Path) -> None:
    table = write_result(tmp_path / "a.frames.csv")
    done = oppload("plot", table, "--kind", "map")
    assert done.returncode == 0
    assert done.stderr == (
        f"oppload: {table}: the map has no video (no sidecar names the video of this result; name "
        "it with --video (in Python video=PATH)), so its background is white\n"
    )
    (tmp_path / "a.oppload.json").write_text(
        json.dumps({"input": {"name": "gone.avi", "kind": "container", "width": 64, "height": 48}})
    )
    done = oppload("plot", table, "--kind", "map")
    assert "the map has no video (gone.avi: is not found; say where" in done.stderr


@pytest.mark.usefixtures("undrawn")
def test_the_threshold_that_a_table_states_is_drawn(tmp_path: Path) -> None:
    """It is that of the run: what the table has no row for belongs to its background too."""
    stated = [{**row, "opplod_threshold": "0.5"} for row in frame_rows()]
    figures = []
    for rows in (frame_rows(), stated):
        done = oppload("plot", write_rows(tmp_path / "a.frames.csv", rows), "--model", "opplod")
        assert done.returncode == 0
        figures.append((tmp_path / "a.frames.png").read_bytes())
    assert figures[0] != figures[1]
