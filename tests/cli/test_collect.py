from __future__ import annotations

import copy
import gc
import json
import re
import shutil
import sys
from typing import TYPE_CHECKING, Any

import pytest

from tests.cli.inside import oppload
from tests.results.make import rows_of

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path


@pytest.fixture(scope="module")
def results(clip: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A result with all files, and a result of a single model in a folder below."""
    folder = tmp_path_factory.mktemp("results")
    assert oppload("run", clip, "-o", folder, "--height", "60").returncode == 0
    words = ("--height", "60", "--model", "dlgmd", "--no-rmo", "--end", "f10")
    assert oppload("run", clip, "-o", folder / "deep", *words).returncode == 0
    return folder


@pytest.mark.long
def test_a_row_per_input_and_model(results: Path, clip: Path, tmp_path: Path) -> None:
    done = oppload("collect", results, "-o", tmp_path / "all.csv")
    assert (done.returncode, done.stdout) == (0, "")
    table = rows_of(tmp_path / "all.csv")
    # Results of one name are told apart by their folders.
    assert [(row["result"], row["model"], row["analysed"]) for row in table] == [
        *(("loom", "opplod", "24"), ("loom", "dlgmd", "24"), ("deep/loom", "dlgmd", "10"))
    ]
    assert {row["input"] for row in table} == {str(clip)}
    assert table[0]["frame_rate"] == "30"
    assert table[0]["complete"] == "true"
    sidecar: dict[str, Any] = json.loads((results / "loom.oppload.json").read_text())
    for row in table[:2]:
        summary = sidecar["summary"][row["model"]]
        assert float(row["peak"]) == pytest.approx(summary["peak"], rel=1e-8)
        alarm = summary["first_alarm_frame"]
        assert row["first_alarm_frame"] == ("" if alarm is None else str(alarm))


@pytest.mark.skipif(sys.platform == "win32", reason="each name is text there")
def test_a_row_holds_the_facts_of_its_sidecar(results: Path, tmp_path: Path) -> None:
    content = json.loads((results / "deep" / "loom.oppload.json").read_text())
    for part, names in (
        ("input", ("width", "height")),
        ("working", ("width", "height")),
        ("decode", ("decoded", "analysed", "missing", "dropped", "repeats", "near_repeats")),
    ):
        content[part].update({name: 101 + len(part) + at for at, name in enumerate(names)})
    content["input"] |= {"name": "a\udcff.mp4", "codec": "vp9", "frame_rate": "30000/1001"}
    content["decode"] |= {"pictures_per_s": 12.5, "complete": False}
    content["stimulus"] = {"name": "hit", "looming": True, "contact_time_s": 1.25}
    content["tool"]["oppload"], content["wall_s"], content["frames_per_s"] = "0.9", 7.5, 3.25
    unknown = copy.deepcopy(content)
    unknown["input"]["frame_rate"], unknown["stimulus"] = None, None
    for name, held in (("b\udcff", content), ("a", unknown)):  # without a table
        (tmp_path / f"{name}.oppload.json").write_text(json.dumps(held))
    assert oppload("collect", tmp_path, "-o", tmp_path / "all.csv").returncode == 0
    lacking, row = rows_of(tmp_path / "all.csv")
    about = list(row)[: list(row).index("model") + 1]
    assert " ".join(about) == (
        "result input kind codec width height frame_rate working_width working_height "
        "decoded analysed missing dropped repeats near_repeats pictures_per_s complete wall_s "
        "frames_per_s oppload stimulus looming contact_time_s model"
    )
    assert " ".join(row[name] for name in about) == (
        "b\\udcff a\\udcff.mp4 container vp9 106 107 29.97003 108 109 "
        "107 108 109 110 111 112 12.5 false 7.5 "
        "3.25 0.9 hit true 1.25 dlgmd"
    )
    empty = {name for name in about if not lacking[name]}
    assert empty == {"frame_rate", "stimulus", "looming", "contact_time_s"}


@pytest.mark.skipif(sys.platform == "win32", reason="links need a right there")
def test_what_was_collected_is_counted(results: Path, tmp_path: Path) -> None:
    deep, link = results / "deep", tmp_path / "link"
    link.symlink_to(results)
    for folders, said, names in (
        ([results], "2 results, 3 rows", ["loom", "loom", "deep/loom"]),
        ([deep], "1 result, 1 row", ["loom"]),
        # each once, by its name in the first folder
        ([deep, results, link], "2 results, 3 rows", ["loom", "loom", "loom"]),
    ):
        target = tmp_path / f"{len(folders)}-{folders[0].name}.csv"
        assert oppload("collect", *folders, "-o", target).stderr == f"{said} -> {target}\n"
        assert [row["result"] for row in rows_of(target)] == names
    done = oppload("collect", deep, "-o", target, "--if-exists", "overwrite")
    assert (done.returncode, len(rows_of(target))) == (0, 1)


def test_results_of_different_settings_are_told(results: Path, tmp_path: Path) -> None:
    """The detectors of a run and its inputs are no settings."""
    content = json.loads((results / "deep" / "loom.oppload.json").read_text())
    content["parameters"]["dlgmd"] |= {"group_size": 5, "threshold_factor": 2}
    content["parameters"]["alarm"]["factor"] = 9
    three = copy.deepcopy(content)
    content["parameters"]["alarm"]["hold_s"] = 1
    native = copy.deepcopy(content)
    native["height"] = "native"
    most = "dlgmd.group_size 4, 5; dlgmd.threshold_factor 1.2, 2; alarm.factor 9, auto"
    for other, said in (
        (three, most),
        (content, f"{most}; ..."),
        (native, "--height 60, native"),
    ):
        (tmp_path / "other.oppload.json").write_text(json.dumps(other))
        words = ("collect", results, tmp_path, "-o", tmp_path / "all.csv", "--if-exists")
        done = oppload(*words, "overwrite")
        assert done.returncode == 0
        line = f"oppload: the results have different settings: {said}"
        assert done.stderr.splitlines()[1:] == [line]


def test_all_frames_in_one_table(results: Path, clip: Path, tmp_path: Path) -> None:
    assert oppload("collect", results, "-o", tmp_path / "f.csv", "--frames").returncode == 0
    table = rows_of(tmp_path / "f.csv")
    assert [row["result"] for row in table] == ["loom"] * 24 + ["deep/loom"] * 10
    assert {row["input"] for row in table} == {str(clip)}
    for row, own in zip(table[:24], rows_of(results / "loom.frames.csv"), strict=True):
        assert {**row, **own} == row
    assert table[30]["opplod_response"] == table[30]["rmo_index"] == ""
    assert table[30]["dlgmd_response"] != ""
    # The default detectors always have columns.
    words = ("-o", tmp_path / "deep.csv", "--frames")
    assert oppload("collect", results / "deep", *words).returncode == 0
    assert rows_of(tmp_path / "deep.csv")[0].keys() == table[0].keys()


def test_times_keep_all_decimals(results: Path, tmp_path: Path) -> None:
    folder = tmp_path / "r"
    shutil.copytree(results / "deep", folder)
    table = folder / "loom.frames.csv"
    header, *lines = table.read_text().splitlines()
    late = [re.sub(r"^(\d+),[^,]*", r"\1,10\g<1>.033333333", line) for line in lines]
    table.write_text("\n".join([header, *late]) + "\n")
    assert oppload("collect", folder, "-o", tmp_path / "f.csv", "--frames").returncode == 0
    times = [row["time_s"] for row in rows_of(tmp_path / "f.csv")]
    assert times == [f"10{frame}.033333333" for frame in range(10)]


def test_frames_of_one_result_with_more_columns(clip: Path, tmp_path: Path) -> None:
    """The result with inner values, degrees and calcium comes first, one without them follows."""
    words = ("--height", "60", "--no-rmo", "--end", "f8", "-o")
    more = ("--columns", "all", "--fov", "60", "--model", "opplod_lplc2")
    assert oppload("run", clip, *words, tmp_path / "r" / "a", *more).returncode == 0
    assert oppload("run", clip, *words, tmp_path / "r" / "b").returncode == 0
    done = oppload("collect", tmp_path / "r", "-o", tmp_path / "f.csv", "--frames")
    assert (done.returncode, done.stderr) == (
        0,
        f"2 results, 16 rows -> {tmp_path / 'f.csv'}\n",
    )
    table = rows_of(tmp_path / "f.csv")
    for folder, rows in (("a", table[:8]), ("b", table[8:])):
        own_rows = rows_of(tmp_path / "r" / folder / "loom.frames.csv")
        for row, own in zip(rows, own_rows, strict=True):
            assert {**row, **own, "result": f"{folder}/loom"} == row


def test_parquet_holds_the_same(results: Path, tmp_path: Path) -> None:
    parquet = pytest.importorskip(
        "pyarrow.parquet", reason="NOT TESTED: pip install 'oppload[parquet]'"
    )
    for name, words in (("all", ()), ("frames", ("--frames",))):
        for suffix in ("csv", "parquet"):
            target = tmp_path / f"{name}.{suffix}"
            assert oppload("collect", results, "-o", target, *words).returncode == 0
        text = rows_of(tmp_path / f"{name}.csv")
        table = parquet.read_table(tmp_path / f"{name}.parquet").to_pylist()
        assert len(table) == len(text)
        for typed, written in zip(table, text, strict=True):
            assert typed.keys() == written.keys()
            for key, value in typed.items():
                if isinstance(value, bool):
                    assert written[key] == str(value).lower()
                elif isinstance(value, int | float):
                    assert float(written[key]) == pytest.approx(value, rel=1e-8)
                else:
                    assert written[key] == (value or "")


def test_a_bad_sidecar_is_named_and_spares_the_others(results: Path, tmp_path: Path) -> None:
    folder = tmp_path / "r"
    shutil.copytree(results, folder)
    good = json.loads((folder / "loom.oppload.json").read_text())
    bad = {
        "cut": json.dumps(good)[:500],
        "other": '{"schema": "mine/1"}',
        "list": "[]",
        "lacking": json.dumps({**good, "summary": {}}),
        "wrong": json.dumps({**good, "tool": 5}),
        "rate": json.dumps({**good, "input": {**good["input"], "frame_rate": "1/0"}}),
    }
    for name, text in bad.items():
        (folder / f"{name}.oppload.json").write_text(text)
    (folder / "alone.frames.csv").write_text("frame,time_s\n")
    done = oppload("collect", folder, "-o", tmp_path / "all.csv")
    assert done.returncode == 4
    *lines, _, _ = done.stderr.splitlines()
    named = [line.split(": ")[1] for line in lines]
    alone = f"{folder / 'alone'}.frames.csv"
    assert named == [alone, *(f"{folder / name}.oppload.json" for name in sorted(bad))]
    assert f"{alone}: has no sidecar" in done.stderr
    assert len(rows_of(tmp_path / "all.csv")) == 3


def test_frames_of_a_detector_that_is_not_loaded(results: Path, tmp_path: Path) -> None:
    for name in ("loom.frames.csv", "loom.oppload.json"):
        (tmp_path / name).write_text((results / name).read_text().replace("dlgmd", "mine"))
    done = oppload("collect", tmp_path, "-o", tmp_path / "all.csv", "--frames")
    assert done.returncode == 3
    assert "loom.frames.csv: its detector 'mine' is not known here; load it, as in" in done.stderr


@pytest.mark.parametrize("words", [(), ("--frames",)])
def test_results_of_which_none_can_be_read(tmp_path: Path, words: tuple[str, ...]) -> None:
    """The exit code is 3, as if a run cannot read any input; no table remains."""
    folder = tmp_path / "r"
    folder.mkdir()
    (folder / "cut.oppload.json").write_text('{"schema":')
    done = oppload("collect", folder, "-o", tmp_path / "all.csv", *words)
    assert done.returncode == 3
    first, last = done.stderr.splitlines()
    assert "cut.oppload.json: is not valid JSON" in first
    assert last == f"oppload: {folder}: no result could be read; run its input again"
    assert not (tmp_path / "all.csv").exists()


def test_wrong_use(results: Path, tmp_path: Path) -> None:
    (tmp_path / "there.csv").write_text("mine")
    (tmp_path / "empty").mkdir()
    before = sorted(tmp_path.rglob("*"))
    for folder, name, sentence in (
        (results, "there.csv", "exists already; choose --if-exists overwrite"),
        (results, "all.xlsx", "is neither .csv nor .parquet"),
        (tmp_path / "empty", "all.csv", "holds no result of 'oppload run'"),
        (tmp_path / "there.csv", "all.csv", "is a file; give the folder of the results"),
        (tmp_path / "missing", "all.csv", "cannot be read (no such file or directory)"),
    ):
        done = oppload("collect", folder, "-o", tmp_path / name)
        assert (done.returncode, done.stderr.count("\n")) == (2, 1)
        assert sentence in done.stderr
    assert sorted(tmp_path.rglob("*")) == before


def test_a_parquet_that_fails_is_dropped_without_a_word(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from oppload_cli.files.tables import open_table

    pytest.importorskip("pyarrow", reason="NOT TESTED: pip install 'oppload[parquet]'")
    told: list[object] = []
    monkeypatch.setattr(sys, "unraisablehook", told.append)
    with pytest.raises(KeyboardInterrupt), open_table(tmp_path / "a.parquet", {"n": int}):
        raise KeyboardInterrupt
    gc.collect()  # now the writer is deleted
    assert (told, list(tmp_path.iterdir())) == ([], [])


def test_without_pyarrow(results: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from oppload_cli.errors import OutputError
    from oppload_cli.files.tables import open_table

    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with (
        pytest.raises(OutputError, match=r"pip install 'oppload\[parquet\]', or choose a \.csv"),
        open_table(tmp_path / "a.parquet", {"frame": int}),
    ):
        raise AssertionError
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda lines: ["\ufeff" + lines[0], *lines[1:]], ""),
        (lambda lines: lines[:20], "holds 19 complete rows, but its run wrote 24; run its input"),
        (lambda lines: [*lines[:24], "23,0.7CUT"], "holds 23 complete rows, but its run wrote 24"),
        (lambda _lines: [], "holds 0 complete rows, but its run wrote 24"),
        (lambda lines: [*lines, lines[1]], "holds 25 complete rows, but its run wrote 24"),
        (lambda lines: put(lines, "text"), "column 'frame' holds 'text' in line 10, which is"),
        (lambda lines: put(lines, "8.5"), "holds '8.5' in line 10, which is not a whole number"),
        (lambda lines: put(lines, "NaN"), "column 'frame' is empty in line 10"),
        (lambda lines: put(lines, "8,1,2"), "CSV table (line 10 has 27 cells, not 25); run its"),
        (lambda lines: put(lines, "2"), "holds '2' in line 10, which is not above the value in"),
        (
            lambda lines: [f"{lines[0]},mine", *(f"{each},1" for each in lines[1:])],
            "is no table of",
        ),
    ],
)
def test_the_rows_of_each_table_are_checked(
    results: Path, tmp_path: Path, change: Callable[[list[str]], list[str]], reason: str
) -> None:
    folder = tmp_path / "r"
    shutil.copytree(results, folder)
    table = folder / "loom.frames.csv"
    lines = table.read_text().splitlines()
    # The last row of an interrupted run has no line end.
    table.write_text("".join(f"{line}\n" for line in change(lines)).removesuffix("CUT\n"), "utf-8")
    done = oppload("collect", folder, "-o", tmp_path / "f.csv", "--frames")
    assert done.returncode == (4 if reason else 0)
    assert (f"{table}: " in done.stderr) == bool(reason)
    assert reason in done.stderr
    assert "1 result could not be collected" in done.stderr or not reason
    # The summary needs only the number of rows.
    done = oppload("collect", folder, "-o", tmp_path / "all.csv")
    assert done.returncode == (4 if "complete rows" in reason else 0)
    assert (reason in done.stderr) == ("complete rows" in reason or not reason)


def test_a_summary_needs_no_table(results: Path, tmp_path: Path) -> None:
    (tmp_path / "a.oppload.json").write_text((results / "loom.oppload.json").read_text())
    assert oppload("collect", tmp_path, "-o", tmp_path / "all.csv").returncode == 0
    done = oppload("collect", tmp_path, "-o", tmp_path / "f.csv", "--frames")
    assert done.returncode == 3
    assert f"{tmp_path / 'a'}.frames.csv: there is no such file; run its input" in done.stderr


def put(lines: list[str], text: str) -> list[str]:
    """Return the lines of a table with a text in the place of the frame number in line 10."""
    return [*lines[:9], text + lines[9].removeprefix("8"), *lines[10:]]


@pytest.mark.slow
def test_ten_thousand_sidecars(results: Path, tmp_path: Path) -> None:
    text = (results / "loom.oppload.json").read_text()
    for number in range(10_000):
        (tmp_path / f"clip{number:05d}.oppload.json").write_text(text)
    assert oppload("collect", tmp_path, "-o", tmp_path / "all.csv").returncode == 0
    table = rows_of(tmp_path / "all.csv")
    assert len(table) == 20_000
    assert table[-1]["result"] == "clip09999"
