"""A ground truth beside a video, or beside a result, is that of this video or left out."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import pytest

from oppload_cli.errors import StimulusError
from oppload_cli.results.result_files import read_result
from oppload_cli.results.truths import (
    contacts_of,
    find_truth,
    read_truth,
    sizes_in,
    truth_fault,
    usable_truth,
)
from oppload_cli.stimulus import ground_truth, load
from tests.results.make import write_result

if TYPE_CHECKING:
    from pathlib import Path

TRUTH: dict[str, Any] = {
    "schema": "oppload.stimulus/1", "name": "disk", "looming": True, "contact_time_s": 2.0,
    "display": {"width": 320, "height": 240}, "frames": [{}] * 80,
}  # fmt: skip


def fault_of(folder: Path, truth: dict[str, Any], *shown: int | None) -> str:
    """Return what is said of a ground truth beside such a video, without its path."""
    path = folder / "disk.stimulus.json"
    path.write_text(json.dumps(truth))
    try:
        assert read_truth(path, *shown) == truth
    except StimulusError as error:
        return str(error).removeprefix(f"{path}: ")
    return ""


@pytest.mark.parametrize(
    ("shown", "fault"),
    [
        ((320, 240, 80), ""),
        ((160, 120, 80), ""),  # scaled
        ((106, 80, 80), ""),  # to even sides
        ((320, 240, 72), ""),  # cut by a tenth
        ((320, 240, None), ""),  # not declared
        ((320, 240, 71), "320 x 240 and 80 frames: this one has 71 frames"),
        ((320, 240, 160), "320 x 240 and 80 frames: this one has 160 frames"),
        ((329, 240, 80), ""),  # 2.8 % wider
        ((331, 240, 80), "320 x 240 and 80 frames: this one has 331 x 240"),
        ((320, 600, 80), "320 x 240 and 80 frames: this one has 320 x 600"),
        ((240, 320, 80), "320 x 240 and 80 frames: this one has 240 x 320"),
        ((None, None, None), ""),  # a result without a sidecar
        ((320, 0, 0), ""),  # a damaged sidecar
    ],
)
def test_another_shape_or_length_is_that_of_another_video(
    shown: tuple[int | None, int | None, int | None], fault: str, tmp_path: Path
) -> None:
    found = fault_of(tmp_path, TRUTH, *shown)
    assert found == (f"belongs to another video, of {fault}" if fault else "")


def test_contacts_and_sizes_of_two_disks() -> None:
    """The stated contact comes first; the disks appear at 0.2 and 0.8 s, without a size before."""
    truth = ground_truth(load("controls/two-looming-disks"))
    assert contacts_of(truth) == pytest.approx([1.6, 2.2])
    assert contacts_of({**truth, "contact_time_s": None}) == pytest.approx([1.6, 2.2])
    assert contacts_of({**truth, "contact_time_s": 2.2}) == pytest.approx([2.2, 1.6])
    sizes = sizes_in([*truth["frames"], None])
    assert list(sizes) == ["first", "second"]
    for at, (name, shown) in enumerate((("first", 6), ("second", 24))):
        known = [frame["objects"][at]["angular_size_deg"] for frame in truth["frames"][shown:]]
        assert sizes[name] == [*[None] * shown, *known, None]


def test_a_short_truth_may_differ_by_five_frames(tmp_path: Path) -> None:
    short = {**TRUTH, "frames": [{}] * 20}
    assert [bool(fault_of(tmp_path, short, 320, 240, count)) for count in (14, 15, 25, 26)] == [
        True, False, False, True,
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"display": {"width": 320}}, "the size of its display"),
        ({"display": {"width": 320, "height": 0}}, "the size of its display"),
        ({"display": []}, "the size of its display"),
        ({"contact_time_s": ...}, "its contact_time_s"),
        ({"name": ...}, "its name"),
    ],
)
def test_a_truth_that_lacks_something_is_told(
    change: dict[str, Any], said: str, tmp_path: Path
) -> None:
    truth = {key: value for key, value in (TRUTH | change).items() if value is not ...}
    assert fault_of(tmp_path, truth, 320, 240) == f"lacks {said}; generate the stimulus again"


def test_a_result_leaves_out_a_damaged_or_foreign_truth(tmp_path: Path) -> None:
    path = write_result(tmp_path / "clip.frames.csv")
    beside = tmp_path / "clip.stimulus.json"
    own = json.dumps(ground_truth(load("klapoetke2017/loom-l-over-v/l-over-v-40")))
    facts = {"input": {"width": 320, "height": 600, "frames_declared": 40}}
    for text, sidecar, fault in (
        ("{", {}, "clip.stimulus.json: is not valid JSON"),
        (own, facts, "clip.stimulus.json: belongs to another video, of "),
        (own, {}, ""),
    ):
        beside.write_text(text)
        (tmp_path / "clip.oppload.json").write_text(json.dumps(sidecar))
        result = read_result(path)
        assert fault in truth_fault(result)
        assert bool(truth_fault(result)) == bool(fault)
        assert (usable_truth(result) is None) == bool(fault)
        if fault:
            with pytest.raises(StimulusError, match=r"clip\.stimulus\.json: (is|belongs) "):
                find_truth(result)


def test_what_the_run_left_out_stays_left_out(tmp_path: Path) -> None:
    path = write_result(tmp_path / "clip.frames.csv")
    truth = ground_truth(load("klapoetke2017/loom-l-over-v/l-over-v-40"))
    (tmp_path / "clip.stimulus.json").write_text(json.dumps(truth))
    sidecar = {"stimulus": {"path": "clip.stimulus.json", "error": "belongs to another video"}}
    (tmp_path / "clip.oppload.json").write_text(json.dumps(sidecar))
    result = read_result(path)
    assert find_truth(result) is None
    assert truth_fault(result) == "its ground truth is left out (belongs to another video)"


def with_sidecar(tmp_path: Path, stimulus: object) -> Path:
    path = write_result(tmp_path / "clip.frames.csv")
    path.with_name("clip.oppload.json").write_text(json.dumps({"stimulus": stimulus}))
    return path


def test_the_sidecar_names_or_holds_the_ground_truth(tmp_path: Path) -> None:
    truth = ground_truth(load("klapoetke2017/loom-l-over-v/l-over-v-40"))
    (tmp_path / "other.stimulus.json").write_text(json.dumps(truth))
    for stated in ({"path": "other.stimulus.json"}, "other.stimulus.json", truth):
        stimulus = stated if isinstance(stated, dict) else {"path": str(tmp_path / stated)}
        found = find_truth(read_result(with_sidecar(tmp_path, stimulus)))
        assert found is not None
        assert len(found["frames"]) == len(truth["frames"])
        assert found["contact_time_s"] == pytest.approx(2.2)


def test_a_result_may_have_no_ground_truth(tmp_path: Path) -> None:
    assert find_truth(read_result(write_result(tmp_path / "clip.frames.csv"))) is None


def test_a_file_that_is_no_ground_truth_is_named(tmp_path: Path) -> None:
    path = write_result(tmp_path / "clip.frames.csv")
    path.with_name("clip.stimulus.json").write_text('{"schema": "x"}')
    with pytest.raises(StimulusError, match=r"clip\.stimulus\.json: its schema is 'x'"):
        find_truth(read_result(path))
