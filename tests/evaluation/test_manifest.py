from __future__ import annotations

import json
import sys
from fractions import Fraction
from typing import TYPE_CHECKING

import pytest

from oppload_cli.errors import ManifestError, ParameterError
from oppload_cli.evaluation.clip_inputs import clips_of
from oppload_cli.evaluation.detectors import evaluated_detectors
from oppload_cli.evaluation.manifest import read_manifest, with_boxes
from oppload_cli.models.registry import detectors

if TYPE_CHECKING:
    from pathlib import Path

HEADER = "file,label,onset_frame,contact_frame"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in ("a.avi", "b.avi", "c.avi"):
        (tmp_path / name).touch()
    if sys.platform != "win32":  # there, links need a right
        (tmp_path / "here").symlink_to(tmp_path)
    return tmp_path


def written(folder: Path, *rows: str, header: str = HEADER) -> Path:
    path = folder / "clips.csv"
    path.write_text("\n".join([header, *rows]) + "\n", encoding="utf-8")
    return path


def test_the_rows_of_a_manifest(folder: Path) -> None:
    path = written(
        folder,
        "a.avi, looming ,12,40.0,,30,100,8,6,somebody,MIT",
        "",
        '"b.avi",none,,,"translating, fast",,,,,,',
        header=f"\ufeff{HEADER},motion,fps,frames,width,height,source,licence",
    )
    found = read_manifest(path)
    assert found.faults == []
    assert found.rows == 2
    first, second = found.entries
    assert (first.row, second.row) == (2, 4)
    assert first.path == folder / "a.avi"
    assert (first.label.name, first.label.onset, first.label.contact) == ("a.avi", 12, 40)
    assert (first.label.looming, first.label.kind) == (True, "before an approach")
    assert (second.label.looming, second.label.kind) == (False, "translating, fast")


def test_the_true_rate_of_a_clip(folder: Path) -> None:
    rows = "a.avi,none,NA,NaN,30000/1001", "b.avi,none,,,NA", "c.avi,none,,,fast"
    found = read_manifest(written(folder, *rows, header=f"{HEADER},true_rate"))
    assert [entry.true_rate for entry in found.entries] == [Fraction(30000, 1001), None]
    (fault,) = found.faults
    assert "row 4: c.avi: true_rate must be the frames/s of the camera, such as 500" in fault
    assert found.notes == ()
    for rate in ("0", "-3", "1/0", "1e9", "inf"):
        wrong = written(folder, f"a.avi,none,,,{rate}", header=f"{HEADER},true_rate")
        assert f"not '{rate}'" in read_manifest(wrong).faults[0]


@pytest.mark.parametrize(
    ("row", "reason"),
    [
        ("no.avi,looming,1,2", "no.avi: there is no such file"),
        (",looming,1,2", "names no file"),
        ("a.avi,loming,1,2", "unknown label 'loming'; did you mean 'looming'?"),
        ("a.avi,,1,2", "unknown label ''"),
        ("a.avi,looming,20,10", "its contact, frame 10, is before its onset, frame 20"),
        ("a.avi,looming,,10", "has no onset_frame; fill it in"),
        ("a.avi,looming,1,", "has no contact_frame; fill it in"),
        ("a.avi,looming,1.5,2", "onset_frame must be a whole number from 0, not '1.5'"),
        ("a.avi,looming,-1,2", "onset_frame must be a whole number from 0, not '-1'"),
        ("a.avi,looming,1,soon", "contact_frame must be a whole number from 0, not 'soon'"),
        ("a.avi,looming,1,\u0663", "contact_frame must be a whole number from 0"),
        ("a.avi,none,,7", "has the contact_frame 7, but is labelled none"),
        ("a.avi,looming,1", "has 3 cells, not 4"),
        ("a.avi,looming,1,2,3", "has 5 cells, not 4"),
        ("b.avi,none,,", "b.avi is in row 2 already"),
        ("./b.avi,none,,", "./b.avi is in row 2 already"),
        pytest.param(
            *("here/b.avi,none,,", "here/b.avi is in row 2 already"),  # a link to the folder
            marks=pytest.mark.skipif(sys.platform == "win32", reason="links need a right there"),
        ),
    ],
)
def test_a_wrong_row_is_named_and_the_rest_stands(folder: Path, row: str, reason: str) -> None:
    found = read_manifest(written(folder, "b.avi,none,,", row, "c.avi,looming,3,3"))
    assert [entry.label.name for entry in found.entries] == ["b.avi", "c.avi"]
    (fault,) = found.faults
    assert fault.startswith(f"{folder / 'clips.csv'}: row 3: ")
    assert reason in fault
    assert found.rows == 3


def test_a_row_that_was_wrong_does_not_make_a_right_one_a_duplicate(folder: Path) -> None:
    found = read_manifest(written(folder, "a.avi,looming,9,3", "a.avi,looming,3,9"))
    assert [entry.row for entry in found.entries] == [3]


def test_unknown_columns_are_ignored_with_one_note(folder: Path) -> None:
    path = written(folder, "a.avi,none,,,still,x,7", header=f"{HEADER},motions,weather,subject")
    found = read_manifest(path)
    assert len(found.entries) == 1
    assert found.faults == []
    assert found.notes == (
        f"{path}: these columns are not known and are ignored: 'motions' (did you mean 'motion'?), "
        "'weather', 'subject'",
    )
    assert read_manifest(written(folder, "a.avi,none,,")).notes == ()


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"", "lacks file, label, onset_frame, contact_frame"),
        (b"file,label,onset_frame\n", "its first row lacks contact_frame"),
        (b"file,label,onset_fram,contact_frame\n", r"lacks onset_frame \(it has 'onset_fram'\)"),
        (b"file;label;onset_frame;contact_frame\n", "lacks file, label.*semicolons, not by commas"),
        (b"file\tlabel\tonset_frame\tcontact_frame\n", "lacks file, label.*tabs, not by commas"),
        (HEADER.encode() + b",file\n", "has file twice"),
        (b"\xff\xfe\x00", "is not valid CSV in UTF-8"),
        (b'file,"label', "is not valid CSV"),
    ],
)
def test_a_file_that_is_no_manifest(folder: Path, content: bytes, reason: str) -> None:
    path = folder / "clips.csv"
    path.write_bytes(content)
    with pytest.raises(ManifestError, match=reason):
        read_manifest(path)
    with pytest.raises(ManifestError, match=r"cannot be read .*check the path"):
        read_manifest(folder / "none.csv")


def test_boxes_are_those_beside_the_manifest_or_the_named_ones(folder: Path) -> None:
    manifest = read_manifest(written(folder, "a.avi,looming,1,9", "b.avi,none,,"))
    assert with_boxes(manifest) is manifest
    (folder / "boxes.json").write_text('{"a.avi": {"7": [1, 2, 3.5, 4]}, "z.avi": {"x": 0}}')
    found = with_boxes(manifest)
    assert found.entries[0].label.boxes == {7: (1, 2, 3.5, 4)}
    assert found.entries[1].label.boxes == {}
    assert found.faults == []  # z.avi belongs to another manifest
    other = folder / "other.json"
    other.write_text('{"a.avi": {"8": [0, 0, 1, 1]}}')
    assert with_boxes(manifest, other).entries[0].label.boxes == {8: (0, 0, 1, 1)}


def test_boxes_that_are_asked_for_are_of_clips_of_the_manifest(folder: Path) -> None:
    manifest = read_manifest(written(folder, "a.avi,looming,1,9", "gone.avi,looming,1,9"))
    assert len(manifest.faults) == 1
    path = folder / "other.json"
    path.write_text('{"gone.avi": {}}')  # whose row cannot be used
    assert with_boxes(manifest, path).entries[0].label.boxes == {}
    path.write_text('{"a.av": {"7": [1, 2, 3.5, 4]}}')
    reason = r"names 'a\.av', which is not in .*clips\.csv \(did you mean 'a\.avi'\?\); name its"
    with pytest.raises(ManifestError, match=reason):
        with_boxes(manifest, path)


def test_one_manifest_is_taken() -> None:
    for inputs in (["a.csv", "b.csv"], ["staged/*", "b.CSV"], ["b.csv", "clip.mp4"]):
        with pytest.raises(
            ManifestError, match=r"(?i)\.csv: is a manifest, which must be the only"
        ):
            clips_of(inputs, None, [], [])


@pytest.mark.parametrize(
    "entry",
    [
        {"1.5": [0, 0, 1, 1]},
        {"4": [0, 0, 1]},
        {"4": [0, 0, 0, 1]},
        {"4": [0, 0, 1, -1]},
        {"4": [0, 0, True, 1]},
        {"4": ["0", 0, 1, 1]},
        {"4": [0, 0, float("nan"), 1]},
        {"4": [10**400, 0, 1, 1]},
        {"4": None},
        [],
    ],
)
def test_a_wrong_box_is_named_and_the_rest_stands(folder: Path, entry: object) -> None:
    manifest = read_manifest(written(folder, "a.avi,looming,1,9", "b.avi,looming,1,9"))
    content = {"a.avi": entry, "b.avi": {"3": [0, 0, 1, 1]}}
    (folder / "boxes.json").write_text(json.dumps(content))
    found = with_boxes(manifest)
    assert [entry.label.boxes for entry in found.entries] == [{}, {3: (0, 0, 1, 1)}]
    (fault,) = found.faults
    assert fault.startswith(f"{folder / 'boxes.json'}: a.avi: ")


def test_boxes_of_a_clip_without_a_looming_object_do_not_count(folder: Path) -> None:
    manifest = read_manifest(written(folder, "a.avi,looming,1,9", "b.avi,none,,", "c.avi,none,,"))
    boxes = {"3": [0, 0, 1, 1]}
    (folder / "boxes.json").write_text(json.dumps({"a.avi": boxes, "b.avi": boxes, "c.avi": {}}))
    found = with_boxes(manifest)
    assert [entry.label.boxes for entry in found.entries] == [{3: (0, 0, 1, 1)}, {}, {}]
    (fault,) = found.faults
    assert "boxes.json: b.avi: has boxes, but is labelled none" in fault


@pytest.mark.parametrize("content", ["", "[1]", "{", "[" * 100_000])
def test_a_file_without_boxes(folder: Path, content: str) -> None:
    manifest = read_manifest(written(folder, "a.avi,looming,1,9"))
    (folder / "boxes.json").write_text(content)
    with pytest.raises(ManifestError, match=r"boxes\.json: (is not valid JSON|must be an object)"):
        with_boxes(manifest)
    with pytest.raises(ManifestError, match="check --boxes"):
        with_boxes(manifest, folder / "none.json")


def test_settings_hold_for_all_evaluated_detectors() -> None:
    changes = {"opplod.cell": 10, "alarm.hold_s": 1.5, "time.interval": "frame"}
    usual = evaluated_detectors(["opplod", "opplod_reference"])
    found = evaluated_detectors(["opplod", "opplod_reference"], "keep", changes)
    assert [one.name for one in found] == [one.name for one in usual]
    for one, before in zip(found, usual, strict=True):
        stated, was = one.as_dict(), before.as_dict()
        assert stated["alarm"]["hold_s"] == 1.5 != was["alarm"]["hold_s"]
        assert stated["alarm"]["factor"] == was["alarm"]["factor"]
        assert stated["time"]["interval"] == "frame" != was["time"]["interval"]
        assert stated["repeats"]["handling"] == "keep"
        assert stated["height"] == was["height"]
        changed = {k for k, v in stated["parameters"].items() if v != was["parameters"][k]}
        assert changed == ({"cell"} if one.name == "opplod" else set())
    for wrong, reason in (
        ({"lgmd2.threshold": 1}, "the evaluation has no parameter set 'lgmd2'; add a detector"),
        ({"places.most": 1}, "has no parameter set 'places'; add a detector with --model, or"),
        ({"opplod.cel": 10}, "did you mean 'cell'"),
        ({"opplod.cell": "10deg"}, "opplod.cell=10deg: the fields of view of labelled clips are"),
    ):
        with pytest.raises(ParameterError) as error:
            evaluated_detectors([], None, wrong)
        assert reason in str(error.value), wrong


def test_a_file_of_settings_holds_for_all_evaluated_detectors(tmp_path: Path) -> None:
    path = tmp_path / "robot.toml"
    path.write_text(
        'models = ["opplod_reference", "lgmd2"]\nheight = 120\n'
        '[opplod_reference]\ncell = 8\n[alarm]\nhold_s = 1.5\n[repeats]\nhandling = "exact"\n'
    )
    baselines = ["dlgmd", "frame_difference", "flow_divergence"]
    found = evaluated_detectors(config=path)
    assert [one.name for one in found] == ["opplod_reference", "lgmd2", *baselines]
    for one in found:
        stated = one.as_dict()
        handling, hold_s = stated["repeats"]["handling"], stated["alarm"]["hold_s"]
        assert (stated["height"], hold_s, handling) == (120, 1.5, "exact"), one.name
    assert found[0].as_dict()["parameters"]["cell"] == 8
    # The command line overrides the file.
    changes = {"opplod_reference.cell": 9}
    found = evaluated_detectors(["opplod_reference"], "keep", changes, config=path, height="200")
    assert found[0].as_dict()["parameters"]["cell"] == 9
    assert {(one.height, one.repeats.handling) for one in found} == {(200, "keep")}
    with pytest.raises(ParameterError, match="height 'native' has no meaning for all of them"):
        evaluated_detectors(height="native")


def test_detectors_and_the_baselines_beside_them() -> None:
    baselines = ["dlgmd", "frame_difference", "flow_divergence"]
    found = [one.name for one in evaluated_detectors(["opplod_paper", "frame_difference"])]
    assert found == ["opplod_paper", "frame_difference", "dlgmd", "flow_divergence"]
    usual = [one.name for one in evaluated_detectors()]
    assert usual == ["opplod", "opplod_reference", *baselines]
    assert {one.name for one in evaluated_detectors(["all"])} == set(detectors())
    paper = evaluated_detectors(["opplod_paper"])[0].as_dict()
    assert (paper["height"], paper["parameters"]["receptive_field"]) == (600, 200)
    with pytest.raises(ParameterError, match="no model 'opplod_papr'; did you mean 'opplod_paper'"):
        evaluated_detectors(["opplod_papr"])
