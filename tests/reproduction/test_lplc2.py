"""The battery of an LPLC2 study, and the answers of opplod_lplc2 to it (docs/lplc2.md)."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import pytest

from oppload_cli.models.opplod_lplc2 import OpplodLplc2Params
from oppload_cli.pipeline.settings import resolve
from oppload_cli.reproduction.claims import Built, ClaimVerdict
from oppload_cli.reproduction.lplc2 import (
    BATTERY,
    Row,
    _alike,
    _effects,
    _published,
    _ranges,
    phenomena,
    show,
)
from oppload_cli.stimulus.catalogue import load_all
from oppload_cli.tuning.present import present

if TYPE_CHECKING:
    from collections.abc import Sequence


def test_likeness_leaves_the_loom_out_of_r() -> None:
    rows = [
        Row("loom", None, None, "one", 1.0, 1.0),
        Row("edge", 0, None, "one", 0.2, 0.1),
        Row("edge", 45, None, "one", 9.0, None),
        Row("edge", 90, None, "one", 0.4, 0.2),
        Row("cross-outward", None, 10, "one", 0.5, 0.3),
    ]
    r, rms = _alike(rows).numbers.values()
    assert r == pytest.approx(np.corrcoef([0.2, 0.4, 0.5], [0.1, 0.2, 0.3])[0, 1])
    assert rms == pytest.approx(math.sqrt((0 + 0.01 + 0.04 + 0.04) / 4))
    assert _alike(rows).verdict is ClaimVerdict.IN_PART
    large = [row._replace(peak_over_loom=10 * row.peak_over_loom) for row in rows]
    assert _alike(large).verdict is ClaimVerdict.DOES_NOT
    table = Built("lplc2", "", "", (), None, tuple(row._asdict() for row in rows)).table()
    assert table.splitlines()[:3] == [
        "stimulus,axis_deg,width_deg,detector,peak_over_loom,published",
        "loom,,,one,1,1",
        "edge,0,,one,0.2,0.1",
    ]


def test_phenomena_of_a_silent_model_are_in_no_range() -> None:
    axes: dict[str, list[float | None]] = {
        family.name: [None]
        if family.name in {"loom", "cross-outward", "cross-inward"}
        else [float(axis) for axis in range(0, 360, 15)]
        for family in BATTERY
    }
    rows = [
        Row(name, axis, None, "toy", float(name == "loom"), None)
        for name, own in axes.items()
        for axis in own
    ]
    found = phenomena(rows)
    assert len(found) == 10
    kept = [name for name, (value, low, high) in found.items() if low <= value <= high]
    assert kept == ["inward cross"]
    assert _ranges(rows).startswith(
        "both ends over one end, least: at least 2.5; outward cross: 0.35 to 0.6; inward cross: 0 t"
    )
    both = [
        row._replace(peak_over_loom=0.5) if row.stimulus == "bar-expand-20" else row for row in rows
    ]
    assert math.isnan(phenomena(both)["both ends over one end, least"][0])
    text = _effects(rows).text
    assert "both ends over one end, least: no response to compare; outward cross: 0;" in text
    inward = [
        row._replace(peak_over_loom=0.5) if "corners" in row.stimulus else row for row in rows
    ]
    other = {("cross-outward", None): 0.5, ("grating", 225.0): 0.2}
    unlike = [
        row._replace(peak_over_loom=other.get((row.stimulus, row.axis_deg), 0.1)) for row in rows
    ]
    assert phenomena(unlike)["outward cross"][0] == 0.5
    assert phenomena(unlike)["sweeps, edges, gratings, largest"][0] == 0.2
    text = _effects(inward).text
    assert "corners over the bar, largest: infinite, because the second stimulus" in text


def test_each_effect_is_the_ratio_of_its_stimuli() -> None:
    usual: dict[str, float] = {
        "loom": 1, "bar-expand-10": 0.4, "bar-expand-20": 0.3, "bar-expand-60": 0.2,
        "bar-expand-10-one-end": 0.1, "bar-expand-20-one-end": 0.15, "bar-expand-60-one-end": 0.05,
        "bar-expand-inward-corners": 0.04, "bar-expand-inward-periphery": 0.02,
        "cross-outward": 0.5, "cross-inward": 0.02,
        "bar-sweep": 0.05, "edge": 0.03, "grating": 0.02,
    }  # fmt: skip
    others = {
        ("bar-expand-10", 90): 0.5, ("bar-expand-60", 15): 0.1, ("bar-expand-60", 30): 0.15,
        ("bar-expand-60", 45): 0.05, ("bar-expand-inward-corners", 15): 0.2,
        ("bar-expand-inward-periphery", 30): 0.1, ("edge", 45): 0.01, ("grating", 180): 0.3,
        ("bar-expand-20-one-end", 150): 0.2,
    }  # fmt: skip
    rows = [
        Row(name, axis, None, "toy", others.get((name, axis or 0), peak), None)
        for name, peak in usual.items()
        for axis in (None, *range(0, 360, 15))
    ]
    values = [value for value, _, _ in phenomena(rows).values()]
    assert values == pytest.approx([1.5, 0.5, 0.02, 0.5, 0.25, 0.25, 1.5, 0.8, 0.01, 0.3])


def test_likeness_of_equal_and_of_unknown_peaks_in_words() -> None:
    rows = [Row("edge", axis, None, "toy", 0.0, 0.1) for axis in (0, 90)]
    assert _alike(rows).text == "All peaks are equal: no r; rms 0.1."
    unknown = [row._replace(peak_over_loom=math.nan) for row in rows]
    assert _alike(unknown).text == "No response to compare."


def test_every_published_peak_has_its_stimulus() -> None:
    known = _published()
    assert len(known) == 21
    assert known["bar-expand-60", 165] == 0.23
    assert known["edge", 270] == 0.05


@pytest.mark.long
def test_a_loom_outward_and_inward_arms() -> None:
    names = {"loom", "cross-outward", "cross-inward"}
    families = [family for family in BATTERY if family.name in names]
    shown = show("opplod_lplc2", families)
    peaks = {row.stimulus: row.peak_over_loom for row in shown.rows}
    assert {name: signal.max() for name, (_, signal) in shown.courses.items()} == peaks
    assert peaks["loom"] == 1
    assert peaks["cross-outward"] == pytest.approx(0.57, abs=0.03)
    assert peaks["cross-inward"] < 0.05


def off_centre(
    places: Sequence[tuple[float, float]], stimulus: str = "klapoetke2017/loom"
) -> list[float]:
    """Return peaks of one unit for a disk at places in degrees, over that in its centre."""
    settings = resolve(models=["opplod_lplc2"], assignments={"opplod_lplc2.units": "1x1"})
    indicator_s = OpplodLplc2Params().calcium_s
    peaks = []
    for place in ((0.0, 0.0), *places):
        (protocol,) = load_all(stimulus, {"disk.centre_deg": list(place)})
        shown = present(protocol, settings, indicator_s=indicator_s)["opplod_lplc2"]
        peaks.append(float(np.nanmax(shown.response)))
    return [peak / peaks[0] for peak in peaks[1:]]


@pytest.mark.slow
def test_a_loom_off_the_centre() -> None:
    near, far = off_centre(((10.6, 10.6), (30.0, 0.0)))
    assert 0.5 <= near <= 0.9
    assert far <= 0.3


@pytest.mark.long
def test_the_unit_over_a_loom_wins() -> None:
    settings = resolve(models=["opplod_lplc2"])
    (protocol,) = load_all("klapoetke2017/loom", {"disk.centre_deg": [10.6, -10.6]})
    found = present(protocol, settings)["opplod_lplc2"]
    off = np.hypot(*(found.centre - (180 + 5 * 10.6)).T) / 5
    moving = found.response > 0
    assert moving.sum() > 5
    assert np.median(off[moving]) < 6


@pytest.mark.slow
def test_the_same_peaks_at_other_rates_and_sizes() -> None:
    large = {"display.width": 720, "display.height": 720, "display.pixels_per_degree": 10}
    names = ("loom", "bar-expand-10/axis-0", "bar-expand-60/axis-15", "cross-outward")

    def peaks(rate: int, height: int) -> list[float]:
        settings = resolve(
            models=["opplod_lplc2"], height=str(height), assignments={"opplod_lplc2.units": "1x1"}
        )
        signals = []
        for name in names:
            changes = {"display.frame_rate": rate} | (large if height > 360 else {})
            (protocol,) = load_all(f"klapoetke2017/{name}", changes)
            (shown,) = present(protocol, settings, 1, 1.0).values()
            signals.append(float(np.nanmax(shown.response)))
        return [signal / signals[0] for signal in signals]

    usual = peaks(30, 240)
    for rate, height, within in ((60, 240, 0.03), (240, 240, 0.03), (30, 480, 0.15)):
        assert peaks(rate, height) == pytest.approx(usual, rel=within), (rate, height)


@pytest.mark.slow
def test_it_is_tuned_as_the_neurons_are() -> None:
    rows = show("opplod_lplc2").rows
    assert len(rows) == 123
    assert _alike(rows).verdict is ClaimVerdict.HOLDS
    for name, (value, low, high) in phenomena(rows).items():
        assert low <= value <= high, name


@pytest.mark.slow
def test_opplod_reference_is_not() -> None:
    r, rms = _alike(show("opplod_reference").rows).numbers.values()
    assert rms > 1
    assert r < 0.8
