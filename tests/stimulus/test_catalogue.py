"""The catalogue: complete, found everywhere, and true to its ground truth."""

from __future__ import annotations

import csv
import dataclasses
import hashlib
import shutil
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from oppload_cli import stimulus
from oppload_cli.errors import StimulusError
from oppload_cli.stimulus.catalogue import catalogue_directory
from oppload_cli.stimulus.files import Written, write_all
from tests.cli.process import HEAVY, loaded, python
from tests.stimulus.measuring import worst_errors

ENTRIES = [entry.name for entry in stimulus.entries()]
# Those of staged scenes have tests of their own.
PLAIN = [name for name in ENTRIES if not name.startswith("staged/")]


def test_every_entry_is_described_and_has_a_source() -> None:
    for entry in stimulus.entries():
        assert entry.description
        assert "\n" not in entry.description
        assert entry.source
        assert entry.tags
    assert {name.split("/")[0] for name in ENTRIES} == {
        *("opplod2023", "klapoetke2017", "controls", "staged")
    }


@pytest.mark.long
def test_more_than_150_stimuli_of_different_names_and_content() -> None:
    protocols = [protocol for name in ENTRIES for protocol in stimulus.load_all(name)]
    names = [protocol.name for protocol in protocols]
    assert len(names) == len(set(names)) > 150
    files = [stimulus.file_stem(name) for name in names]
    assert len(files) == len(set(files))
    for protocol in protocols:
        assert 0.5 <= protocol.timing.total_s <= 4
        assert protocol.display.width % 2 == protocol.display.height % 2 == 0


def test_a_prompt_shows_an_entry_in_one_line() -> None:
    assert max(len(repr(entry)) for entry in stimulus.entries()) < 500


@pytest.mark.long
def test_kinds_and_growths_all_appear() -> None:
    objects = [obj for name in ENTRIES for p in stimulus.load_all(name) for obj in p.objects]
    assert {obj.kind for obj in objects} >= {
        *("disk", "square", "cross", "bar", "ring", "patch", "edge", "field"),
        *("square-grating", "sine-grating", "plaid", "texture", "dots"),
    }
    growths = {obj.growth.kind for obj in objects if obj.growth is not None}
    assert growths == {"edge-speed", "approach", "steps"}


@pytest.mark.parametrize(
    ("name", "size", "width", "speed", "end"),
    [
        ("loom", 20, None, 10, 60),
        ("bar-expand-10/axis-45", 10, 10, 20, 60),
        ("bar-expand-60/axis-165", 10, 60, 20, 60),
        ("cross-outward", 10, 10, 20, 60),
    ],
)
def test_klapoetke_values(
    name: str, size: float, width: float | None, speed: float, end: float
) -> None:
    protocol = stimulus.load(f"klapoetke2017/{name}")
    (obj,) = protocol.objects
    assert obj.growth is not None
    shown = (obj.size_deg, obj.width_deg, obj.growth.speed_deg_s, obj.growth.end_deg)
    assert shown == (size, width, speed, end)
    # the motion lasts until the shape is complete
    assert protocol.timing.motion_s == pytest.approx((end - size) / 2 / speed)


def test_every_axis_of_the_published_responses_is_there(shared: Path) -> None:
    with (shared / "data" / "lplc2_klapoetke2017.csv").open() as lines:
        rows = [row for row in csv.DictReader(lines) if row["stimulus"] == "bar_expand"]
    assert len(rows) == 12
    for row in rows:
        name = f"klapoetke2017/bar-expand-{row['width_deg']}/axis-{row['axis_deg']}"
        assert stimulus.load(name).objects[0].axis_deg == float(row["axis_deg"])


def test_twelve_directions_and_eight() -> None:
    assert len(stimulus.load_all("opplod2023/bar-10")) == 12
    assert len(stimulus.load_all("klapoetke2017/bar-expand-60")) == 12
    assert len(stimulus.load_all("controls/square-grating")) == 8


@cache
def errors_of_entry(name: str) -> tuple[float, float, int]:
    """Return the worst errors of size and centre of one stimulus, and how many were measured."""
    protocols = stimulus.load_all(name)
    protocol = protocols[len(protocols) // 3]
    return worst_errors(protocol, range(3, protocol.frame_count, 20))


@pytest.mark.parametrize("name", PLAIN)
def test_frames_agree_with_the_ground_truth(name: str) -> None:
    """Thresholded size and centre within half a pixel, for one stimulus of each entry."""
    size, centre, _ = errors_of_entry(name)
    assert size < 0.5
    assert centre < 0.5


def test_most_entries_are_measured() -> None:
    """The test above does not pass because nothing is measured."""
    assert sum(errors_of_entry(name)[2] > 0 for name in PLAIN) > 35


def test_find_by_name_member_pattern_and_file(tmp_path: Path) -> None:
    assert [entry.name for entry in stimulus.find("klapoetke2017/loom")] == ["klapoetke2017/loom"]
    (protocol,) = stimulus.load_all("klapoetke2017/bar-expand-10/axis-45")
    assert protocol.objects[0].axis_deg == 45
    some = stimulus.load_all("klapoetke2017/bar-expand-?0/axis-4*")
    assert [one.name.split("/", 1)[1] for one in some] == [
        "bar-expand-10/axis-45",
        "bar-expand-20/axis-45",
        "bar-expand-60/axis-45",
    ]
    own = tmp_path / "own.toml"
    shutil.copy(catalogue_directory() / "klapoetke2017" / "loom.toml", own)
    assert stimulus.load(str(own)).name == "own"


def test_a_changed_member_keeps_its_other_values() -> None:
    member = "staged/collision/background-sky_speed-m-3_bearing-15x4_relative-luminance-0.4"
    (changed,) = stimulus.load_all(member, {"scene.background": "room"})
    assert changed.name == member.replace("sky", "room")
    part = stimulus.load_all("staged/collision/background-sky*", {"thing.course.speed_m_s": 5})
    assert [protocol.scene.background for protocol in part] == ["sky"] * 6
    # A key that excludes a swept key leaves one stimulus.
    (loom,) = stimulus.find("klapoetke2017/loom")
    sweep = {"display.pixels_per_degree": [4, 5]}
    entry = dataclasses.replace(loom, sweep=sweep, only="*/pixels-per-degree-4")
    (wide,) = entry.with_settings({"display.field_of_view_deg": 40}).protocols()
    assert (wide.name, wide.display.field_of_view_deg) == ("klapoetke2017/loom", 40)


def test_members_of_a_file_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source = catalogue_directory() / "klapoetke2017" / "loom-l-over-v.toml"
    shutil.copy(source, tmp_path / "my.toml")
    monkeypatch.chdir(tmp_path)
    names = {
        "my.toml/l-over-v-40": ["my/l-over-v-40"],
        "my.toml/*-200": ["my/l-over-v-200"],
        str(tmp_path / "my.toml/l-over-v-[24]0"): ["my/l-over-v-20", "my/l-over-v-40"],
    }
    for wanted, expected in names.items():
        assert [protocol.name for protocol in stimulus.load_all(wanted)] == expected
    # A folder may have any name.
    (tmp_path / "old.toml.d").mkdir()
    shutil.copy(source, tmp_path / "old.toml.d" / "my.toml")
    assert stimulus.load("old.toml.d/my.toml/l-over-v-40").name == "my/l-over-v-40"
    # The brackets of the file's own name are no pattern.
    shutil.copy(source, tmp_path / "my[1].toml")
    assert stimulus.load("my[1].toml/l-over-v-40").name == "my[1]/l-over-v-40"
    for wanted in ("my.toml/l-over-v-41", "my/l-over-v-40"):
        with pytest.raises(StimulusError, match=r"did you mean 'my\.toml/l-over-v-40'"):
            stimulus.find(wanted)


def test_the_names_of_members_tell_keys_and_values_apart() -> None:
    disks = stimulus.find("controls/two-looming-disks")[0]
    sweep: dict[str, list[Any]] = {"first.centre_deg": [[0, 2.25]], "second.centre_deg": [[1, 0]]}
    assert list(replace(disks, sweep=sweep).values()) == [
        "controls/two-looming-disks/first-centre-0x2.25_second-centre-1x0"
    ]
    places = stimulus.find("klapoetke2017/loom-position")[0]
    for given, values in (([1, 2], [[1, 2]]), ([[1, 2], [3, 4]], [[1, 2], [3, 4]])):
        assert places.with_settings({"position": given}).sweep == {"disk.centre_deg": values}
    # The end of a name comes before a part of another one, 'flickering-disk'.
    assert [entry.name for entry in stimulus.find("flicker")] == ["controls/flicker"]


def test_nothing_found_suggests_the_nearest() -> None:
    with pytest.raises(StimulusError, match="did you mean 'klapoetke2017/loom'"):
        stimulus.find("klapoetke2017/lom")
    with pytest.raises(StimulusError, match="oppload stimuli list"):
        stimulus.find("zzz*")
    with pytest.raises(StimulusError, match="no stimulus 'zi'"):
        stimulus.find("zi")  # two letters are too few for a part of a name
    assert [entry.name for entry in stimulus.find("zig")] == ["controls/zigzag-disk"]
    with pytest.raises(StimulusError, match="is 12 stimuli; name one of them"):
        stimulus.load("klapoetke2017/bar-expand-10")
    with pytest.raises(StimulusError, match="must be a name or a path, not 42"):
        stimulus.load_all(42)  # type: ignore[arg-type]


def test_settings() -> None:
    (one,) = stimulus.load_all("klapoetke2017/bar-expand-10", {"bar.axis_deg": 33})
    assert one.name == "klapoetke2017/bar-expand-10/axis-33"
    two = stimulus.load_all("klapoetke2017/bar-expand-10", {"bar.axis_deg": [1, 2]})
    assert [protocol.objects[0].axis_deg for protocol in two] == [1, 2]
    fast = stimulus.load("klapoetke2017/loom", {"display.frame_rate": 144, "seed": 9})
    assert fast.display.frame_rate == 144
    assert fast.seed == 9
    assert stimulus.load("klapoetke2017/loom").seed == 0
    for dotted, words in (
        ("disc.size_deg", "did you mean 'disk'"),
        ("disk.sise_deg", "did you mean 'size_deg'"),
        ("lv", "a key starts with display.KEY, .*, disk.KEY, or is seed or axis or .* l/v"),
        ("width", "settings width: no object of klapoetke2017/loom has width_deg; choose"),
    ):
        with pytest.raises(StimulusError, match=words):
            stimulus.load("klapoetke2017/loom", {dotted: 3})
    with pytest.raises(StimulusError, match=r"must be a dict, e\.g\. .* not \['seed=9'\]"):
        stimulus.load("klapoetke2017/loom", ["seed=9"])  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("key", "values"),
    [
        ("disk.growth.l_over_v_ms", [40.00001, 40.00002]),
        ("disk.growth.l_over_v_ms", [40, 20, 40]),
        ("description", ["A b", "a-b"]),
    ],
)
def test_two_values_of_one_name_are_an_error(key: str, values: list[object]) -> None:
    """Only one of the two stimuli would be shown."""
    (entry,) = stimulus.find("klapoetke2017/loom-l-over-v")
    with pytest.raises(StimulusError, match=f"two values of {key} give stimuli of the same name"):
        dataclasses.replace(entry, sweep={key: values}).protocols()


def test_words_stand_for_keys() -> None:
    (one,) = stimulus.load_all("klapoetke2017/loom-l-over-v", {"l/v": 20})
    assert one.name == "klapoetke2017/loom-l-over-v/l-over-v-20"
    aside = stimulus.load("klapoetke2017/loom", {"position": [3, 4], "speed": 7})
    (disk,) = aside.objects
    assert disk.growth is not None
    assert (disk.centre_deg, disk.growth.speed_deg_s) == ((3, 4), 7)
    loom = stimulus.find("klapoetke2017/loom")[0]
    ends = replace(loom, sweep={"disk.growth.end_deg": [40, 60]})
    assert ends.with_settings({"size": 50}).sweep == {"disk.growth.end_deg": [50]}
    sizes = replace(ends, sweep={**ends.sweep, "disk.size_deg": [10, 20]})
    with pytest.raises(StimulusError, match=r"that is disk\.size_deg or disk\.growth\.end_deg; wr"):
        sizes.with_settings({"size": 50})


def test_a_changed_value_replaces_the_one_that_stands_for_the_same() -> None:
    """360 px span 72 degrees at 5 px/deg, and 60 at 6."""
    wide = stimulus.load("klapoetke2017/loom", {"display.field_of_view_deg": 60})
    assert (wide.display.scale, wide.display.pixels_per_degree) == (6, None)
    both = {"display.field_of_view_deg": 60, "display.pixels_per_degree": 6}
    with pytest.raises(StimulusError, match="give either pixels_per_degree or field_of_view_deg"):
        stimulus.load("klapoetke2017/loom", both)
    (staged, *_) = stimulus.load_all("staged/near-miss", {"thing.file": "car.png"})
    assert [(obj.file, obj.drawing) for obj in staged.objects] == [("car.png", None)]


@pytest.mark.parametrize("name", ["thing", "file"])
def test_swept_files_lie_in_the_folder_of_the_protocol(name: str, tmp_path: Path) -> None:
    path = tmp_path / "own.toml"
    path.write_text(f'[sweep.{name}]\nfile = ["a.png", "b.png"]\n')
    expected = [str(tmp_path / "a.png"), str(tmp_path / "b.png")]
    assert stimulus.read_entry(path).sweep == {f"{name}.file": expected}


def test_reading_the_catalogue_needs_no_numpy() -> None:
    code = "from oppload_cli import stimulus; stimulus.load_all('klapoetke2017/*')"
    assert loaded(code, *HEAVY[:5]) == []


@pytest.mark.long
def test_the_catalogue_is_found_in_a_wheel_as_in_the_source(tmp_path: Path) -> None:
    """An installed wheel has it inside the package."""
    root = Path(stimulus.__file__).parents[2]
    assert catalogue_directory() == root / "stimuli"
    shutil.copytree(root / "oppload_cli", tmp_path / "oppload_cli")
    shutil.copytree(root / "stimuli", tmp_path / "oppload_cli" / "stimuli")
    code = "from oppload_cli import stimulus; print(len(stimulus.entries()), stimulus.__file__)"
    count, path = python(code, cwd=tmp_path, PYTHONPATH=str(tmp_path)).stdout.split()
    assert int(count) == len(ENTRIES)
    assert Path(path).is_relative_to(tmp_path)


@pytest.mark.slow
def test_complete_catalogue(tmp_path: Path) -> None:
    """Every stimulus is written, twice with the same bytes, and agrees with its truth."""
    plain = [protocol for name in PLAIN for protocol in stimulus.load_all(name)]
    staged = [stimulus.load_all(name)[0] for name in ENTRIES if name not in PLAIN]
    protocols = [*plain, *staged]
    digests = []
    for folder in (tmp_path / "a", tmp_path / "b"):
        results = write_all(protocols, folder, jobs=2)
        assert all(isinstance(one, Written) for one in results)
        files = sorted(folder.iterdir())
        assert len(files) == 2 * len(protocols)
        digests.append([hashlib.sha256(path.read_bytes()).hexdigest() for path in files])
        shutil.rmtree(folder)
    assert digests[0] == digests[1]
    for protocol in plain:
        size, centre, _ = worst_errors(protocol, range(0, protocol.frame_count, 6))
        assert size < 0.5, protocol.name
        assert centre < 0.5, protocol.name
