"""Results and sizes in degrees, from ``--fov`` or from the ground truth of a stimulus."""

from __future__ import annotations

import json
import math
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import av
import cv2
import pytest

import oppload_cli as oppload
from oppload_cli.errors import OutputError, ParameterError
from oppload_cli.pipeline.execute import run_task
from oppload_cli.pipeline.settings import resolve
from oppload_cli.pipeline.task import IfExists, Outputs, Task
from oppload_cli.stimulus.catalogue import load
from oppload_cli.stimulus.files import write
from oppload_cli.video.frames import WorkingSize
from oppload_cli.video.optics import Optics
from tests.assigned import assigned
from tests.media import grey_frames, write_video
from tests.results.make import rows_of

if TYPE_CHECKING:
    from pathlib import Path

WORKING = WorkingSize(200, 100, 2.0, 2.0)
WIDE = Optics.of_fov(400, 200, 90)


def done(video: Path, folder: Path, **settings: Any) -> tuple[list[dict[str, str]], dict[str, Any]]:
    """Run OppLoD; return the rows of its table, and the sidecar."""
    settings = {"models": ["opplod"], **settings}
    resolved = resolve(measure_rmo=False, height="120", **settings)
    outputs = Outputs.of(folder, video.stem, resolved.models)
    folder.mkdir()
    run_task(Task(str(video), resolved, outputs))
    return rows_of(outputs.csv), json.loads((folder / f"{video.stem}.oppload.json").read_text())


@pytest.fixture(scope="module")
def stimulus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A disk that grows by 10 deg/s at each edge, 10 deg right and 6 deg up, at 5 px/deg."""
    changes = {"display.width": 300, "display.height": 240, "display.pixels_per_degree": 5,
               "disk.centre_deg": [10, 6], "timing.motion_s": 0.8,
               "disk.growth.speed_deg_s": 15}  # fmt: skip
    protocol = load("opplod2023/looming-disk-centre", changes)
    return write(protocol, tmp_path_factory.mktemp("stimulus")).video


@pytest.mark.long
def test_a_field_of_view_that_the_ground_truth_contradicts_gives_a_remark(
    stimulus: Path, tmp_path: Path
) -> None:
    for fov, told in ((60.5, False), (59.3, True), (60.7, True)):  # 300 px at 5 px/deg
        _, sidecar = done(stimulus, tmp_path / f"{fov}", fov=fov)
        said = (
            f"the field of view given is {fov} degrees, but that of the ground truth 60; "
            "the given one is used"
        )
        assert (said in sidecar["remarks"]) == told


@pytest.mark.long
def test_a_damaged_or_foreign_ground_truth_is_left_out(stimulus: Path, tmp_path: Path) -> None:
    video = tmp_path / "clip.mkv"
    video.write_bytes(stimulus.read_bytes())
    beside = tmp_path / "clip.stimulus.json"
    own = json.loads(stimulus.with_name(f"{stimulus.stem}.stimulus.json").read_text())
    count = len(own["frames"])
    tall = {**own, "display": {**own["display"], "height": 600}}
    for name, text, told in (
        ("own", json.dumps(own), ""),
        ("cut", json.dumps(own)[:50], "is not valid JSON"),
        ("tall", json.dumps(tall), f"belongs to another video, of 300 x 600 and {count} frames"),
    ):
        beside.write_text(text)
        _, sidecar = done(video, tmp_path / name)
        said = f"its ground truth is left out ({beside}: {told}"
        assert any(each.startswith(said) for each in sidecar["remarks"]) == bool(told)
        assert (sidecar["field_of_view"] is None) == bool(told)
        assert ("error" in sidecar["stimulus"]) == bool(told)


@pytest.mark.long
def test_images_have_the_rate_and_the_degrees_of_the_ground_truth_beside_their_folder(
    stimulus: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "disk-2.5"  # with a dot, as after a sweep
    folder.mkdir()
    with av.open(stimulus) as container:
        for index, frame in enumerate(container.decode(video=0)):
            cv2.imwrite(str(folder / f"{index}.png"), frame.to_ndarray(format="gray"))
    truth = json.loads(stimulus.with_name(f"{stimulus.stem}.stimulus.json").read_text())
    truth["display"]["frame_rate"] = "85/1"
    beside = tmp_path / "disk-2.5.stimulus.json"
    monkeypatch.chdir(folder)
    for content, rate in (("{}", (Fraction(30), True)), (json.dumps(truth), (Fraction(85), False))):
        beside.write_text(content)
        for name in (str(folder), ".", f"../{folder.name}", "%d.png", str(folder / "%d.png")):
            with oppload.open_video(name) as video:
                assert (video.facts.frame_rate, video.facts.rate_assumed) == rate
    sidecar = oppload.run("%d.png", models=["opplod"], rmo=False, height=60).sidecar
    assert sidecar["field_of_view"]["horizontal_deg"] == pytest.approx(60)
    slow = oppload.run(".", models=["opplod"], rmo=False, height=60, rate=30).sidecar
    said = "the rate given is 30 frames/s, but that of the ground truth 85; the given one is used"
    found = [any(said in remark for remark in each["remarks"]) for each in (sidecar, slow)]
    assert found == [False, True]
    settings = resolve(models=["dlgmd"], measure_rmo=False, height="24")
    outputs = Outputs.of(tmp_path, "a", settings.models)
    kept = [
        run_task(Task(str(folder), settings, outputs, if_exists=IfExists.SKIP)).skipped
        for _ in range(2)
    ]
    assert kept == [False, True]


@pytest.mark.parametrize("aspect", [Fraction(1), Fraction(4, 3)])
def test_pixels_that_are_no_squares_give_a_remark(tmp_path: Path, aspect: Fraction) -> None:
    video = tmp_path / "a.mkv"
    with av.open(str(video), "w") as container:
        stream: Any = container.add_stream("mpeg4", rate=30)
        stream.width, stream.height, stream.pix_fmt = 128, 96, "yuv420p"
        stream.sample_aspect_ratio = stream.codec_context.sample_aspect_ratio = aspect
        for image in grey_frames(12, width=128, height=96):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="gray")))
        container.mux(stream.encode())
    for fov in (None, 90.0):
        _, sidecar = done(video, tmp_path / f"{fov}", fov=fov)
        said = "has pixels of an aspect of 1.333, but the field of view is meant for square pixels"
        told = any(said in each for each in sidecar["remarks"])
        assert told == (aspect != 1 and fov is not None)


def test_a_stimulus_is_seen_in_the_degrees_of_its_ground_truth(
    stimulus: Path, tmp_path: Path
) -> None:
    rows, sidecar = done(stimulus, tmp_path / "a", models=["opplod_reference"])
    truth = json.loads(stimulus.with_name(f"{stimulus.stem}.stimulus.json").read_text())
    seen = [row for row in rows if row["opplod_reference_azimuth_deg"]]
    assert len(seen) > 5
    for row in seen[2:]:
        assert float(row["opplod_reference_azimuth_deg"]) == pytest.approx(10, abs=2)
        assert float(row["opplod_reference_elevation_deg"]) == pytest.approx(6, abs=2)
        [disk] = truth["frames"][int(row["frame"])]["objects"]
        size = float(row["opplod_reference_angular_size_deg"])
        # Around a small plain disk the search moves some of the ground too.
        assert disk["angular_size_deg"] < size < 1.75 * disk["angular_size_deg"]
    view = sidecar["field_of_view"]
    assert (view["origin"], view["projection"]) == ("stimulus", "flat")
    assert (view["horizontal_deg"], view["vertical_deg"]) == pytest.approx((60, 48))
    assert view["sizes_deg"]["opplod_reference.receptive_field"] == pytest.approx(20)
    lines = (tmp_path / "a" / f"{stimulus.stem}.detections.jsonl").read_text().splitlines()
    first = json.loads(lines[0])
    assert first["angular_size_deg"] == max(first["angular_width_deg"], first["angular_height_deg"])


def test_the_user_knows_the_field_of_view_best(stimulus: Path, tmp_path: Path) -> None:
    _, sidecar = done(stimulus, tmp_path / "a", fov="90")
    view = sidecar["field_of_view"]
    assert (view["origin"], view["projection"]) == ("--fov", "pinhole")
    assert view["horizontal_deg"] == pytest.approx(90)


def test_without_a_field_of_view_nothing_is_in_degrees(stimulus: Path, tmp_path: Path) -> None:
    alone = tmp_path / "alone.mkv"
    alone.write_bytes(stimulus.read_bytes())
    rows, sidecar = done(alone, tmp_path / "a")
    assert sidecar["field_of_view"] is None
    assert not [name for name in rows[0] if name.endswith("_deg")]


def test_a_field_of_view_alone_gives_degrees(tmp_path: Path) -> None:
    """Of 64 x 50 px at 60 degrees, seen at 154 x 120; the focal length is 32 px / tan(30 deg)."""
    video = write_video(tmp_path / "a.avi", grey_frames(5, width=64, height=50))
    rows, sidecar = done(
        video, tmp_path / "a", fov="60", assignments={"opplod.receptive_field": "30"}
    )
    assert {name for name in rows[0] if name.endswith("_deg")} >= {"opplod_azimuth_deg"}
    view, focal = sidecar["field_of_view"], 32 / math.tan(math.radians(30))
    assert (view["horizontal_deg"], view["vertical_deg"]) == pytest.approx(
        (60, 2 * math.degrees(math.atan(25 / focal)))
    )
    size = view["sizes_deg"]["opplod.receptive_field"]
    assert size == pytest.approx(2 * math.degrees(math.atan(15 * 50 / 120 / focal)))
    speed = sidecar["working"]["source_px_per_s_at_1_px_per_frame"]
    assert speed == pytest.approx(30 * 64 / 154)
    per_s = 5 / sidecar["wall_s"]
    assert sidecar["frames_per_s"] == pytest.approx(per_s, rel=0.05, abs=0.06)  # both are rounded


def test_a_result_in_other_degrees_is_not_kept(stimulus: Path, tmp_path: Path) -> None:
    def again(**settings: Any) -> None:
        resolved = resolve(models=["opplod"], measure_rmo=False, height="120", **settings)
        outputs = Outputs.of(tmp_path / "a", stimulus.stem, resolved.models)
        run_task(Task(str(stimulus), resolved, outputs, if_exists=IfExists.SKIP))

    size = {"opplod.receptive_field": "20deg"}
    done(stimulus, tmp_path / "a", fov="70", assignments=size)
    again(fov="70", assignments=size)
    changes: list[dict[str, Any]] = [
        {"fov": "90"},
        {},
        {"fov": "70", "assignments": {"opplod.receptive_field": "40deg"}},
    ]
    for settings in changes:
        with pytest.raises(OutputError, match="is a result with other settings"):
            again(**{"assignments": size, **settings})


def test_sizes_in_degrees_become_working_pixels() -> None:
    given = {"opplod.receptive_field": "90deg", "opplod.cell": 4}
    settings = resolve(fov="90", height="100", assignments=given).seen_through(WIDE, WORKING)
    params = settings.groups["opplod"].as_dict()
    assert (params["receptive_field"], params["cell"]) == (200, 4)
    assert settings.angles == {}


def test_the_last_size_counts(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    path.write_text('fov = 90\n[opplod]\nreceptive_field = "90deg"\ncell = "2deg"\n')
    from_file = resolve(config=path)
    assert from_file.fov == 90
    assert from_file.angles == {"opplod.receptive_field": 90, "opplod.cell": 2}
    changed = resolve(config=path, assignments={"opplod.receptive_field": "80"})
    assert changed.angles == {"opplod.cell": 2}


def test_a_size_in_degrees_needs_the_field_of_view() -> None:
    settings = resolve(assignments={"opplod.receptive_field": "60deg"})
    with pytest.raises(
        ParameterError, match=r"receptive_field=60deg needs .* --fov DEGREES .in Python fov=DEGREES"
    ):
        settings.seen_through(None, WORKING).model_params()


@pytest.mark.parametrize(
    ("given", "reason"),
    [
        ("opplod.receptive_field=0deg", "above 0deg and below 180deg, not '0deg'"),
        ("opplod.receptive_field=widedeg", "above 0deg and below 180deg, not 'widedeg'"),
        ("opplod.receptive_field=180deg", "above 0deg and below 180deg"),
        ("opplod_lplc2.arm_cone=60deg", "takes a number, not '60deg'"),
    ],
)
def test_wrong_angles_are_refused(given: str, reason: str) -> None:
    with pytest.raises(ParameterError, match=reason):
        resolve(assignments=assigned(given))


def test_a_size_too_small_for_a_pixel() -> None:
    settings = resolve(fov="90", assignments={"opplod.receptive_field": "0.1deg"})
    with pytest.raises(ParameterError, match=r"opplod.receptive_field=0.1deg: .* at least 2"):
        settings.seen_through(WIDE, WORKING)
