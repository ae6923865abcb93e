"""The measurements behind the verdicts, against numbers known from elsewhere."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from oppload_cli.errors import ParameterError
from oppload_cli.motion.rmo import rmo
from oppload_cli.reproduction import bars, direction, looming, rmo_figures
from oppload_cli.reproduction.claims import (
    FIGURES,
    PAPER,
    PAPER_DETECTORS,
    REFERENCE,
    ClaimVerdict,
    build,
    chosen_figures,
    settings_of,
)
from oppload_cli.reproduction.rmo_figures import _construct, definition
from oppload_cli.stimulus.catalogue import load
from oppload_cli.tuning.present import Responses

SETTINGS = settings_of(REFERENCE)


def responses(values: list[float]) -> Responses:
    frame = np.arange(float(len(values)))
    return Responses(frame, frame / 10, np.array(values), np.full((len(values), 4), np.nan))


def test_the_construction_gives_the_closed_form() -> None:
    # Symmetric part min(2, 3) on the shared line, 10 degrees from both vectors.
    tilt = np.deg2rad(10)
    v1 = 2 * np.array([-np.cos(tilt), np.sin(tilt)])
    v2 = 3 * np.array([np.cos(tilt), np.sin(tilt)])
    made = _construct(np.array([-1.0, 0]), v1, np.array([1.0, 0]), v2)
    np.testing.assert_allclose(np.abs(made.line), [1, 0], atol=1e-12)
    np.testing.assert_allclose(made.meeting, [0, -np.tan(tilt)], atol=1e-12)
    np.testing.assert_allclose(made.middle, [0, -np.tan(tilt)], atol=1e-12)
    assert made.ratio == pytest.approx(2 * 2 / 5, abs=1e-3)
    assert made.ratio == pytest.approx(float(rmo(v1, v2)), abs=1e-3)


@pytest.mark.long
def test_the_definition_is_judged_by_its_numbers() -> None:
    closed, hundred = definition().claims
    assert hundred.source == ""  # our reading
    (first,), (second,) = closed.findings.values(), hundred.findings.values()
    assert first.verdict is ClaimVerdict.HOLDS
    assert 0 < first.numbers["largest_difference"] < 1e-3
    assert second.numbers == {"one_side": 0.5, "both_sides": 1.0}
    assert second.verdict is ClaimVerdict.IN_PART


def test_the_wrong_direction_leaks_as_the_documented_edge_does() -> None:
    # docs/model.md, section 4: suppressed over passing at 4 and 10 px/frame, and 0 up to 3;
    # the bar's corners make a little difference.
    assert direction._leak_at(2) == 0
    assert direction._leak_at(4) == pytest.approx(0.11 / 1.73, rel=0.15)
    assert direction._leak_at(10) == pytest.approx(3.28 / 4.90, rel=0.15)


@pytest.mark.slow
def test_looming_disk_in_the_middle() -> None:
    built = looming.looming_centre()
    near, dlgmd, earlier, _, found = (claim.findings[REFERENCE] for claim in built.claims)
    assert near.numbers["peak_frame"] == 23
    assert dlgmd.numbers["peak_frame"] == 44
    assert earlier.verdict is ClaimVerdict.IN_PART
    assert found.numbers["distance_px"] <= 10
    assert built.claims[0].findings[PAPER].numbers["peak_frame"] == 24
    others = "holds at 4.25, 4.5; does not hold at 3, 3.5, 5, 6 px/frame."
    assert near.text.endswith(f"At other speeds of the disk: {others}")
    assert not near.faint
    # A peak of 0.0001, which the paper's comparison rests on.
    assert all(found.faint.startswith("D-LGMD hardly responds") for found in (dlgmd, earlier))
    assert "D-LGMD at or before frame 3" in earlier.text
    assert built.settings[PAPER] == "native size, time.interval=frame"
    assert len(built.rows) == 2 * 45  # detectors, frames
    # In grey print only their dashes tell the curves apart.
    assert built.figure
    curves = built.figure.axes[0].get_lines()[:4:2]
    assert len({curve.get_linestyle() for curve in curves}) == 2


@pytest.mark.long
def test_the_paper_gives_frames_for_the_disk_in_the_middle_only(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(looming, "_SPEEDS", (looming._SPEED,))  # the others take time
    claims = looming.looming_off_centre().claims
    earlier, _, found = (claim.findings[REFERENCE].numbers for claim in claims)
    assert earlier == {"onset_frame": 8, "dlgmd_onset_frame": 3}
    assert found["distance_px"] <= 10
    assert [claim.statement for claim in claims] == [
        "OppLoD responds earlier than D-LGMD.",
        "OppLoD responds more strongly than D-LGMD.",
        "The model finds where the object is looming.",
    ]
    assert all("\u201c" in claim.source for claim in claims)


def test_the_disk_is_judged_by_frames_values_and_place_at_the_peak() -> None:
    pair = looming._Pair(
        PAPER,
        responses([math.nan, 0.0, 1.0, 4.0, 2.0]),
        responses([math.nan, 0.0, 0.5, 0.5, 2.0]),
    )
    earlier, stronger = looming._earlier(pair), looming._stronger(pair)
    assert earlier.numbers == {"onset_frame": 2, "dlgmd_onset_frame": 2}
    assert earlier.verdict is ClaimVerdict.IN_PART  # of equal frames none is earlier
    assert stronger.numbers == {"share_above": 1 / 3}  # of frames 1 to 3; 0 and 1/4 are equal
    boxes = np.full((5, 4), np.nan)
    boxes[3] = 100, 50, 20, 10
    placed = pair._replace(opplod=replace(pair.opplod, box=boxes))
    assert looming._place((110, 58), placed).numbers == {"distance_px": 3}


def test_crossings_need_the_largest_control() -> None:
    nan = float("nan")
    controls = {
        "a": {PAPER: responses([nan, 1, 2]), "dlgmd": responses([nan, 5, 0])},
        "b": {PAPER: responses([nan, 3, 0]), "dlgmd": responses([nan, 1, 0])},
    }
    assert looming._worst(controls) == {PAPER: ("b", 3.0), "dlgmd": ("a", 5.0)}
    limits = {PAPER: 3.0, "dlgmd": 5.0}
    looming_set = {
        "x": {PAPER: responses([nan, 3, 4]), "dlgmd": responses([nan, 6, 9])},
        "y": {PAPER: responses([nan, 4, 0]), "dlgmd": responses([nan, 5, 5])},
    }
    first = looming._crossings(looming_set, limits)
    assert first == {"x": {PAPER: 0.2, "dlgmd": 0.1}, "y": {PAPER: 0.1, "dlgmd": math.inf}}
    finding = looming._finding(first, limits)
    assert finding.numbers["first"] == finding.numbers["dlgmd_first"] == 1
    assert finding.verdict is ClaimVerdict.IN_PART
    first["z"] = {PAPER: 0.0, "dlgmd": math.inf}
    assert "Both miss" not in looming._finding(first, limits).text
    first["c/looming-disk-centre"] = {PAPER: math.inf, "dlgmd": math.inf}
    finding = looming._finding(first, limits)
    assert finding.text.endswith("Both miss: disk of the paper, centre.")
    assert (finding.numbers["first"], finding.numbers["dlgmd_first"]) == (2, 1)


def tunings(ten: dict[int, float], sixty: dict[int, float], loom: float) -> bars._Tunings:
    shown = {
        width: {axis: responses([float("nan"), 0, peak]) for axis, peak in peaks.items()}
        for width, peaks in ((10, ten), (60, sixty))
    }
    return bars._Tunings(shown, loom, 30.0, np.array([5.0, 7, 9]), SETTINGS)


@pytest.mark.parametrize(
    ("beyond", "stated", "verdict"),
    [(0.0, "0 %", ClaimVerdict.HOLDS), (0.2537, "25.4 %", ClaimVerdict.DOES_NOT)],
)
def test_the_edge_of_the_field_is_that_of_the_detector(
    beyond: float, stated: str, verdict: ClaimVerdict
) -> None:
    """A bar whose ends are 13 degrees out in frame 4, and 15 in the next one."""
    curve = [float("nan"), 1.0, *[0.9] * 3, *[beyond] * 20]
    shown = {width: {0: responses(curve)} for width in (10, 60)}
    tuned = bars._Tunings(shown, 1.0, 12.0, np.arange(5.0, 55, 2), SETTINGS)
    assert bars._edge(tuned).numbers["median_beyond_edge_over_peak"] == beyond
    assert bars._edge(tuned).text.startswith(f"{stated} of the peak")
    assert bars._edge(tuned).verdict is verdict
    assert bars._middle(tuned).numbers["lower_quartile_deg"] == pytest.approx(7)
    assert bars._middle(tuned).numbers["share"] == 1
    late = replace(tuned, reach=tuned.reach + 3)  # a peak at 10 of 12 degrees
    assert bars._middle(late).numbers["share"] == 0
    panels = bars._draw_over_time(dict.fromkeys(PAPER_DETECTORS, tuned)).axes
    for panel in panels:
        *curves, edge = panel.lines
        assert [np.nanmax(np.asarray(line.get_ydata(), float)) for line in curves] == [1]
        assert np.asarray(edge.get_xdata()).tolist() == [12, 12]


def test_the_edge_is_half_a_field_from_the_middle(monkeypatch: pytest.MonkeyPatch) -> None:
    """A display of 72 degrees: 200 of 240 px are 60 degrees, 200 of 600 px are 24."""
    shown = dict.fromkeys(PAPER_DETECTORS, responses([float("nan"), 2.0]))
    monkeypatch.setattr(bars, "presented", lambda name, *_: {name: shown})
    monkeypatch.setattr(bars, "_BAR", "klapoetke2017/bar-expand-{}/axis-45")
    for detector, edge in ((REFERENCE, 30), (PAPER, 12)):
        tuned = bars._tunings(detector, {})
        assert tuned.edge_deg == pytest.approx(edge)
        assert (tuned.loom, tuned.over_loom(10)) == (2, {45: 1})


def test_the_reach_of_the_ends_is_that_of_the_ground_truth() -> None:
    """From 5 degrees at 20 deg/s, for 1.25 s of 30 frames/s."""
    reach = bars._reach(load("klapoetke2017/bar-expand-10/axis-0", {"timing.before_s": 0}))
    np.testing.assert_allclose(reach[:38], 5 + 20 * np.arange(38) / 30)
    assert np.isnan(reach[38:]).all()
    assert len(reach) > 38


def test_bars_like_those_of_the_neurons_hold() -> None:
    # LPLC2's own numbers, with 0 and 90 degrees as their neighbours.
    ten = {0: 0.37, 15: 0.33, 45: 0.34, 75: 0.32, 90: 0.35, 105: 0.38, 135: 0.39, 165: 0.41}
    sixty = {0: 0.2, 15: 0.19, 45: 0.05, 75: 0.15, 90: 0.16, 105: 0.18, 135: 0.07, 165: 0.23}
    like = tunings(ten, sixty, 1.0)
    assert bars._likeness(like).numbers["rms_difference"] == pytest.approx(0, abs=1e-12)
    assert bars._likeness(like).verdict is ClaimVerdict.HOLDS
    assert bars._evenness(like).numbers["least_over_largest"] == pytest.approx(0.32 / 0.41)
    assert bars._evenness(like).verdict is ClaimVerdict.HOLDS
    # Real neurons do not prefer diagonals with the wide bar.
    assert bars._diagonal(like).verdict is ClaimVerdict.DOES_NOT
    assert bars._diagonal(like).numbers["diagonal_over_largest"] == pytest.approx(0.06 / 0.23)
    sixty_diagonal = {axis: 1.0 if axis in {45, 135} else 0.9 for axis in sixty}
    assert bars._diagonal(tunings(ten, sixty_diagonal, 1.0)).verdict is ClaimVerdict.HOLDS
    one_larger = {**sixty_diagonal, 90: 1.2}
    assert bars._diagonal(tunings(ten, one_larger, 1.0)).verdict is ClaimVerdict.IN_PART
    other = tunings({**ten, 15: 0.33 + 0.12}, sixty, 1.0)
    assert bars._likeness(other).numbers["rms_difference"] == pytest.approx(0.12 / math.sqrt(12))
    ninety = tunings({axis: 90 * value for axis, value in ten.items()}, sixty, 1.0)
    assert bars._likeness(ninety).verdict is ClaimVerdict.DOES_NOT


@pytest.mark.slow
def test_the_bars_are_shown_along_all_axes_of_the_catalogue() -> None:
    tuned = bars._tunings(REFERENCE, {})
    assert all(list(by_axis) == list(range(0, 180, 15)) for by_axis in tuned.bars.values())
    numbers = bars._diagonal(tuned).numbers
    assert numbers["diagonal_over_mean"] == pytest.approx(4.64, abs=0.05)
    assert numbers["diagonal_over_largest"] == pytest.approx(1.98, abs=0.05)


def test_bars_without_a_response_have_nothing_to_compare() -> None:
    silent = dict.fromkeys(range(0, 180, 15), 0.0)
    tuned = tunings(silent, silent, 1.0)
    for judge in (bars._middle, bars._edge, bars._evenness, bars._diagonal):
        assert judge(tuned).text == "No response to compare."
        assert judge(tuned).verdict is ClaimVerdict.DOES_NOT


def test_bars_that_hardly_excite_the_model_are_named() -> None:
    even = dict.fromkeys(range(0, 180, 15), 1e-5)
    tuned = tunings(even, dict.fromkeys(even, 1.0), 1.0)
    assert "hardly responds to the 10 degree bar (" in bars._evenness(tuned).faint
    assert bars._diagonal(tuned).faint == ""


def test_inward_motion_must_suppress_along_one_axis_at_least() -> None:
    outward = {angle: responses([math.nan, 1.0, 3.0]) for angle in (0, 45)}
    for along_0, along_45, verdict in (
        (0.2, 0.5, ClaimVerdict.HOLDS),
        (0.2, 1.0, ClaimVerdict.IN_PART),
        (1.0, 1.1, ClaimVerdict.DOES_NOT),
    ):
        shares = {0: along_0, 45: along_45}
        both = {at: responses([math.nan, share, 3 * share]) for at, share in shares.items()}
        shown = {direction._OUTWARD: outward, direction._BOTH: both}
        found = direction._suppression(shown, REFERENCE)
        assert list(found.numbers.values()) == pytest.approx([along_0, along_45])
        assert found.verdict is verdict


def test_inward_motion_is_judged_along_the_worse_axis() -> None:
    outward, inward = (
        {angle: responses([math.nan, 1.0, peak]) for angle, peak in ((0, one), (45, other))}
        for one, other in ((25.0, 5.0), (1.0, 1.0))
    )
    shown = {direction._OUTWARD: outward, direction._INWARD: inward}
    found = direction._inward(shown, REFERENCE)
    assert found.numbers == {"ratio_0_deg": 0.04, "ratio_45_deg": 0.2}
    assert found.verdict is ClaimVerdict.IN_PART


def test_the_speed_of_the_bar_is_that_at_the_working_height() -> None:
    """The bar of the paper grows at 4 px/frame of 600 px."""
    speeds = [direction._speed(load(direction._BAR), settings_of(name)) for name in PAPER_DETECTORS]
    assert speeds == pytest.approx([4 * 240 / 600, 4])


def test_diagonals_are_judged_by_shares_of_both_sides(monkeypatch: pytest.MonkeyPatch) -> None:
    leaks = np.array([[0.25, 0, 0, 0], [1.0, 0, 0, 0]])
    monkeypatch.setattr(direction, "_wrong_sides", lambda *_: (leaks, {}))
    monkeypatch.setattr(direction, "_draw_diagonals", lambda _: None)
    numbers = direction.diagonals().claims[0].findings[PAPER].numbers
    assert numbers == pytest.approx(
        {"least_mean_share_on_side": (0.8 + 0.5) / 2, "least_share_in_last_frame": 0.5}
    )


def test_the_speed_of_an_edge_is_that_at_the_working_height() -> None:
    """At 5 px/deg and 30 frames/s, a frame of 360 px has 1.5 times the speed of one of 240."""
    for per_second, frames in ((4, 0), (5, 2)):  # 0.44 and 0.56 px/frame
        changes = {"disk.motion.speed_deg_s": per_second, "timing.before_s": 0}
        name = "controls/translating-disk-speed/speed-20"
        moving = load(name, {**changes, "timing.motion_s": 0.1, "timing.after_s": 0})
        assert len(rmo_figures._index(moving)) == frames


def test_the_index_takes_all_frames_of_an_object_that_turns() -> None:
    """The edges of a turning bar have no speed along the line from its middle."""
    short = {"timing.before_s": 0, "timing.motion_s": 0.1, "timing.after_s": 0}
    turning = load("controls/rotating-bar/rotation-90", short)
    assert list(rmo_figures._index(turning)) == [1, 2]


def test_the_medians_decide_on_the_index_of_the_stimuli(monkeypatch: pytest.MonkeyPatch) -> None:
    shown = iter([{"a/loom": {3: 0.0, 4: 1.0, 5: 1.0}}, {"b/bar": {3: 0.4, 4: 0.1, 5: 0.1}}])
    monkeypatch.setattr(rmo_figures, "_indices", lambda _: next(shown))
    built = rmo_figures.stimuli()
    (finding,) = built.claims[0].findings.values()
    assert finding.text.endswith("the medians are 1.00 and 0.10.")
    assert finding.verdict is ClaimVerdict.IN_PART
    assert built.rows[1] == {"kind": "looming", "stimulus": "a/loom", "frame": 4, "rmo_index": 1.0}


def test_figures_are_chosen_by_name_in_the_order_of_the_page() -> None:
    assert chosen_figures([]) == list(FIGURES)
    assert chosen_figures(["rmo-definition", "up-down"]) == ["up-down", "rmo-definition"]
    with pytest.raises(ParameterError, match="no figure 'updown'; did you mean 'up-down'"):
        chosen_figures(["updown"])


@pytest.mark.slow
def test_figures_do_not_depend_on_the_number_of_processes() -> None:
    names = ["diagonals", "rmo-definition"]
    one, two = build(names, jobs=1), build(names, jobs=2)
    assert [figure.name for figure in one] == names
    assert [figure.pictures for figure in one] == [figure.pictures for figure in two]
    assert [figure.as_dict() for figure in one] == [figure.as_dict() for figure in two]
