"""The fit of preset lplc2 (`python -m benchmarks.fit_lplc2`)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from benchmarks.fit_lplc2 import (
    INSIDE,
    MEMBERS,
    REFERENCE,
    Battery,
    Target,
    fit,
    main,
    misses,
    read_reference,
    stands_for,
)
from oppload_cli.errors import ParameterError
from oppload_cli.models.registry import parameters_of
from oppload_cli.reproduction.lplc2 import BATTERY, show

if TYPE_CHECKING:
    from pathlib import Path


HEADER = "stimulus,axis_deg,width_deg,peak_relative_to_loom\n"


@pytest.mark.long
def test_the_published_peaks_find_their_stimuli() -> None:
    targets = read_reference(REFERENCE)
    assert len(targets) == 21
    by_name = {target.stimulus: target.peak for target in targets}
    assert by_name["klapoetke2017/bar-expand-60/axis-165"] == 0.23
    assert by_name["klapoetke2017/bar-sweep/rotation-270"] == 0.06


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ("loom,,,1\nbar,0,10,0.3\n", "line 3: no stimulus 'bar'"),
        ("loom,,,1\nbar_expand,0,30,0.3\n", "no stimulus 'bar_expand' with width '30'"),
        ("loom,,,1\nbar_expand,7,10,0.3\n", "stimulus 'bar_expand' has no axis '7'"),
        ("loom,,,1\nbar_expand,x,10,0.3\n", "stimulus 'bar_expand' has no axis 'x'"),
        ("loom,,,1\nbar_expand,0,wide,0.3\n", "no stimulus 'bar_expand' with width 'wide'"),
        ("loom,,,inf\n", "line 2: the peak must be a number of at least 0"),
        ("bar_expand,0,10,0.3\n", "has no row of 'loom'"),
        ("loom,,,1\nloom,,,1\n", "line 3: stimulus 'klapoetke2017/loom' has two rows"),
        ("loom,,,1\ncross_outward,,10,-0.1\n", "line 3: the peak must be a number of at least 0"),
        ("loom,,,x\n", "line 2: the peak must be a number of at least 0"),
        (
            "loom,,,1\ncross_outward,,10,0.4\n",
            "--free names 2 parameters for 1 rows; free fewer, or add rows",
        ),
    ],
)
def test_bad_references(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], rows: str, said: str
) -> None:
    path = tmp_path / "peaks.csv"
    path.write_text(HEADER + rows)
    assert main([str(path), "--free", "inward,lateral"]) == 2
    assert said in capsys.readouterr().err


def test_a_missing_reference(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["missing.csv"]) == 2
    assert "missing.csv: cannot be read" in capsys.readouterr().err


def test_quarter_turns_and_mirrors_are_alike() -> None:
    bars = "klapoetke2017/bar-expand-10/axis-{}"
    assert {stands_for(bars.format(axis)) for axis in (15, 75, 105, 165)} == {bars.format(15)}
    assert stands_for(bars.format(135)) == bars.format(45)
    assert stands_for("klapoetke2017/edge/rotation-270") == "klapoetke2017/edge/rotation-0"
    assert stands_for("klapoetke2017/cross-outward") == "klapoetke2017/cross-outward"


def test_a_phenomenon_counts_by_its_distance_from_its_range() -> None:
    assert misses({}) == []
    cross = {"klapoetke2017/cross-outward": 0.6, "klapoetke2017/cross-inward": 0.01}
    assert misses(cross) == pytest.approx([INSIDE - 1, 0])
    assert misses(cross, without="cross-outward") == [0]
    assert misses({"loom at 15, 0": 0.25}) == pytest.approx([2 * INSIDE - 1])
    both = dict.fromkeys(MEMBERS, 0.1)
    ends, outward, *_ = misses(both)
    assert ends == pytest.approx(2.5 * INSIDE - 1)
    assert outward == pytest.approx(3.5 * INSIDE - 1)
    assert len(misses(both, without="bar-expand-10")) == 10 - 4


@pytest.mark.slow
def test_a_fit_is_that_of_its_seed_and_goes_on(tmp_path: Path) -> None:
    name = "klapoetke2017/cross-outward"
    params = parameters_of("opplod", "lplc2")
    battery = Battery([name], params)
    # The fit and the model agree about the unit in the middle.
    families = [each for each in BATTERY if each.name in {"loom", "cross-outward"}]
    rows = {row.stimulus: row.peak_over_loom for row in show("lplc2", families).rows}
    assert battery.peaks({})[name] == pytest.approx(rows["cross-outward"], rel=2e-3)
    targets = [Target("klapoetke2017/loom", "loom", 1.0), Target(name, "cross-outward", 0.3)]
    state = tmp_path / "state"
    one, errors = fit(battery, targets, ["surround"], seed=3, generations=2, state=state)
    two, _ = fit(battery, targets, ["surround"], seed=3, generations=2)
    assert one.tolist() == two.tolist()
    assert errors[0] < (rows["cross-outward"] - 0.3) ** 2
    kept, _ = fit(battery, targets, ["surround"], seed=4, generations=0, state=state)
    assert kept.ravel().tolist() == pytest.approx(one.ravel().tolist())
    with pytest.raises(ParameterError, match="names 2 parameters for 1 rows"):
        fit(battery, targets, ["surround", "inward"], seed=3, generations=1)
