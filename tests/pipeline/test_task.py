"""The result files of a task, and when an existing result is kept."""

from __future__ import annotations

import json
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import cv2
import pytest

from oppload_cli.errors import OutputError
from oppload_cli.pipeline import task as task_module
from oppload_cli.pipeline.execute import run_task
from oppload_cli.pipeline.settings import resolve
from oppload_cli.pipeline.task import IfExists, Outcome, Outputs, Task, Writing, exists_already
from oppload_cli.results.alarm_log import verdicts_in
from oppload_cli.results.table import DetectionsFile
from oppload_cli.video.span import Reading, Span, parse_position
from tests.media import grey_frames, write_video

PLACES = ["opplod", "dlgmd"]


def test_the_files_of_a_result_and_those_that_other_options_leave(tmp_path: Path) -> None:
    def names(paths: list[Path]) -> list[str]:
        return [path.relative_to(tmp_path).as_posix() for path in paths]

    every = Outputs.of(tmp_path, "b/a", PLACES, annotate=True)
    kinds = ("frames.csv", "oppload.json", "detections.jsonl", "annotated.mp4")
    assert names(every.paths()) == [f"b/a.{kind}" for kind in kinds]
    assert every.left_over() == []
    least = Outputs.of(tmp_path, "b/a", ["dlgmd"])
    assert names(least.paths()) == ["b/a.frames.csv", "b/a.oppload.json"]
    parts = ["b/a.detections.jsonl.part", "b/a.annotated.mp4.part"]
    assert names(least.left_over()) == parts
    least.csv.parent.mkdir()
    least.csv.touch()
    assert names(least.left_over()) == [*parts, "b/a.detections.jsonl"]  # of the same result
    assert names(every.left_over()) == []


def test_paths_become_absolute(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    here = tmp_path.relative_to(tmp_path)
    for models in (PLACES, ["dlgmd"]):
        assert Outputs.of(here, "a", models).absolute() == Outputs.of(tmp_path, "a", models)


def test_a_result_is_kept_if_all_of_its_files_exist(tmp_path: Path) -> None:
    outputs = Outputs.of(tmp_path, "a", PLACES)
    for path in outputs.paths():
        assert not any(outputs.kept(each) for each in (IfExists.SKIP, IfExists.OVERWRITE))
        path.touch()
        with pytest.raises(OutputError, match=r"a\.frames\.csv: exists already; choose"):
            outputs.kept(IfExists.ERROR)
    assert outputs.kept(IfExists.SKIP)
    assert not outputs.kept(IfExists.OVERWRITE)
    for name in ("a.oppload.json", "a.detections.jsonl.part"):
        for path in tmp_path.iterdir():
            path.unlink()
        (tmp_path / name).touch()
        with pytest.raises(OutputError, match=rf"{name}: exists already; choose"):
            outputs.kept(IfExists.ERROR)


def test_a_table_that_appears_after_the_check_is_not_replaced(tmp_path: Path) -> None:
    outputs = Outputs.of(tmp_path, "a", PLACES)
    assert not outputs.kept(IfExists.ERROR)
    outputs.csv.write_text("theirs")
    with pytest.raises(OutputError, match=r"a\.frames\.csv: exists already"):
        outputs.begin(IfExists.ERROR)
    assert [path.read_text() for path in tmp_path.iterdir()] == ["theirs"]


def test_an_outcome_has_an_alarm_if_any_detector_has_one() -> None:
    event = {"start_frame": 3, "start_s": 0.1, "end_s": 0.2, "peak_over_threshold": 2.0}
    held = {name: {"alarms": [event] * (name == "dlgmd"), "peak": 2.0} for name in PLACES}
    assert Outcome(verdicts=verdicts_in({"alarms": held})).alarmed
    assert not Outcome(verdicts=verdicts_in({"alarms": held})[:1]).alarmed


@pytest.fixture(scope="module")
def task(tmp_path_factory: pytest.TempPathFactory) -> Task:
    """A task with its result."""
    folder = tmp_path_factory.mktemp("task")
    clip = write_video(folder / "a.avi", grey_frames(5))
    settings = resolve(models=PLACES, height="24", fov="60", measure_rmo=False)
    outputs = Outputs.of(folder, "a", settings.models)
    words = ("oppload", "run", "rtsp://me:secret@host/a")
    run_task(Task(str(clip), settings, outputs, command=words))
    return Task(str(clip), settings, outputs, if_exists=IfExists.SKIP)


def test_a_sidecar_holds_the_working_size_and_no_password(task: Task) -> None:
    assert task.outputs is not None
    content = json.loads(task.outputs.sidecar.read_text())
    assert content["command"] == ["oppload", "run", "rtsp://host/a"]
    assert content["working"] | {"width": 32, "height": 24} == content["working"]


def kept_as(task: Task, folder: Path, change: dict[str, Any]) -> Outcome | None:
    """Return the outcome of a copy of the result whose sidecar has other values."""
    assert task.outputs is not None
    copy = Outputs.of(folder, "a", task.settings.models)
    for old, new in zip(task.outputs.paths(), copy.paths(), strict=True):
        new.write_bytes(old.read_bytes())
    content = json.loads(copy.sidecar.read_text())
    for keys, value in change.items():
        *parts, last = keys.split("/")
        held = content
        for part in parts:
            held = held[part]
        held.pop(last) if value is None else held.update({last: value})
    copy.sidecar.write_text(json.dumps(content))
    return exists_already(replace(task, outputs=copy))


def test_an_outcome_of_a_kept_result_is_that_of_its_run(task: Task, tmp_path: Path) -> None:
    assert exists_already(replace(task, if_exists=IfExists.OVERWRITE)) is None
    plain = kept_as(task, tmp_path, {})
    assert plain is not None
    assert (plain.skipped, plain.complete, plain.notes) == (True, True, ())
    assert [each.model for each in plain.verdicts] == PLACES
    faulty = {"decode/complete": False, "decode/messages": ["cut"], "remarks": ["too short"]}
    other = kept_as(task, tmp_path, faulty)
    assert other is not None
    assert (other.complete, other.notes, other.remarks) == (False, ("cut",), ("too short",))


OTHER = (
    "a.oppload.json: is a result with other settings or of another input; choose --if-exists "
    "overwrite, or another --output"
)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"settings_sha256": "0"}, OTHER),
        ({"settings_sha256": None}, OTHER),  # of an earlier version
        ({"decode/complete": None}, "a.oppload.json: is damaged; choose --if-exists overwrite"),
        ({"alarms/opplod/peak": "1"}, "a.oppload.json: is damaged; choose --if-exists overwrite"),
        ({"decode/analysed": 6}, "a.frames.csv: holds 5 complete rows, but its run wrote 6"),
    ],
)
def test_a_result_of_another_task_is_named(
    task: Task, tmp_path: Path, change: dict[str, Any], said: str
) -> None:
    with pytest.raises(OutputError) as caught:
        kept_as(task, tmp_path, change)
    assert said in str(caught.value)


@pytest.mark.parametrize("pattern", ["", "/%d.png"])
def test_a_result_of_images_that_have_changed_is_named(pattern: str, tmp_path: Path) -> None:
    images = tmp_path / "images"
    images.mkdir()
    for number, frame in enumerate(grey_frames(6)):
        cv2.imwrite(str(images / f"{number}.png"), frame)
    task = Task(
        f"{images}{pattern}",
        resolve(models=PLACES, height="24", measure_rmo=False),
        Outputs.of(tmp_path / "out", "images", PLACES),
        if_exists=IfExists.SKIP,
    )
    run_task(task)
    assert exists_already(task) is not None
    (images / "6.png").write_bytes((images / "5.png").read_bytes())
    with pytest.raises(OutputError, match=r"is a result with other settings or of another input"):
        exists_already(task)


def test_the_checksum_is_that_of_the_settings_and_of_the_input(
    task: Task, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    models: dict[str, Any] = {"models": PLACES, "height": "24", "fov": "60", "measure_rmo": False}
    moved = tmp_path / "moved" / "a.avi"
    moved.parent.mkdir()
    moved.write_bytes(Path(task.name).read_bytes())
    same = (
        task,
        replace(task, settings=resolve(**models)),
        replace(task, name=str(moved), outputs=None, threads=2, command=["oppload"]),
    )
    assert {each.settings_sha256() for each in same} == {task.settings_sha256()}
    other = [
        replace(task, settings=resolve(**{**models, **change}))
        for change in (
            {"models": PLACES[:1]},
            {"models": PLACES[::-1]},
            {"height": "30"},
            {"fov": "61"},
            {"fov": None},
            {"measure_rmo": True},
            {"columns": "all"},
            {"assignments": {"alarm.factor": 9}},
            {"assignments": {"opplod.receptive_field": "20deg"}},
            {"assignments": {"time.interval": "frame"}},
        )
    ]
    (tmp_path / "b.avi").write_bytes(moved.read_bytes())
    (tmp_path / "a.avi").write_bytes(moved.read_bytes()[:-1])
    other += [replace(task, name=str(tmp_path / name)) for name in ("a.avi", "b.avi")]
    other += [replace(task, span=Span(parse_position("f3"), parse_position("0.1")))]
    other += [
        replace(task, reading=reading)
        for reading in (Reading(Fraction(25)), Reading(None, Fraction(25)), Reading(stream=2))
    ]
    checksums = [each.settings_sha256() for each in (task, *other)]
    # Files of detectors of one's own count if one of these runs.
    for content in ("0", "1"):
        monkeypatch.setattr(task_module, "loaded", lambda: [{"name": "a.py", "sha256": content}])  # noqa: B023
        assert task.settings_sha256() == checksums[0]
        with monkeypatch.context() as context:
            context.setattr(task_module, "needs_loading", lambda _name: True)
            checksums.append(task.settings_sha256())
    assert len(set(checksums)) == len(checksums)


def test_the_checksum_of_a_stream_holds_its_address_but_no_password(task: Task) -> None:
    names = ("rtsp://me:secret@host/a", "rtsp://host/a", "rtsp://other/a")
    first, second, third = (replace(task, name=name).settings_sha256() for name in names)
    assert first == second != third


def test_a_table_that_cannot_be_read_is_named(task: Task, tmp_path: Path) -> None:
    assert kept_as(task, tmp_path, {}) is not None
    (tmp_path / "a.frames.csv").unlink()
    (tmp_path / "a.frames.csv").mkdir()
    with pytest.raises(OutputError, match=r"a\.frames\.csv: "):
        exists_already(replace(task, outputs=Outputs.of(tmp_path, "a", PLACES)))


def test_the_table_gets_its_name_last(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """So an old table never lies beside new files, and a complete one beside all of its files."""
    outputs = Outputs.of(tmp_path, "a", PLACES)
    for path in (*outputs.paths(), *outputs.left_over()):
        path.write_text("old")
    seen: list[tuple[str, bool]] = []

    def content() -> dict[str, Any]:
        seen.append(("content", outputs.csv.exists()))
        return {}

    commit = DetectionsFile.commit

    def committed(self: DetectionsFile) -> None:
        seen.append(("detections", outputs.csv.exists()))
        commit(self)

    monkeypatch.setattr(DetectionsFile, "commit", committed)
    table = outputs.begin(IfExists.OVERWRITE)
    assert table is not None
    video: Any = None  # only an annotated video needs it
    Writing(outputs, table, video, ["frame"], PLACES, boxes="all").commit(content)
    assert seen == [("content", False), ("detections", False)]
    assert outputs.csv.read_text() == "frame\n"
    assert sorted(tmp_path.iterdir()) == sorted(outputs.paths())


def test_the_part_files_of_a_writing_are_removed_or_closed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def writing() -> Writing:
        outputs = Outputs.of(tmp_path, "a", PLACES)
        table = outputs.begin(IfExists.ERROR)
        assert table is not None
        video: Any = None
        return Writing(outputs, table, video, ["frame"], PLACES, boxes="all")

    kept = writing()
    kept.keep()
    names = [path.name for path in sorted(tmp_path.iterdir())]
    assert names == ["a.detections.jsonl.part", "a.frames.csv.part"]
    [detections] = kept._other_files
    assert isinstance(detections, DetectionsFile)
    assert detections.stream.closed
    for path in tmp_path.iterdir():
        path.unlink()

    def fail(_path: Path) -> None:
        raise OutputError("full")

    monkeypatch.setattr(task_module, "DetectionsFile", fail)
    with pytest.raises(OutputError, match="full"):
        writing()
    assert list(tmp_path.iterdir()) == []
