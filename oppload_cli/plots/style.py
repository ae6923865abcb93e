"""The style of all figures, and the saving of figures."""

from __future__ import annotations

import io
import logging
import re
import textwrap
import warnings
from collections.abc import Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from functools import cache
from typing import TYPE_CHECKING, Any, TypeVar, cast

import numpy as np
from matplotlib import get_cachedir, style
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties, findfont, get_font, get_font_names
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.text import Text
from matplotlib.textpath import text_to_path
from matplotlib.ticker import StrMethodFormatter

from oppload_cli import palette
from oppload_cli.errors import ParameterError, printable
from oppload_cli.files.atomic import write_atomic
from oppload_cli.models.registry import detector_named, known_names
from oppload_cli.results.tuning import Tuning

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.axes import Axes
    from matplotlib.cm import ScalarMappable
    from matplotlib.colorbar import Colorbar
    from matplotlib.legend import Legend
    from numpy.typing import NDArray


T = TypeVar("T")

INK, FAINT = palette.INK, palette.FAINT
GREY = "#666666"  # the small print at the foot of a figure
CYCLE = ("#D55E00", "#0072B2", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
DASHES = ("-", (0, (5, 1.5)), (0, (1.5, 1.2)), (0, (6, 1.5, 1.5, 1.5)))
MARKERS = ("o", "^", "D", "v")  # of the points of a curve, one for each kind of dashes
LEAST_SIZE = 6  # points of the smallest letters
DOUBTFUL = {"color": FAINT, "lw": 0.7, "markersize": 2}  # the look of a curve that means little
FEW = 4  # so many detectors fit into one column
SHADES = "cividis"
LPLC2 = "#000000"
COLUMN = 8.5 / 2.54  # inches: the width of a journal's column
PANEL_WIDTH = 2.75  # inches: of a panel in a column, beside its labels
PAGE = 17.8 / 2.54  # inches: two columns
MOST_HEIGHT = 23 / 2.54  # inches: the height of a page
TITLE_WIDTH, LEGEND_WIDTH = 48, 50  # characters in a line above a column
DECADES = 4  # that a logarithmic heat map shows at most
# Lines may end at spaces, at hyphens between letters, and at the underscores of file names.
_BREAKS = re.compile(r"([ \t]+|[^ \t]*?(?:_+|(?<=[^\W\d_])-(?=[^\W\d_])))")
# The usual fonts with Chinese, Japanese and Korean characters, which DejaVu Sans lacks.
_EAST_ASIAN = (
    *("Noto Sans CJK JP", "Noto Sans CJK SC", "Noto Sans JP", "Noto Sans SC", "Noto Sans KR"),
    *("Source Han Sans", "IPAexGothic", "WenQuanYi Micro Hei", "WenQuanYi Zen Hei"),
    *("Hiragino Sans", "Apple SD Gothic Neo", "Yu Gothic", "Microsoft YaHei", "Malgun Gothic"),
    "Arial Unicode MS",
)
# Matplotlib takes a character from the first of these fonts that has it.
_FONTS = ["DejaVu Sans", *(name for name in _EAST_ASIAN if name in get_font_names())]
_STYLE: Any = {  # Any: the stubs list every key that matplotlib has
    "font.family": _FONTS,
    "font.size": 7.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 8,
    "legend.fontsize": 6.8,
    "xtick.labelsize": 7,
    "ytick.labelsize": 7,
    "axes.titlelocation": "left",
    "axes.edgecolor": INK,
    "lines.linewidth": 1.2,
    "legend.frameon": False,
    "axes.linewidth": 0.7,
    "xtick.major.width": 0.7,
    "ytick.major.width": 0.7,
    "savefig.dpi": 300,
    "text.hinting": "no_hinting",  # else letters are wider in a figure of few pixels
    "svg.hashsalt": "oppload",
    "svg.fonttype": "path",
    "pdf.fonttype": 42,
}
# By format. Matplotlib's own metadata hold the time, so that no two files would be equal.
METADATA: dict[str, dict[str, Any]] = {
    ".png": {"Software": "oppload"},
    ".svg": {"Date": None, "Creator": "oppload"},
    ".pdf": {"CreationDate": None, "ModDate": None, "Creator": "oppload", "Producer": "oppload"},
}


def _style() -> AbstractContextManager[None]:
    """Use the style with matplotlib's defaults, whatever settings the user has."""
    return style.context(["default", _STYLE])


class _Layout(ConstrainedLayoutEngine):
    """Matplotlib's constrained layout, with the positions of the panels rounded.

    Matplotlib's solver takes the panels in the order of their addresses in memory. So its errors of
    rounding differ from run to run.
    """

    def execute(self, fig: Figure) -> None:
        """Place the panels to a billionth of the figure."""
        super().execute(fig)
        for axes in fig.axes:
            axes.set_position(tuple(np.round(axes.get_position(original=True).bounds, 9)))
            axes.set_in_layout(True)  # set_position takes the panel out of the layout


class _Figure(Figure):
    """A figure that notebooks show, although pyplot, which changes settings, does not know it."""

    def savefig(self, fname: Any, **options: Any) -> None:
        """Save the figure in the style: with matplotlib's own, PDF files hold Type 3 fonts."""
        with _style(), _quiet_fonts():
            super().savefig(fname, **options)

    def _repr_png_(self) -> bytes:
        # The small print is then as large as the text of a notebook.
        return image_bytes(self, "png", 150)


@contextmanager
def styled_figure(width: float, height: float) -> Iterator[Figure]:
    """Make an empty figure of a size in inches, and use the style for the code of the context.

    The figure is at most as high as a page.
    """
    with _style():
        yield _Figure(figsize=(width, min(MOST_HEIGHT, height)), layout=_Layout())


def panel_grid(figure: Figure, count: int, columns: int, **options: Any) -> list[Axes]:
    """Make a number of panels in rows of `columns`, with options of ``Figure.subplots``."""
    grid = figure.subplots(-(-count // columns), columns, squeeze=False, **options).ravel()
    for free in grid[count:]:
        free.set_visible(False)
    for panel in grid[:count][-columns:]:  # the lowest of each column, also above an empty place
        panel.tick_params(labelbottom=True)
    return list(grid[:count])


def legend_over(axes: Axes, **options: Any) -> Legend:
    """Draw the legend right above the axes, with options of ``Axes.legend``."""
    options = {"borderpad": 0.1, **options}
    return axes.legend(loc="lower left", bbox_to_anchor=(0, 1), borderaxespad=0.1, **options)


def legend_over_figure(figure: Figure, axes: Axes, title: str, columns: int = 1) -> None:
    """Write title and legend above the panels, so that they cover no point of a curve."""
    figure.legend(
        *axes.get_legend_handles_labels(), loc="outside upper left", ncols=columns,
        title=wrapped(title, TITLE_WIDTH) or None, title_fontsize=8, alignment="left",
        borderaxespad=0.1, handlelength=2.6,
    )  # fmt: skip


def write_title(figure: Figure, title: str | None, width: int = TITLE_WIDTH) -> None:
    """Write the title of a figure, if it has one, in lines of at most `width` characters."""
    if title:
        figure.suptitle(wrapped(title, width), fontsize=8, x=0.02, ha="left")


def colour_bar(
    figure: Figure, image: ScalarMappable, axes: Axes | Sequence[Axes], label: str, **options: Any
) -> Colorbar:
    """Draw the colour bar of a heat map, with options of ``Figure.colorbar``."""
    bar = figure.colorbar(image, ax=axes, **options)
    bar.set_label(label)
    bar.outline.set_linewidth(0.5)
    return bar


def as_list(results: T | Sequence[T], kind: type[T]) -> list[T]:
    """Return one result, or a sequence of results, as a list.

    Raises
    ------
    ParameterError
        If there is none, or if one is not of this kind.
    """
    listed = list(results) if isinstance(results, Sequence) else [results]
    if not listed:
        raise ParameterError("there is no result to draw; give at least one")
    for result in listed:
        check_drawn(result, kind)
    return listed


def check_drawn(drawn: object, kind: type) -> None:
    """Raise a ParameterError for anything else than a result of this kind, such as its path."""
    if not isinstance(drawn, kind):
        source = "read_tuning" if kind is Tuning else "run or read_result"
        raise ParameterError(
            f"{type(drawn).__name__}: cannot be drawn; give what oppload_cli.{source} returns"
        )


def check_title(title: object) -> None:
    """Raise a ParameterError for a title that is no text, such as a number."""
    if not isinstance(title, str | None):
        raise ParameterError(f"title must be a text, not {title!r:.60}")


def as_names(names: Sequence[str]) -> tuple[str, ...]:
    """Return names as a tuple; a text is one name, not a sequence of letters."""
    given: object = (names,) if isinstance(names, str) else names  # maybe of a wrong type
    listed = tuple(given) if isinstance(given, Iterable) else (None,)
    if not all(isinstance(name, str) for name in listed):
        raise ParameterError(f"names must be a list of texts, not {given!r:.60}")
    return cast("tuple[str, ...]", listed)


def looks_of(detectors: Sequence[str]) -> list[dict[str, Any]]:
    """Return the line properties of each curve of a figure, from the detector of each curve.

    A curve has its detector's colour, dashes and markers, so that a print in grey shows which curve
    is which; a single curve is solid. If a detector has several curves, all curves take colours and
    dashes in turn, so that no two of up to 28 curves look alike.
    """
    if len(set(detectors)) == len(detectors):
        # Any two of OppLoD and its three versions, and of opplod, dlgmd and the first baselines,
        # have other dashes: so the versions are counted backwards, apart from the others.
        versions = sorted(name for name in known_names() if name.startswith("opplod_"))
        others = [name for name in known_names() if name not in versions]
        ordered = {name: number for number, name in enumerate(others)}
        ordered |= {name: number - len(versions) for number, name in enumerate(versions)}
        numbers = [ordered[name] if len(detectors) > 1 else 0 for name in detectors]
        colours = [detector_named(name).colour for name in detectors]
    else:
        numbers = list(range(len(detectors)))
        colours = [CYCLE[number % len(CYCLE)] for number in numbers]
    return [
        {
            "color": colour,
            "linestyle": DASHES[number % len(DASHES)],
            "marker": MARKERS[number % len(MARKERS)],
        }
        for colour, number in zip(colours, numbers, strict=True)
    ]


def check_xlim(times: Sequence[NDArray[np.float64]], xlim: tuple[float, float] | None) -> None:
    """Raise a ParameterError if an axis of time has no length in seconds, or shows no frame.

    `times` has the times of the frames of each curve, rising, and `xlim` the ends of the axis.
    """
    if xlim is None:
        return
    try:
        begin, end = xlim
        rising = np.isfinite(xlim).all() and begin < end
    except (TypeError, ValueError):  # no two numbers
        raise ParameterError(
            f"xlim must be the first and the last time of the axis in seconds, not {xlim!r:.60}"
        ) from None
    if not rising:
        raise ParameterError(
            f"an axis from {begin:g} to {end:g} s has no length in seconds; give two numbers, the "
            "smaller one first"
        )
    if not any(((begin <= time) & (time <= end)).any() for time in times):
        first, last = min(time[0] for time in times), max(time[-1] for time in times)
        raise ParameterError(
            f"no frame is between {begin:g} and {end:g} s; the frames are between "
            f"{short_number(first)} and {short_number(last)} s"
        )


def spread_ticks(axes: Axes, inches: float) -> None:
    """Write so few numbers along a time axis of this length that they do not overlap.

    Matplotlib assumes short numbers: long ones, such as 3600.2 after an hour, would overlap.
    The numbers are complete, without a common summand such as -4.999e4 beside the axis.
    """
    axes.ticklabel_format(axis="x", useOffset=False)
    ticks = axes.get_xticks()
    numbers = axes.xaxis.get_major_formatter().format_ticks(list(ticks))
    needed = 7 / 72 * (max(map(width_em, numbers)) + 1)  # inches: letters of 7 points, and a gap
    first, last = axes.get_xlim()
    if len(ticks) > 1 and inches * (ticks[1] - ticks[0]) / (last - first) < needed:
        axes.locator_params(axis="x", nbins=max(1, int(inches / needed)))


def number_in_full(axes: Axes) -> None:
    """Write complete numbers along the vertical axis: a legend would cover their common factor."""
    axes.yaxis.set_major_formatter(StrMethodFormatter("{x:g}"))


def begin_at_zero(axes: Axes) -> None:
    """Begin the vertical axis at 0, and let the axes cut no marker."""
    axes.set_ylim(0, 1.06 * max(axes.dataLim.y1, 0.0) or 1.0)  # room for half of a marker
    for line in axes.lines:
        line.set_clip_on(False)


def error_bars(
    axes: Axes,
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    deviations: NDArray[np.float64],
    colour: str,
) -> None:
    """Draw a bar of one deviation to each side of each point of a curve."""
    axes.errorbar(x, y, deviations, fmt="none", ecolor=colour, elinewidth=0.8)


def edges_of(places: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the n + 1 edges of cells around n rising places; the edges are half-way between them.

    The cell of a single place has the width 1.
    """
    if len(places) == 1:
        return np.array([places[0] - 0.5, places[0] + 0.5])
    middle = (places[1:] + places[:-1]) / 2
    ends = 2 * places[0] - middle[0], 2 * places[-1] - middle[-1]
    return np.concatenate(([ends[0]], middle, [ends[1]]))


def norm_of(values: NDArray[np.float64]) -> Normalize:
    """Return the colour scale of a heat map of values of at least 0.

    The scale is logarithmic if the largest value is more than 30 times the smallest one above 0. It
    begins at this smallest value, but at most four decades below the largest one.
    """
    above = values[np.isfinite(values) & (values > 0)]
    largest = float(above.max(initial=0)) or 1.0
    smallest = max(float(above.min(initial=largest)), largest * 10.0**-DECADES)
    if largest > 30 * smallest:
        return LogNorm(smallest, largest, clip=True)
    return Normalize(0, largest)


def save(figure: Figure, path: Path) -> list[str]:
    """Save a figure in the format of its suffix; return remarks on it, in sentences.

    Raises
    ------
    ParameterError
        If the suffix is not ``.png``, ``.svg`` or ``.pdf``.
    OutputError
        If the file cannot be written.
    """
    check_suffix(path)
    write_atomic(path, image_bytes(figure, path.suffix.lower().removeprefix(".")))
    missing = missing_characters(figure)
    if not missing:
        return []
    return [
        f"{path}: no font has {missing}, so that the figure shows boxes; install a font that has "
        f"them, such as Noto Sans CJK, and remove {get_cachedir()}, where matplotlib keeps its "
        "list of fonts"
    ]


def image_bytes(figure: Figure, form: str, dpi: float | None = None) -> bytes:
    """Return a figure as the content of a file: ``png``, ``svg`` or ``pdf``."""
    image = io.BytesIO()
    figure.savefig(image, format=form, metadata=METADATA[f".{form}"], dpi=dpi)
    return image.getvalue()


def missing_characters(figure: Figure) -> str:
    """Return the characters in a figure that no font of the style has: they are drawn as boxes."""
    with _quiet_fonts():
        fonts = [get_font(findfont(name)) for name in _FONTS]
    used = {letter for text in figure.findobj(Text) for letter in text.get_text() if letter != "\n"}
    return "".join(sorted(c for c in used if not any(f.get_char_index(ord(c)) for f in fonts)))


@contextmanager
def _quiet_fonts() -> Iterator[None]:
    """Do not warn of a character that all fonts lack, or of a font without the usual weight."""
    logger = logging.getLogger("matplotlib.font_manager")
    level = logger.level
    logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", r"Glyph .* missing from")
            yield
    finally:
        logger.setLevel(level)


def check_suffix(path: Path) -> None:
    """Raise a ParameterError if the suffix is not ``.png``, ``.svg`` or ``.pdf``."""
    if path.suffix.lower() not in METADATA:
        raise ParameterError(f"{path}: a figure's name ends in .png, .svg or .pdf; rename it")


def wrapped(text: str, width: int) -> str:
    """Return a text in lines of at most `width` characters, ready for a figure; nothing is cut.

    A line across a column has fewer characters if they are wide, such as capital letters.
    """
    # A number and its unit stay together.
    text = re.sub(r"(?<=\d) (?=(?:s|ms|deg|px)\b)", "\xa0", text)
    # A letter of a line that just fits is 0.53 em wide on average.
    most = width * 0.53 if width in {TITLE_WIDTH, LEGEND_WIDTH} else np.inf
    while True:
        wrapper = textwrap.TextWrapper(width)
        wrapper.wordsep_re = _BREAKS
        parts = map(wrapper.wrap, text.splitlines())
        lines = [escaped(line.replace("\xa0", " ")) for part in parts for line in part]
        if width <= 8 or max(map(width_em, lines), default=0) <= most:
            break
        width -= 1
    return plain("\n".join(lines))


def plain(text: str) -> str:
    """Return a text for a figure; matplotlib would read a formula between two dollar signs."""
    return re.sub(r"(?<!\\)\$", r"\\$", text)


@cache
def width_em(line: str) -> float:
    """Return the width of a line in the font of the figures, over the size of the font."""
    font = FontProperties(family=_FONTS, size=100)
    with _quiet_fonts():
        return float(text_to_path.get_text_width_height_descent(line, font, ismath=False)[0]) / 100


def short_number(value: float) -> str:
    """Return a number in three digits; from 1,000 on in all digits, without an exponent."""
    return f"{value:,.0f}" if abs(value) >= 999.5 else f"{value:.3g}"


def escaped(text: str) -> str:
    """Return a text whose control characters, other than line breaks, are escaped."""
    return "\n".join(printable(line) for line in text.split("\n"))
