"""``oppload stimuli``: list, show, generate, schema."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import pytest

from oppload_cli import stimulus
from oppload_cli.cli.stimuli import FORMATS
from oppload_cli.errors import ExitCode
from oppload_cli.stimulus.files import write_all
from oppload_cli.video import writers as writer
from tests.cli.inside import Done, oppload
from tests.cli.process import HEAVY, loaded

if TYPE_CHECKING:
    from pathlib import Path

SMALL = [
    *("--change", "display.width=48", "--change", "display.height=40"),
    *("--change", "display.pixels_per_degree=0.6", "--change", "timing.motion_s=0.2"),
]
OWN = """
description = "own"
[display]
width = 41
height = 40
pixels_per_degree = 1
[timing]
motion_s = 0.2
[[object]]
id = "disk"
kind = "disk"
size_deg = 10
"""


def run(*words: object) -> Done:
    return oppload("stimuli", *map(str, words))


def test_list_is_a_table() -> None:
    result = run("list")
    assert result.returncode == 0
    lines = result.stdout.splitlines()
    row = next(line for line in lines if line.startswith("klapoetke2017/bar-expand-10 "))
    assert row.split()[1] == "12"
    assert "both ends growing" in row
    count = len(stimulus.entries())
    assert lines[-1].startswith(f"{count} protocols, ")
    assert int(lines[-1].split()[2]) > 150


def test_list_as_json() -> None:
    listed = json.loads(run("list", "--json").stdout)
    assert [one["name"] for one in listed] == [entry.name for entry in stimulus.entries()]
    for one in listed:
        assert set(one) == {"name", "description", "source", "tags", "members"}
        assert one["description"]
        assert one["source"]
        assert isinstance(one["tags"], list)
        assert one["members"]


def test_list_some() -> None:
    listed = json.loads(run("list", "--json", "opplod2023/looming*").stdout)
    assert [one["name"] for one in listed] == [
        "opplod2023/looming-disk-centre",
        "opplod2023/looming-disk-off-centre",
    ]


def test_show() -> None:
    shown = run("show", "klapoetke2017/bar-expand-10").stdout
    assert "12 axes" in shown
    assert "Klapoetke et al. 2017" in shown
    assert "klapoetke2017/bar-expand-10/axis-165" in shown
    assert "360 x 360 px, 5 px/deg, flat, 30 Hz" in shown
    assert "bar.axis_deg = [0, 15," in shown


def test_show_states_the_displays_of_all_stimuli_of_a_sweep(tmp_path: Path) -> None:
    path = tmp_path / "rates.toml"
    path.write_text(f"{OWN}\n[sweep]\ndisplay.frame_rate = [60, 144]\ntiming.after_s = [0, 1]\n")
    shown = run("show", str(path)).stdout.splitlines()
    lines = [line[13:] for line in shown[: shown.index("")]]
    assert [line.split()[-2] for line in lines if line.endswith(" Hz")] == ["60", "144"]
    assert sum(line.endswith(" s)") for line in lines) == 4


def test_show_as_json_is_the_resolved_protocol() -> None:
    result = run("show", "klapoetke2017/loom", "--json", "--change", "display.frame_rate=60")
    (table,) = json.loads(result.stdout)
    expected = stimulus.load("klapoetke2017/loom", {"display.frame_rate": 60})
    assert stimulus.Protocol.from_table(table, "shown") == expected
    assert table["display"]["frame_rate"] == "60/1"


def test_show_names_the_changes_with_the_values_before() -> None:
    changes = ("display.frame_rate=60", "bar.axis_deg=45")
    words = [word for change in changes for word in ("--change", change)]
    shown = run("show", "klapoetke2017/bar-expand-10", *words).stdout.splitlines()
    assert shown[1] == "changed:     display.frame_rate = 60, in the file 30"
    assert shown[2].startswith(f"{'':13}bar.axis_deg = 45, in the file [0, 15, 30, ")
    assert any(line.endswith("flat, 60 Hz") for line in shown)
    assert "The file, without the changes:" in shown
    shown = run("show", "klapoetke2017/loom", "--change", "effects.noise=0.1").stdout.splitlines()
    assert shown[1] == "changed:     effects.noise = 0.1, which the file leaves out"


def test_a_stimulus_that_is_too_fast_for_its_frames_gets_one_note() -> None:
    result = run("show", "controls/sine-grating", "--change", "grating.motion.speed_deg_s=300")
    assert result.returncode == 0
    assert result.stderr == (
        "note: controls/sine-grating/axis-0 and 7 more: object 'grating': it moves by half of its "
        "period or more from one frame to the next, so that its direction cannot be seen; lower "
        "its speed, or raise display.frame_rate\n"
    )


def test_the_truth_of_a_changed_stimulus_says_so(tmp_path: Path) -> None:
    run("generate", "klapoetke2017/loom", "-o", tmp_path, *SMALL)
    truth = stimulus.read_ground_truth(tmp_path / "klapoetke2017_loom.stimulus.json")
    before = stimulus.load("klapoetke2017/loom").description
    assert truth["protocol"]["description"] == (
        f"{before} (changed: display.width = 48, display.height = 40, "
        "display.pixels_per_degree = 0.6, timing.motion_s = 0.2)"
    )
    own = {"disk.luminance": 0.2, "description": "darker"}
    assert stimulus.load("klapoetke2017/loom", own).description == "darker"


def test_generate_writes_video_truth_and_preview(tmp_path: Path) -> None:
    name = "opplod2023/looming-disk-centre"
    result = run("generate", name, "-o", tmp_path / "new", "--preview", *SMALL)
    assert result.returncode == 0
    assert result.stdout.strip() == str(tmp_path / "new" / "opplod2023_looming-disk-centre.avi")
    assert sorted(path.name for path in (tmp_path / "new").iterdir()) == [
        "opplod2023_looming-disk-centre.avi",
        "opplod2023_looming-disk-centre.preview.png",
        "opplod2023_looming-disk-centre.stimulus.json",
    ]
    truth = stimulus.read_ground_truth(
        tmp_path / "new" / "opplod2023_looming-disk-centre.stimulus.json"
    )
    assert truth["display"]["width"] == 48
    assert len(truth["frames"]) == 6


def test_generate_a_family_several_at_a_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[int] = []

    def alone(*protocols: Any, jobs: int, **options: Any) -> Any:
        asked.append(jobs)
        return write_all(*protocols, jobs=1, **options)

    monkeypatch.setattr("oppload_cli.stimulus.files.write_all", alone)
    result = run(
        *("generate", "controls/square-grating/axis-?5", "controls/sine-grating/axis-90"),
        *("-o", tmp_path, "--jobs", 2, *SMALL),
    )
    assert result.returncode == 0
    assert [line.rsplit("_", 1)[1] for line in result.stdout.splitlines()] == [
        "axis-45.avi",
        "axis-90.avi",
    ]
    assert asked == [2]


def test_formats_are_those_of_the_writer() -> None:
    assert tuple(writer.FORMATS) == FORMATS


def test_mp4_says_that_it_is_lossy(tmp_path: Path) -> None:
    result = run("generate", "klapoetke2017/loom", "-o", tmp_path, "--format", "mp4", *SMALL)
    assert result.returncode == 0
    assert "lossy" in result.stderr
    assert "H.264" not in result.stdout
    assert "lossy" in run("generate", "--help").stdout


def test_existing_files(tmp_path: Path) -> None:
    words = ("generate", "klapoetke2017/loom", "-o", tmp_path, *SMALL)
    run(*words)
    path = tmp_path / "klapoetke2017_loom.avi"
    first = path.read_bytes()
    found = run(*words)
    assert found.returncode == ExitCode.USAGE
    assert "klapoetke2017_loom.avi: exists already; choose --if-exists overwrite or" in found.stderr
    changed = (*words, "--change", "disk.luminance=0.4")
    kept = run(*words, "--if-exists", "skip")
    assert (kept.returncode, kept.stdout) == (0, "")
    lacking = run(*words, "--if-exists", "skip", "--preview")
    assert (lacking.returncode, lacking.stdout.strip()) == (0, str(path))
    sheet = path.with_suffix(".preview.png")
    sheet.write_bytes(sheet.read_bytes() + b"kept")
    assert run(*words, "--if-exists", "skip", "--preview").stdout == ""
    assert sheet.read_bytes().endswith(b"kept")
    others = run(*changed, "--if-exists", "skip")
    assert others.returncode == ExitCode.USAGE
    assert "exists already, with another object" in others.stderr
    path.with_suffix(".stimulus.json").write_text("{")
    assert "but its ground truth cannot be read" in run(*words, "--if-exists", "skip").stderr
    assert path.read_bytes() == first
    assert run(*changed, "--if-exists", "overwrite").stdout.strip() == str(path)
    assert path.read_bytes() != first


@pytest.mark.parametrize("handling", ["skip", "overwrite"])
def test_the_ground_truth_of_another_format_is_not_replaced(tmp_path: Path, handling: str) -> None:
    words = ("generate", "klapoetke2017/loom", "-o", tmp_path, *SMALL)
    again = (*words, "--if-exists", handling)
    run(*words, "--format", "png")
    truth = tmp_path / "klapoetke2017_loom.stimulus.json"
    before = truth.read_bytes()
    assert run(*again, "--format", "npz").returncode == 0
    assert truth.read_bytes() == before
    found = run(*again, "--change", "display.projection=perspective")
    assert found.returncode == ExitCode.USAGE
    assert "klapoetke2017_loom: exists already, with another display" in found.stderr
    assert "its ground truth would be replaced" in found.stderr
    assert truth.read_bytes() == before
    assert not truth.with_name("klapoetke2017_loom.avi").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["klapoetke2017/lom"], "did you mean 'klapoetke2017/loom'?"),
        (["gone.toml"], "gone.toml: cannot be read (no such file or directory); check the path"),
        (["klapoetke2017/loom", "--change", "disk.size_deg"], "--change takes key=value"),
        (["loom-l-over-v", "--change", "l/v=10, 20"], "needs brackets; write 'l/v=[10, 20]'"),
        (
            ["klapoetke2017/loom", "--change", "disk.size_deg=-3"],
            "klapoetke2017/loom with disk.size_deg = -3: object 'disk': size_deg must be",
        ),
        (["klapoetke2017/loom", "--change", "dsik.size_deg=3"], "did you mean 'disk'?"),
        (
            ["klapoetke2017/loom", "--change", "display.frame_rate=0"],
            "frame_rate must be above 0 Hz",
        ),
        (["klapoetke2017/loom", "--change", "disk.centre_deg=[99,0]"], "outside the field"),
        (
            ["klapoetke2017/loom-l-over-v/l-over-v-40", "--change", "disk.growth.contact_s=0.1"],
            "pause",
        ),
        (["klapoetke2017/bar-expand-10", "--change", "bar.axis_deg=[]"], "takes a number"),
        (
            ["klapoetke2017/loom", "--format", "mp4", "--change", "display.width=361"],
            "klapoetke2017/loom with display.width = 361: display.width = 361 is odd",
        ),
        (["klapoetke2017"], "did you mean 'klapoetke2017/*'?"),
    ],
)
def test_mistakes(words: list[str], message: str, tmp_path: Path) -> None:
    found = run("generate", *words, "-o", tmp_path / "out")
    said = found.stderr.splitlines()[-1]
    assert said.startswith("oppload: ")
    assert message in said
    assert found.returncode == ExitCode.USAGE
    assert not (tmp_path / "out").exists()


def test_a_bad_name_does_not_stop_the_others(tmp_path: Path) -> None:
    own = tmp_path / "own.toml"
    own.write_text(OWN)
    result = run("generate", "klapoetke2017/lom", own, "-o", tmp_path)
    assert result.returncode == ExitCode.INCOMPLETE
    assert result.stdout.strip() == str(tmp_path / "own.avi")
    assert "did you mean 'klapoetke2017/loom'" in result.stderr
    again = run("generate", "klapoetke2017/lom", own, "-o", tmp_path, "--if-exists", "skip")
    assert (again.returncode, again.stdout) == (ExitCode.INCOMPLETE, "")  # one is there


def test_two_different_stimuli_of_one_name(tmp_path: Path) -> None:
    for folder, width in (("a", "41"), ("b", "42")):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "own.toml").write_text(OWN.replace("41", width))
    words = ("generate", tmp_path / "a" / "own.toml", tmp_path / "b" / "own.toml")
    result = run(*words, "-o", tmp_path)
    assert result.returncode == ExitCode.INCOMPLETE
    assert "two different stimuli are named 'own'" in result.stderr


def test_nothing_is_made_where_all_fails(tmp_path: Path) -> None:
    result = run("generate", "nothing", "klapoetke2017/lom", "-o", tmp_path)
    assert result.returncode == ExitCode.USAGE
    first, second = result.stderr.splitlines()
    assert "no stimulus 'nothing'" in first
    assert "klapoetke2017/lom" in second


def test_schema() -> None:
    assert json.loads(run("schema").stdout) == stimulus.json_schema()


def test_listing_imports_nothing_heavy() -> None:
    code = (
        "from click.testing import CliRunner; from oppload_cli.cli.stimuli import stimuli\n"
        "assert CliRunner().invoke(stimuli, ['list']).exit_code == 0"
    )
    assert loaded(code, *HEAVY[:5]) == []
