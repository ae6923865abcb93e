from __future__ import annotations

import json
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest

from tests.cli import process
from tests.cli.inside import oppload
from tests.media import grey_frames, write_video
from tests.results.make import rows_of

if TYPE_CHECKING:
    from pathlib import Path

HEADER = (
    "frame,time_s,luma_change,"
    "opplod_response,opplod_threshold,opplod_alarm,opplod_x,opplod_y,opplod_width,opplod_height,"
    "opplod_unit_x,opplod_unit_y,opplod_contact_s,opplod_growth,opplod_opponency,"
    "dlgmd_response,dlgmd_threshold,dlgmd_alarm,dlgmd_s,"
    "flow_vectors,rom_pairs,rom_share,rmo_mean,rmo_max,rmo_index"
)


@pytest.fixture(scope="module")
def result(clip: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("result")
    done = process.oppload("run", clip, "-o", folder)
    assert (done.returncode, done.stdout) == (0, "")
    assert "24 frames" in done.stderr
    return folder


@pytest.mark.long
def test_the_table(result: Path) -> None:
    text = (result / "loom.frames.csv").read_text()
    assert text.startswith(HEADER + "\n0,0,,,0.09,0,,,,,,,,,,,0.01,0,,,,,,,\n1,0.033333333,")
    table = rows_of(result / "loom.frames.csv")
    assert [int(row["frame"]) for row in table] == list(range(24))
    assert all(row["opplod_response"] == "" for row in table[:3])
    assert all(float(row["dlgmd_s"]) >= 0 for row in table[3:])
    best = max(table[3:], key=lambda row: float(row["opplod_response"]))
    unit = float(best["opplod_unit_x"]), float(best["opplod_unit_y"])
    assert unit == pytest.approx((150, 110), abs=8)
    assert {row[f"{model}_alarm"] for row in table for model in ("opplod", "dlgmd")} <= {"0", "1"}
    lines = (result / "loom.detections.jsonl").read_text().splitlines()
    first = {each["frame"]: each for each in reversed([json.loads(line) for line in lines])}
    assert len(first) > 5
    for row in table:
        found = first.get(int(row["frame"]))
        for side in ("x", "y", "width", "height"):
            assert row[f"opplod_{side}"] == ("" if found is None else f"{found[side]:.9g}")
    late = [float(row["rmo_index"]) for row in table[4:]]
    assert min(late) > 0.85
    assert not list(result.glob("*.part"))


@pytest.mark.long
def test_the_sidecar(result: Path, clip: Path) -> None:
    sidecar: dict[str, Any] = json.loads((result / "loom.oppload.json").read_text())
    assert sidecar["schema"] == "oppload.result/2"
    assert sidecar["command"][:2] == ["oppload", "run"]
    assert sidecar["input"]["bytes"] == clip.stat().st_size
    assert sidecar["input"]["frame_rate"] == "30/1"
    assert sidecar["working"]["source_px_per_s_at_1_px_per_frame"] == 30
    assert sidecar["parameters"]["opplod"]["receptive_field"] == 100
    assert sidecar["parameters"]["dlgmd"]["threshold_limit"] == 0.3
    assert sidecar["decode"]["decoded"] == sidecar["decode"]["analysed"] == 24
    assert sidecar["threads"]["models"] == 1
    assert sidecar["threads"]["decoder"] >= 1
    assert sidecar["decode"]["complete"] is True
    table = rows_of(result / "loom.frames.csv")
    for model in ("opplod", "dlgmd"):
        summary = sidecar["summary"][model]
        responses = [float(row[f"{model}_response"] or -1) for row in table]
        assert summary["peak"] == pytest.approx(max(responses), rel=1e-8)
        assert summary["peak_frame"] == responses.index(max(responses))
        first = next((i for i, row in enumerate(table) if row[f"{model}_alarm"] == "1"), None)
        assert summary["first_alarm_frame"] == first


@pytest.mark.long
def test_the_same_input_gives_the_same_bytes_on_standard_output_and_nothing_else(
    result: Path, clip: Path
) -> None:
    words = ("run", clip, "-o", "-", "-q")
    done = process.oppload(*words, OMP_NUM_THREADS="1", OPENCV_LOG_LEVEL="INFO")
    assert done.returncode == 0
    assert done.stdout == (result / "loom.frames.csv").read_text()
    assert done.stderr == ""


def test_options_reach_the_models(clip: Path, tmp_path: Path) -> None:
    (tmp_path / "s.toml").write_text("[opplod]\ngain = 2.0\n")
    done = oppload(
        *("run", clip, "-o", tmp_path, "--model", "opplod", "--height", "native", "-v"),
        *("--set", "opplod.receptive_field=60", "--config", tmp_path / "s.toml"),
        *("--start", "f4", "--end", "f20", "--no-rmo"),
    )
    assert done.returncode == 0
    assert "240 x 240 at 30 frames/s, seen at 240 x 240; 1 px/frame there = 1 source" in done.stderr
    table = rows_of(tmp_path / "loom.frames.csv")
    assert [int(row["frame"]) for row in table] == list(range(4, 20))
    assert "dlgmd_response" not in table[0]
    assert "rmo_index" not in table[0]
    sidecar = json.loads((tmp_path / "loom.oppload.json").read_text())
    assert sidecar["parameters"]["opplod"]["gain"] == 2
    assert sidecar["span"]["start"] == {"frame": 4, "seconds": None}
    assert sidecar["decode"]["complete"] is True


@pytest.mark.long
@pytest.mark.parametrize(
    "options",
    [
        "--model opplod_reference,lgmd2 --set opplod_reference.inhibition_strength=3 --fov 77",
        "--model opplod_lplc2 --height native --no-rmo --columns all --fov 90 --repeats keep "
        "--set opplod_lplc2.receptive_field=20deg",
    ],
)
def test_the_settings_in_a_sidecar_give_the_same_bytes(
    options: str, clip: Path, tmp_path: Path
) -> None:
    first, again = tmp_path / "first", tmp_path / "again"
    assert oppload("run", clip, "-o", first, *options.split()).returncode == 0
    sidecar = first / f"{clip.stem}.oppload.json"
    assert oppload("run", clip, "-o", again, "--config", sidecar).returncode == 0
    for suffix in (".frames.csv", ".detections.jsonl"):
        name = f"{clip.stem}{suffix}"
        assert (again / name).read_bytes() == (first / name).read_bytes()
    old, new = (json.loads((folder / sidecar.name).read_text()) for folder in (first, again))
    # The sidecar states values in place of those that follow from the height, such as `auto`.
    own = {"command", "threads", "wall_s", "frames_per_s", "settings_sha256"}
    assert {key for key in old if old[key] != new[key]} <= own
    for content in ("[]", '{"schema": "oppload.stimulus/1", "parameters": {}}'):
        sidecar.write_text(content)
        assert "holds no settings that" in oppload("run", clip, "--config", sidecar).stderr


def test_versions_of_oppload_in_one_run(clip: Path, tmp_path: Path) -> None:
    """One table and one plot; each detector gets the picture at its own height."""
    names = ["opplod", "opplod_paper", "dlgmd"]
    words = ("--columns", "all", "--no-rmo", "-v", "--model")
    done = oppload("run", clip, "-o", tmp_path / "all", *words, ",".join(names))
    assert done.returncode == 0
    assert ", seen at 240 x 240; 1 px/frame there = 1 source" in done.stderr
    assert "/s; also seen at 600 x 600\n" in done.stderr
    suffixes = ("frames.csv", "detections.jsonl", "oppload.json")
    assert {path.name for path in (tmp_path / "all").iterdir()} == {f"loom.{s}" for s in suffixes}
    table = rows_of(tmp_path / "all" / "loom.frames.csv")
    for name in names:
        assert oppload("run", clip, "-o", tmp_path / name, *words, name).returncode == 0
        alone = rows_of(tmp_path / name / "loom.frames.csv")
        own = [column for column in alone[0] if column.startswith(f"{name}_")]
        assert len(own) >= 3
        assert max(float(row[f"{name}_response"] or 0) for row in alone) > 0
        assert [[row[column] for column in own] for row in table] == [
            [row[column] for column in own] for row in alone
        ]
    sidecar = json.loads((tmp_path / "all" / "loom.oppload.json").read_text())
    assert (sidecar["models"], sidecar["height"]) == (names, "auto")
    assert sidecar["working"]["height"] == 240
    assert list(sidecar["summary"]) == names
    assert list(sidecar["alarms"]) == ["opplod", "dlgmd"]
    assert "OppLoD paper" not in done.stderr
    drawn = oppload("plot", tmp_path / "all" / "loom.frames.csv", "-o", tmp_path / "one.svg")
    assert drawn.returncode == 0
    text = (tmp_path / "one.svg").read_text()
    for label in ("OppLoD", "OppLoD paper", "D-LGMD"):
        assert f"<!-- {label}" in text


def test_a_detector_without_an_alarm_is_told_with_the_reason(clip: Path, tmp_path: Path) -> None:
    words = ("run", clip, "-o", tmp_path, "--end", "f8", "--if-exists", "overwrite", "--model")
    done = oppload(*words, "opplod_paper", "-v")
    assert done.returncode == 0
    assert "seen at 240 x 240;" in done.stderr
    assert "; also seen at 600 x 600" in done.stderr
    assert "loom.avi: no detector has an alarm; the responses are in the table" in done.stderr
    reason = "no alarm of opplod_paper: it responds to inward and outward motion alike"
    assert done.stderr.count(reason) == 1
    assert "; --set alarm.opplod_paper_floor=NUMBER gives it one\n" in done.stderr
    sidecar = json.loads((tmp_path / "loom.oppload.json").read_text())
    assert (sidecar["height"], sidecar["working"]["height"]) == ("auto", 240)
    at_60 = oppload(*words, "opplod_paper,dlgmd", "--height", "60", "-v")
    assert "seen at 60 x 60;" in at_60.stderr
    assert "also seen" not in at_60.stderr
    floor = oppload(*words, "opplod_paper", "--set", "alarm.opplod_paper_floor=1e-9")
    assert "no alarm of" not in floor.stderr
    alarms = {row["opplod_paper_alarm"] for row in rows_of(tmp_path / "loom.frames.csv")}
    assert alarms == {"0"}


@pytest.mark.long
def test_a_cadence_of_repeats_is_told(tmp_path: Path) -> None:
    pictures = grey_frames(30, seed=2)
    write_video(tmp_path / "cadence.avi", [each for each in pictures for _ in range(2)])
    said = "cadence.avi: holds about 15 different pictures/s in 30 frames/s; the repeats are left"
    for handling, told in (("near", True), ("keep", False)):
        words = ("--repeats", handling, "--height", "48", "--no-rmo", "--if-exists", "overwrite")
        done = oppload("run", tmp_path / "cadence.avi", "-o", tmp_path, *words)
        assert (done.returncode, said in done.stderr) == (0, told)


@pytest.mark.parametrize("handling", ["near", "exact", "keep"])
def test_an_input_that_never_changes_is_told(tmp_path: Path, handling: str) -> None:
    """Without a note, the silence of a broken camera would look like a safe way."""
    first, *others = grey_frames(40)
    write_video(tmp_path / "frozen.avi", [first] * 40)
    write_video(tmp_path / "starts.avi", [*[first] * 39, others[0]])
    same = "frozen.avi: all pictures are the same, and nothing can cause an alarm; check"
    words = ("--height", "48", "--no-rmo", "-o", tmp_path, "--repeats", handling)
    assert same in oppload("run", tmp_path / "frozen.avi", *words).stderr
    assert "the same" not in oppload("run", tmp_path / "starts.avi", *words).stderr


def test_a_folder_says_what_it_leaves_out_unless_it_is_searched(tmp_path: Path) -> None:
    write_video(tmp_path / "a.avi", grey_frames(4))
    (tmp_path / "within").mkdir()
    write_video(tmp_path / "within" / "b.avi", grey_frames(4))
    said = "1 folder (within) is left out; --recursive runs the inputs there"
    for more, told in (((), True), (("-r",), False), (("-q",), False)):
        done = oppload("run", tmp_path, "-o", tmp_path / "out", "--dry-run", *more)
        assert (done.returncode, said in done.stderr) == (0, told)
        assert "-r" in more or "1 input: 1 to run, 0 to skip" in done.stderr


@pytest.mark.long
@pytest.mark.usefixtures("undrawn")
def test_the_details_show_why_an_alarm_did_or_did_not_come(tmp_path: Path) -> None:
    y, x = np.mgrid[:90, :120]
    away = np.hypot(x - 60, y - 45)
    disks = [np.clip(away - 60 / (30 - t), 0, 1) * 255 for t in range(26)]
    path = write_video(tmp_path / "loom.avi", [each.astype(np.uint8) for each in disks])
    done = oppload("run", path, "-o", tmp_path, "--columns", "all", "--no-rmo")
    assert done.returncode == 0
    table = rows_of(tmp_path / "loom.frames.csv")
    assert [row["blind"] for row in table] == [*["start"] * 11, *[""] * 15]
    for row in table[3:]:
        over, evidence = (
            float(row[f"opplod_{name}"]) for name in ("over_threshold", "evidence_over_threshold")
        )
        assert evidence == (0 if row["blind"] else pytest.approx(over))
        assert "dlgmd_evidence_over_threshold" not in row
    assert evidence > 1
    collected = tmp_path / "all.csv"
    assert oppload("collect", tmp_path, "--frames", "-o", collected).returncode == 0
    assert [row["blind"] for row in rows_of(collected)] == [row["blind"] for row in table]
    assert oppload("plot", tmp_path / "loom.frames.csv").returncode == 0


@pytest.mark.long
def test_a_small_video_that_is_enlarged_is_told(tmp_path: Path) -> None:
    path = write_video(tmp_path / "small.avi", grey_frames(12, 32, 24))
    words = ("--no-rmo", "-o", tmp_path, "--if-exists", "overwrite", "--height")
    said = "small.avi: is enlarged {} times, to {} px: the models see no more detail than the input"
    assert said.format("10", "320 x 240") in oppload("run", path, *words, "240").stderr
    assert said.format("2.54", "81 x 61") in oppload("run", path, *words, "61").stderr
    assert "enlarged" not in oppload("run", path, *words, "60").stderr


def test_an_address_that_does_not_answer_is_told_as_one(tmp_path: Path) -> None:
    done = oppload("run", "tcp://127.0.0.1:9", "-o", tmp_path)
    assert (done.returncode, "; check the address" in done.stderr) == (3, True)


@pytest.mark.long
def test_a_rate_that_the_times_contradict_does_not_count_repeats(tmp_path: Path) -> None:
    pictures = [each for each in grey_frames(30, seed=2) for _ in range(2)]
    times = [index * 40 for index in range(60)]
    path = write_video(
        tmp_path / "a.mkv", pictures, rate=1000, times=times, time_base=Fraction(1, 1000)
    )
    done = oppload("run", path, "-o", tmp_path, "--height", "48", "--no-rmo")
    assert "holds about 12.5 different pictures/s in 25 frames/s; the repeats are" in done.stderr
    decode = json.loads((tmp_path / "a.oppload.json").read_text())["decode"]
    assert decode["pictures_per_s"] == pytest.approx(12.5)


@pytest.mark.long
def test_a_frame_rate_that_is_assumed_or_ignored_is_told(tmp_path: Path) -> None:
    folder = tmp_path / "frames"
    folder.mkdir()
    for number, image in enumerate(grey_frames(12)):
        cv2.imwrite(str(folder / f"{number}.png"), image)
    write_video(tmp_path / "video.avi", grey_frames(12))
    assumed = "frames: 30 frames/s are assumed, as images carry no times; --image-rate (in"
    stream = "raw.mjpeg: 25 frames/s are assumed, as the stream carries no times; --true-rate"
    ignored = (
        "video.avi: has times or a rate of its own: --image-rate has no effect on it; for slow "
        "motion give --true-rate"
    )
    write_video(tmp_path / "raw.mjpeg", grey_frames(4), codec="mjpeg", pixel_format="yuvj420p")
    words = ("-o", tmp_path, "--height", "48", "--no-rmo")
    for name, more, told in (
        ("frames", (), assumed),
        ("raw.mjpeg", (), stream),
        ("raw.mjpeg", ("--image-rate", "60", "--if-exists", "overwrite"), stream),
        ("video.avi", (), None),
        ("frames", ("--image-rate", "25", "--if-exists", "overwrite"), None),
        ("video.avi", ("--image-rate", "25", "--if-exists", "overwrite"), ignored),
        (
            "video.avi",
            ("--image-rate", "25", "--if-exists", "skip"),
            ignored,
        ),  # of a result that is kept too
    ):
        done = oppload("run", tmp_path / name, *words, *more)
        assert done.returncode == 0
        told_of = [each for each in (assumed, stream, ignored) if each in done.stderr]
        assert told_of == [told] * bool(told)
        assert ("has no effect on it" in done.stderr) == (told == ignored)
        assert "ground truth" not in done.stderr
    facts = json.loads((tmp_path / "frames.oppload.json").read_text())["input"]
    assert (facts["frame_rate"], facts["rate_assumed"]) == ("25/1", False)
    refused = oppload("run", folder, *words, "--if-exists", "skip")
    assert (refused.returncode, "is a result with other settings" in refused.stderr) == (2, True)
    with_slash = f"{folder}/", *words, "--if-exists", "skip", "--image-rate", "25"
    assert "skipped" in oppload("run", *with_slash).stderr


def test_a_video_in_slow_motion_gives_the_results_of_its_true_rate(tmp_path: Path) -> None:
    for name, rate in (("true.avi", 240), ("slow.avi", 30)):
        write_video(tmp_path / name, grey_frames(24), rate=rate)
    words = ("-o", tmp_path, "--height", "48")
    oppload("run", tmp_path / "true.avi", *words)
    done = oppload("run", tmp_path / "slow.avi", *words, "--true-rate", "240", "--end", "0.05")
    assert "slow.avi: --true-rate (in Python true_rate) is 240 frames/s, and the ra" in done.stderr
    true, slow = (rows_of(tmp_path / f"{name}.frames.csv") for name in ("true", "slow"))
    assert len(slow) == 12
    assert slow == true[:12]
    again = "run", tmp_path / "slow.avi", *words, "--end", "0.05", "--if-exists", "skip"
    assert "skipped" in oppload(*again, "--true-rate", "240").stderr
    for other in ((), ("--true-rate", "120")):
        refused = oppload(*again, *other)
        assert refused.returncode == 2
        assert "is a result with other settings" in refused.stderr


@pytest.mark.long
def test_a_video_too_short_for_an_alarm_says_so(tmp_path: Path) -> None:
    """Without a note, the missing alarm would look like safety, also in a batch."""
    for name, count in (("short.avi", 5), ("other.avi", 6)):
        write_video(tmp_path / name, grey_frames(count, seed=count))
    said = "short.avi: lasts 0.13 s: too short for an alarm, as the first 0.35 s never count"
    words = ("--height", "48", "--no-rmo", "--if-exists", "overwrite", "-o", tmp_path, "-vj", "1")
    for inputs in (["short.avi"], ["short.avi", "other.avi"]):
        done = oppload("run", *(tmp_path / each for each in inputs), *words)
        assert (done.returncode, said in done.stderr) == (0, True)
    write_video(tmp_path / "long.avi", grey_frames(12))
    assert "too short" not in oppload("run", tmp_path / "long.avi", *words).stderr
    for setting in ("alarm.on=false", "alarm.cut_ratio=0"):  # no alarms, or no blind frames
        done = oppload("run", tmp_path / "short.avi", *words, "--set", setting)
        assert "too short" not in done.stderr


@pytest.mark.long
def test_a_run_in_which_nothing_could_respond_says_so(tmp_path: Path) -> None:
    path = write_video(tmp_path / "a.avi", grey_frames(20))
    words = ("--no-rmo", "--if-exists", "overwrite", "-o", tmp_path)
    warm_up = (
        "has no response of OppLoD, frame difference to any frame, so that nothing could cause an "
        "alarm: it ends within the warm-up of 3 intervals of 10 s; give a longer video, or a "
        "shorter time.interval"
    )
    frames = (
        "has no response of D-LGMD to any frame, so that nothing could cause an alarm: it ends "
        "within the warm-up of 3 frames; give a longer video"
    )
    small = (
        "has a working size of 1 x 1 px: below 13 px no detector is known to respond to an "
        "approach; choose a larger working height"
    )
    one = (
        "has no response of frame difference to any frame, so that nothing could cause an alarm: "
        "it ends within the warm-up of 1 interval of 1/30 s; give a longer video"
    )
    part = ("--duration", "f3", "--model", "dlgmd", "--set", "time.interval=frame")
    for more, said in (
        (("--set", "time.interval=10", "--model", "opplod,frame_difference"), warm_up),
        (("--duration", "f1", "--model", "frame_difference"), one),
        (part, frames),
        (("--height", "1"), small),
        ((), None),
    ):
        done = oppload("run", path, *words, *more)
        remarks = json.loads((tmp_path / "a.oppload.json").read_text())["remarks"]
        told = [each for each in (warm_up, frames, one, small) if each in remarks]
        assert told == [said] * (said is not None)
        assert [each for each in (warm_up, frames, one, small) if each in done.stderr] == told
        assert done.returncode == 0


def test_an_existing_result_is_not_touched_without_being_asked(clip: Path, tmp_path: Path) -> None:
    there = tmp_path / "loom.frames.csv"
    there.write_text("mine")
    refused = oppload("run", clip, "-o", tmp_path)
    assert refused.returncode == 2
    assert "exists already; choose --if-exists" in refused.stderr
    assert there.read_text() == "mine"
    assert oppload("run", clip, "-o", tmp_path, "--if-exists", "overwrite").returncode == 0
    written = there.read_text()
    assert written.startswith(HEADER)
    skipped = oppload("run", clip, "-o", tmp_path, "--if-exists", "skip")
    assert (skipped.returncode, there.read_text()) == (0, written)
    assert "skipped" in skipped.stderr


def test_a_result_that_lacks_rows_is_not_kept(clip: Path, tmp_path: Path) -> None:
    assert oppload("run", clip, "-o", tmp_path, "--no-rmo").returncode == 0
    table = tmp_path / "loom.frames.csv"
    whole = table.read_text()
    lines = whole.splitlines(keepends=True)
    for content, held in (("", 0), ("".join(lines[:20]) + "19,0.6", 19), (whole + lines[-1], 25)):
        table.write_text(content)
        kept = oppload("run", clip, "-o", tmp_path, "--no-rmo", "--if-exists", "skip")
        assert kept.returncode == 2
        assert (
            f"{table}: holds {held} complete rows, but its run wrote 24; "
            "choose --if-exists overwrite, or another --output" in kept.stderr
        )
        assert table.read_text() == content


@pytest.mark.long
def test_a_truncated_input_is_done_but_incomplete(tmp_path: Path) -> None:
    images = grey_frames(40, width=320, height=240)
    whole = write_video(tmp_path / "a.avi", images, codec="mpeg4", pixel_format="yuv420p")
    cut = tmp_path / "cut.avi"
    cut.write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])
    done = oppload("run", cut, "-o", tmp_path, "--fail-on", "no-alarm")
    assert done.returncode == 4  # what is incomplete does not count as silent
    assert "incomplete" in done.stderr
    sidecar = json.loads((tmp_path / "cut.oppload.json").read_text())
    assert sidecar["decode"]["complete"] is False
    analysed = len(rows_of(tmp_path / "cut.frames.csv"))
    assert sidecar["decode"]["missing"] == 40 - analysed
    # --if-exists skip keeps the incomplete result, and says that it is incomplete.
    for inputs in ([cut], [cut, whole]):
        kept = oppload("run", *inputs, "-o", tmp_path, "--if-exists", "skip", "-j", "1")
        assert kept.returncode == 4
        assert "cut.avi: incomplete" in kept.stderr


@pytest.mark.long
@pytest.mark.parametrize(
    "case",
    [("alarm", "1e-6", 5), ("no-alarm", "1e-6", 0), ("alarm", "1e6", 0), ("no-alarm", "1e6", 5)],
)
@pytest.mark.parametrize("several", [False, True])
def test_a_condition_on_the_alarm(
    clip: Path, tmp_path: Path, case: tuple[str, str, int], several: bool
) -> None:
    """The disk causes an alarm if the floor is low, and none if the floor is high."""
    condition, floor, code = case
    options = ["--fail-on", condition, "--no-rmo", "--height", "60", "--jobs", "1"]
    options += ["--set", "alarm.blind_s=0"]
    for model in ("opplod", "dlgmd"):
        options += ["--set", f"alarm.{model}_floor={floor}"]
    copy = tmp_path / "copy.avi"
    copy.write_bytes(clip.read_bytes())
    inputs = [clip, copy] if several else [clip]
    assert oppload("run", *inputs, "-o", tmp_path, *options).returncode == code


def test_many_detectors_have_a_line_each(clip: Path, tmp_path: Path) -> None:
    names = "opplod,dlgmd,frame_difference,lgmd2"
    done = oppload("run", clip, "-o", tmp_path, "--no-rmo", "--height", "60", "--model", names)
    first, *lines = done.stderr.splitlines()
    assert (done.returncode, first) == (0, f"{clip}:")
    labels = ["OppLoD", "D-LGMD", "frame difference", "LGMD2"]
    assert [line[2:28].rstrip() for line in lines[:4]] == labels
    assert all("alarm" in line[28:] for line in lines[:4])


def test_a_stimulus_in_place_of_its_video_is_told(tmp_path: Path) -> None:
    for name in ("mine.toml", "mine.stimulus.json"):
        (tmp_path / name).write_text("{}")
    truth = "; this is the ground truth of a stimulus: give its video\n"
    for name, advice in (
        ("mine.toml", "; if this is a stimulus, 'oppload stimuli generate mine.toml' makes its"),
        ("mine.stimulus.json", truth),
    ):
        done = oppload("run", name, "-o", "out", cwd=tmp_path)
        assert done.returncode == 3
        assert advice in done.stderr
    (tmp_path / "mine.stimulus.json").rename(tmp_path / "other.stimulus.json")
    both = oppload("run", "mine.toml", "other.stimulus.json", "-o", "out", "-j", "1", cwd=tmp_path)
    assert both.returncode == 3
    assert "'oppload stimuli generate mine.toml' makes its video" in both.stderr
    assert truth in both.stderr
