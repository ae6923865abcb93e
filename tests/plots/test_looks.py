"""Curves that a reader can tell apart."""

from __future__ import annotations

import io
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from matplotlib.colors import LogNorm, to_rgb
from PIL import Image

from oppload_cli.models.registry import detectors
from oppload_cli.plots import style
from oppload_cli.plots.panels import CurveOptions, panels_of
from oppload_cli.plots.style import image_bytes, looks_of, missing_characters, styled_figure
from oppload_cli.results.result_files import read_result
from tests.results.make import write_result

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

# From linear RGB to OKLab (Ottosson 2020).
TO_CONES = np.array([
    [0.4122214708, 0.5363325363, 0.0514459929],
    [0.2119034982, 0.6806995451, 0.1073969566],
    [0.0883024619, 0.2817188376, 0.6299787005],
])  # fmt: skip
TO_LAB = np.array([
    [0.2104542553, 0.7936177850, -0.0040720468],
    [1.9779984951, -2.4285922050, 0.4505937099],
    [0.0259040371, 0.7827717662, -0.8086757660],
])  # fmt: skip
# What readers without one kind of cones see (Machado, Oliveira and Fernandes 2009).
WITHOUT_RED = np.array([
    [0.152286, 1.052583, -0.204868],
    [0.114503, 0.786281, 0.099216],
    [-0.003882, -0.048116, 1.051998],
])  # fmt: skip
WITHOUT_GREEN = np.array([
    [0.367322, 0.860646, -0.227968],
    [0.280085, 0.672501, 0.047413],
    [-0.011820, 0.042940, 0.968881],
])  # fmt: skip


EVERY_CONE = np.eye(3)


def distance(one: str, other: str, eye: NDArray[np.float64] = EVERY_CONE) -> float:
    """Return the distance of two colours in OKLab, as an eye sees them."""
    places = []
    for colour in (one, other):
        value = np.array(to_rgb(colour))
        linear = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
        places.append(TO_LAB @ np.cbrt(TO_CONES @ np.clip(eye @ linear, 0, 1)))
    return float(np.linalg.norm(places[0] - places[1]))


def test_any_two_detectors_have_colours_that_differ() -> None:
    assert abs(distance("#000000", "#FFFFFF") - 1) < 1e-6
    colours = {name: detector.colour for name, detector in detectors().items()}
    apart = {
        (one, other): distance(colours[one], colours[other])
        for one, other in combinations(colours, 2)
    }
    assert {pair: value for pair, value in apart.items() if value < 0.1} == {}


def test_detectors_with_the_same_dashes_differ_for_the_colour_blind() -> None:
    looks = dict(zip(detectors(), looks_of(list(detectors())), strict=True))
    assert len({str(look["linestyle"]) for look in looks.values()}) == 4
    for one, other in combinations(looks, 2):
        if looks[one]["linestyle"] == looks[other]["linestyle"]:
            for eye in (WITHOUT_RED, WITHOUT_GREEN):
                apart = distance(looks[one]["color"], looks[other]["color"], eye)
                assert apart >= 0.055, (one, other)


def test_a_detector_has_the_same_look_in_every_figure_of_several() -> None:
    names = list(detectors())
    every = dict(zip(names, looks_of(names), strict=True))
    assert looks_of(names[9:2:-1]) == [every[name] for name in names[9:2:-1]]
    assert [looks_of([name])[0]["linestyle"] for name in names] == ["-"] * len(names)


@pytest.mark.parametrize(
    "names",
    [
        ["opplod", "dlgmd", "frame_difference"],
        ["opplod", "dlgmd", "opplod_reference", "opplod_paper"],
        ["opplod", "opplod_reference", "opplod_paper", "opplod_lplc2"],
        ["dlgmd"] * 4,
    ],
)
def test_a_few_curves_differ_in_dashes_and_markers_in_grey(names: list[str]) -> None:
    looks = looks_of(names)
    for part in ("linestyle", "marker"):
        assert len({str(look[part]) for look in looks}) == len(names)


def test_curves_over_time_have_the_looks_of_their_detectors(tmp_path: Path) -> None:
    result = read_result(write_result(tmp_path / "a.frames.csv"))
    for shown in (["dlgmd", "opplod"], ["dlgmd"]):
        (curves,) = panels_of([result], CurveOptions(tuple(shown)))
        assert [curve.dash for curve in curves] == [e["linestyle"] for e in looks_of(shown)]


def test_a_notebook_shows_a_figure() -> None:
    """IPython asks for this picture; matplotlib's own figures have none without pyplot."""
    with styled_figure(1, 0.5) as figure:
        pass
    shown: Any = figure
    with Image.open(io.BytesIO(shown._repr_png_())) as image:
        assert image.size == (150, 75)


def test_characters_come_from_another_font_where_the_usual_one_lacks_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    combined = "a\u20d2"  # in a font of matplotlib, but not in DejaVu Sans
    with styled_figure(2, 1) as figure:
        figure.text(0, 0, f"{combined}\n\U00012000")  # no usual font has cuneiform
    assert missing_characters(figure) == "\u20d2\U00012000"
    boxes = image_bytes(figure, "png")
    monkeypatch.setattr(style, "_FONTS", ["DejaVu Sans", "STIXGeneral"])
    monkeypatch.setitem(style._STYLE, "font.family", style._FONTS)
    with styled_figure(2, 1) as other:
        other.text(0, 0, f"{combined}\n\U00012000")
    assert missing_characters(other) == "\U00012000"
    assert image_bytes(other, "png") != boxes


def test_pdf_files_from_python_hold_fonts_that_can_be_edited(tmp_path: Path) -> None:
    with styled_figure(2, 1) as figure:
        figure.text(0, 0, "a")
    figure.savefig(tmp_path / "a.pdf")
    content = (tmp_path / "a.pdf").read_bytes()
    assert b"/CIDFontType2" in content
    assert b"/Type3" not in content


@pytest.mark.parametrize(
    ("values", "ends"),
    [
        ([1, 30, np.nan], (0, 30)),
        ([0, 1, 30.1], (1, 30.1)),  # logarithmic, as is all that follows with a lower end above 0
        ([1e-9, 1], (1e-4, 1)),
        ([0, 0], (0, 1)),
        ([np.nan], (0, 1)),
    ],
)
def test_the_scale_of_colours_is_logarithmic_above_a_ratio_of_30(
    values: list[float], ends: tuple[float, float]
) -> None:
    norm = style.norm_of(np.array(values, float))
    assert (norm.vmin, norm.vmax) == pytest.approx(ends)
    assert isinstance(norm, LogNorm) == (ends[0] > 0)
