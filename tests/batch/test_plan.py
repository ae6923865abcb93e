from __future__ import annotations

import io
import os
import sys
import threading
from pathlib import Path
from types import SimpleNamespace

import pytest

from oppload_cli.batch.plan import (
    Failure,
    Tally,
    failed_in,
    parse_shard,
    planned,
    read_list,
    write_failures,
)
from oppload_cli.errors import ParameterError
from oppload_cli.pipeline.task import Outcome
from oppload_cli.processes import threads
from oppload_cli.results.alarm_log import in_words, verdicts_in, write_alarms


@pytest.fixture
def tree(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for name in ("b.mp4", "a/x.avi", "a/deep/x.avi", "a/note.txt", ".hidden/h.mp4", "a/._x.avi"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    for name in ("images/f_1.png", "images/f_2.png", "plots/curve.png", "empty/none.txt"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    monkeypatch.chdir(tmp_path)
    return tmp_path


def names(*named: str, recursive: bool = False) -> list[str]:
    plan = planned(named, recursive=recursive)
    assert not plan.failures
    return [source.name.replace(os.sep, "/") for source in plan.inputs]


@pytest.mark.usefixtures("tree")
def test_folders_patterns_and_files_are_sorted_and_each_once() -> None:
    assert names("b.mp4", "a", "a/x.avi", "./a/../b.mp4") == ["a/x.avi", "b.mp4"]
    assert names(".", recursive=True) == ["./a/deep/x.avi", "./a/x.avi", "./b.mp4", "./images"]
    assert names("a/**/*.avi") == ["a/deep/x.avi", "a/x.avi"]
    assert names("*.mp4", "camera:0", "http://host/a?b=[1].mp4") == [
        *("b.mp4", "camera:0", "http://host/a?b=[1].mp4")
    ]


@pytest.mark.skipif(sys.platform == "win32", reason="no links")
def test_links_are_inputs_of_their_own_if_their_results_are(tree: Path) -> None:
    """As in a data set whose files are links to one store, in which equal files are one."""
    for folder in ("s1", "s2", "s3"):
        (tree / folder).mkdir()
        (tree / folder / "x.avi").symlink_to("../a/x.avi")
    links = ["s1/x.avi", "s2/x.avi", "s3/x.avi"]
    assert names("s?/*.avi", "./s1/x.avi") == links
    assert names("a", *links) == ["a/x.avi"]  # of one result
    (tree / "here").symlink_to("s1")
    assert names("here", "s1/x.avi") == ["here/x.avi"]


@pytest.mark.usefixtures("tree")
def test_results_keep_the_folders_of_their_inputs() -> None:
    plan = planned(["."], recursive=True)
    stems = {Path(source.name): Path(source.stem) for source in plan.inputs}
    assert stems[Path("a/deep/x.avi")] == Path("a/deep/x")
    assert stems[Path("a/x.avi")] == Path("a/x")
    assert stems[Path("images")] == Path("images")
    for name, stem in stems.items():
        [alone] = planned([str(name)]).inputs
        assert alone.stem == stem.name


@pytest.mark.usefixtures("tree")
def test_inputs_whose_results_would_have_one_name_are_refused_but_the_first() -> None:
    plan = planned(["a/x.avi", "b.mp4", "a/deep/x.avi"])
    assert [(source.name, source.stem) for source in plan.inputs] == [
        ("a/deep/x.avi", "x"),
        ("b.mp4", "b"),
    ]
    [failure] = plan.failures
    assert (failure.name, failure.code) == ("a/x.avi", 2)
    assert (
        "same names as those of a/deep/x.avi; give a folder of both with --recursive"
        in failure.message
    )
    [failure] = planned(["none/x.mp4", "nowhere/x.mp4"]).failures  # in no folder
    assert "as those of none/x.mp4; rename it, or run it alone with another --" in failure.message


@pytest.mark.usefixtures("tree")
def test_a_name_that_matches_nothing_fails_and_does_not_hide_the_others() -> None:
    plan = planned(["*.mkv", "empty", "b.mp4", "*.mkv"], recursive=True)
    assert [source.name for source in plan.inputs] == ["b.mp4"]
    assert [(failure.name, failure.code) for failure in plan.failures] == [
        ("*.mkv", 3),
        ("empty", 3),
    ]
    assert "matches no file" in plan.failures[0].message
    assert "no video and no numbered images" in plan.failures[1].message


def test_images_that_are_named_one_by_one_fail_once(tree: Path) -> None:
    (tree / "c.png").touch()
    plan = planned(["images/*.png", "images/f_1.png", "plots/curve.png", "b.mp4", "c.png"])
    assert [source.name for source in plan.inputs] == ["b.mp4", "c.png", "plots/curve.png"]
    message = (
        "images: 2 of its images are given one by one, and a single image shows no motion; give "
        "the folder, or a pattern such as frame_%03d.png"
    )
    assert plan.failures == [Failure("images", "", 3, message)]
    (tree / "d.png").touch()
    [failure] = planned(["c.png", "d.png"]).failures
    assert failure.message.startswith(".: 2 of its images are given one by one")


def test_a_ground_truth_beside_its_video_is_no_input(tree: Path) -> None:
    for name in ("a/x.stimulus.json", "images.stimulus.json", "other.stimulus.json"):
        (tree / name).touch()
    assert names("a/x.*", "images", "images.stimulus.json", "other.stimulus.json") == [
        *("a/x.avi", "images", "other.stimulus.json")
    ]


def test_a_name_with_brackets_is_itself_first(tree: Path) -> None:
    (tree / "c[1].mp4").touch()
    (tree / "c1.mp4").touch()
    assert names("c[1].mp4") == ["c[1].mp4"]


@pytest.mark.parametrize("of", [1, 3, 8, 40])
def test_shards_are_the_plan_and_never_overlap(of: int) -> None:
    plan = planned([*(f"clip{n}.mp4" for n in range(30)), "none*.mp4"])
    shards = [plan.shard(number, of) for number in range(1, of + 1)]
    together = [source for shard in shards for source in shard.inputs]
    assert sorted(together, key=lambda source: source.name) == plan.inputs
    assert max(map(len, shards)) <= 30 // of + 2
    assert [failure.name for shard in shards for failure in shard.failures] == ["none*.mp4"]


def test_the_first_and_the_last_shard() -> None:
    assert [parse_shard(text) for text in ("1/8", "8/8", "1/1")] == [(1, 8), (8, 8), (1, 1)]


@pytest.mark.parametrize("text", ["0/8", "9/8", "1", "1/0", "a/b", "-1/8", "1/8/2", "²/8", ""])
def test_a_shard_that_is_not_valid(text: str) -> None:
    with pytest.raises(ParameterError, match="1/8 to 8/8"):
        parse_shard(text)


def test_lists(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "list"
    path.write_bytes(b" a b.mp4 \r\n\n#c.mp4")
    assert read_list(str(path)) == [" a b.mp4 ", "#c.mp4"]
    path.write_bytes(b"\xff.mp4")
    if sys.platform == "win32":
        with pytest.raises(ParameterError, match="is not text in UTF-8; save it as UTF-8"):
            read_list(str(path))
    else:
        assert read_list(str(path)) == ["\udcff.mp4"]
    path.write_bytes(b"one.mp4")
    assert read_list(str(path), null=True) == ["one.mp4"]
    path.write_bytes(b"line\nend.mp4\0b.mp4\0")
    assert read_list(str(path), null=True) == ["line\nend.mp4", "b.mp4"]
    with pytest.raises(ParameterError, match="add -0"):
        read_list(str(path))
    path.write_bytes(b"a.mp4\nb.mp4\n")
    with pytest.raises(ParameterError, match="do not end in NUL; leave out -0"):
        read_list(str(path), null=True)
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(b"c.mp4\n")))
    assert read_list("-") == ["c.mp4"]
    path.write_bytes("a.mp4\nb.mp4\n".encode("utf-8-sig"))
    assert read_list(str(path)) == ["a.mp4", "b.mp4"]
    for order in ("le", "be"):
        path.write_bytes("\ufeffa.mp4\n".encode(f"utf-16-{order}"))
        with pytest.raises(ParameterError, match="is text in UTF-16; save it as UTF-8"):
            read_list(str(path))
    path.write_bytes(b"\n\n")
    with pytest.raises(ParameterError, match="names no input"):
        read_list(str(path))
    with pytest.raises(ParameterError, match="no such file"):
        read_list(str(tmp_path / "missing"))


def test_a_table_of_a_batch_is_no_list(tmp_path: Path) -> None:
    alarms, failures = tmp_path / "alarms.csv", tmp_path / "failures.csv"
    write_alarms(alarms, {}, {})
    write_failures(failures, [Failure("a.mp4", "a", 3, "no")])
    for path in (alarms, failures):
        with pytest.raises(ParameterError, match="is a table of a batch, not a list; give a file"):
            read_list(str(path))


def test_a_list_that_does_not_come_answers_an_interruption(monkeypatch: pytest.MonkeyPatch) -> None:
    came = threading.Event()

    class Never(io.BytesIO):
        def read(self, _size: int | None = -1) -> bytes:
            came.wait(5)
            return b"a.mp4"

    def interrupt() -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(sys, "stdin", SimpleNamespace(buffer=Never()))
    monkeypatch.setattr(threads, "stop_if_asked", interrupt)
    with pytest.raises(KeyboardInterrupt):
        read_list("-")
    came.set()


@pytest.mark.skipif(sys.platform == "win32", reason="each name is text there")
def test_failures_are_listed_in_rows(tmp_path: Path) -> None:
    path = tmp_path / "failures.csv"
    hostile = Failure('n\ne"w,\udcff.mp4', "new-12345678", 3, "is no video\n; check")
    other = Failure("o\rld.mp4\r", "old-12345678", 3, "is no video")
    none = [Failure(name, "", 3, "matches no file") for name in ("*.avi", "*.mkv")]
    write_failures(path, [other, hostile, *none])
    assert [stem for stem, _ in failed_in(tmp_path)] == ["", "", hostile.stem, other.stem]
    assert dict(failed_in(tmp_path))[hostile.stem] == "is no video\\n; check"
    assert path.read_bytes().startswith(b"input,stem,exit_code,error\n*.avi,,3,matches no file\n")
    write_failures(path, [])
    assert not path.exists()


def test_exit_codes_of_a_batch() -> None:
    bad = Failure("a", "a", 3, "no")
    for results, code in (
        ([Outcome()], 0),
        ([Outcome(skipped=True), Outcome()], 0),
        ([Outcome(), Outcome(complete=False)], 4),
        ([Outcome(), bad], 4),
        ([bad, bad], 3),
        ([bad, Failure("b", "b", 2, "full")], 3),
    ):
        tally = Tally()
        for result in results:
            tally.add("a", result)  # type: ignore[arg-type]
        assert tally.exit_code() == code


def test_a_silent_input_meets_its_condition_whatever_the_others_do() -> None:
    bad, cut, silent = Failure("a", "a", 3, "no"), Outcome(complete=False), Outcome()
    for results, code in (
        ([silent], 5),
        ([silent, cut], 5),
        ([silent, bad], 5),
        ([cut], 4),  # the missing frames may belong to an alarm
        ([cut, bad], 4),
        ([bad], 3),
    ):
        tally = Tally()
        for result in results:
            tally.add("a", result)  # type: ignore[arg-type]
        assert tally.exit_code("no-alarm") == code
        assert tally.exit_code("alarm") == tally.exit_code()


def test_an_input_of_another_run_is_neither_silent_nor_without_alarms() -> None:
    tally = Tally()
    tally.add("a", Outcome(skipped=True))  # as the other run has not yet written its result
    assert tally.exit_code("no-alarm") == 0
    assert tally.verdicts == {}  # `write_alarms` removes the rows of names with verdicts


def test_the_table_counts_every_state() -> None:
    tally = Tally([Failure("a", "", 3, "no")])
    for result in (Outcome(frames=10), Outcome(frames=5, complete=False), Outcome(skipped=True)):
        tally.add("a", result)
    rows = [line.split() for line in tally.table(2.5)]
    assert rows[0] == ["inputs", "frames"]
    assert rows[1:5] == [
        ["done", "1", "10"],
        ["incomplete", "1", "5"],
        ["skipped", "1", "0"],
        ["failed", "1", "0"],
    ]
    assert " ".join(rows[5]) == "all 4 15 in 2.5 s, 6 frames/s"


def alarmed(**peaks: float) -> Outcome:
    """Return an outcome with an alarm of each detector whose peak is above 1."""
    event = {"start_frame": 3, "start_s": 0.1, "end_s": 0.2}
    found = {
        model: {"alarms": [{**event, "peak_over_threshold": peak}] * (peak > 1), "peak": peak}
        for model, peak in peaks.items()
    }
    return Outcome(verdicts=verdicts_in({"alarms": found}))


def test_the_strongest_alarms_come_first_and_the_others_are_counted() -> None:
    tally, place, order = Tally(), Path("alarms.csv"), ("strong", "weak")
    outcomes = {  # the first is the input that ended first, in which only D-LGMD had an alarm
        "weak": alarmed(opplod=0.5, dlgmd=2.0),
        "none": alarmed(opplod=0.5, dlgmd=0.5),
        "strong": alarmed(opplod=3.0, dlgmd=4.0),
    }
    for name, outcome in outcomes.items():
        tally.add(name, outcome)
    stems = {name: name.upper() for name in outcomes}
    strong, weak = (f"  {name.upper()}: {in_words(outcomes[name].verdicts)}" for name in order)
    first = "2 of 3 inputs had an alarm (OppLoD 1, D-LGMD 2); the strongest first:"
    assert list(tally.alarms(2, place, stems)) == [first, strong, weak]
    assert list(tally.alarms(1, place, stems)) == [first, strong, "  and 1 more: alarms.csv"]


def test_alarms_of_more_than_three_detectors_are_counted_by_detector() -> None:
    tally, place = Tally(), Path("alarms.csv")
    tally.add("a", alarmed(opplod=2, dlgmd=0.5, lgmd1=0.5))
    assert next(tally.alarms(2, place, {"a": "a"})).endswith("(OppLoD 1); the strongest first:")
    tally.add("b", alarmed(opplod=2, dlgmd=2, lgmd1=0.5, plgmd=0.5))
    lines = [line.split() for line in tally.alarms(2, place, {})]
    assert " ".join(lines[0]) == "2 of 2 inputs had an alarm; all alarms: alarms.csv"
    assert lines[1:] == [["OppLoD", "2"], ["D-LGMD", "1"]]
    one = Tally()
    one.add("a", alarmed(opplod=2))
    assert next(one.alarms(2, place, {"a": "a"})) == (
        "1 of 1 inputs had an alarm; the strongest first:"
    )


@pytest.mark.slow
def test_ten_thousand_inputs(tmp_path: Path) -> None:
    for number in range(100):
        (tmp_path / f"{number:03d}").mkdir()
        for clip in range(100):
            (tmp_path / f"{number:03d}" / f"{clip:02d}-{number}.mp4").touch()
    plan = planned([str(tmp_path)], recursive=True)
    assert len(plan.inputs) == len({source.stem for source in plan.inputs}) == 10_000
    assert plan.inputs[0].stem == "000/00-0"
