"""The look of every figure, and how it is saved: the same result gives the same bytes."""

from __future__ import annotations

import io
import warnings
from collections.abc import Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, TypeVar

import matplotlib as mpl
import numpy as np
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure

from oppload_cli import palette
from oppload_cli.errors import ParameterError
from oppload_cli.files.atomic import write_atomic

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from numpy.typing import NDArray

T = TypeVar("T")

INK, FAINT = palette.INK, palette.FAINT
CYCLE = ("#D55E00", "#0072B2", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
DASHES = ("-", (0, (5, 1.5)), (0, (1.5, 1.2)), (0, (6, 1.5, 1.5, 1.5)))
SHADES = "cividis"
LPLC2 = "#000000"
COLUMN = 8.5 / 2.54  # inches: the width of a journal's column
PAGE = 17.8 / 2.54  # inches: two columns
MOST_HEIGHT = 23 / 2.54  # inches: that of a page
TITLE_WIDTH, LEGEND_WIDTH = 48, 50  # characters in a line above a column
DECADES = 4  # of a logarithmic heat map
_STYLE: Any = {  # Any: the stubs list every key that matplotlib has
    "font.family": "DejaVu Sans",
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
    "svg.hashsalt": "oppload",
    "svg.fonttype": "path",
    "pdf.fonttype": 42,
}
# By format. Without these a file would hold the time at which it was made.
METADATA: dict[str, dict[str, Any]] = {
    ".png": {"Software": "oppload"},
    ".svg": {"Date": None, "Creator": "oppload"},
    ".pdf": {"CreationDate": None, "ModDate": None, "Creator": "oppload", "Producer": "oppload"},
}


@contextmanager
def styled_figure(width: float, height: float) -> Iterator[Figure]:
    """Open an empty figure to draw on, with the style in effect.

    Parameters
    ----------
    width, height : float
        In inches.

    Yields
    ------
    matplotlib.figure.Figure
        It needs no display.
    """
    with mpl.rc_context(_STYLE):
        yield Figure(figsize=(width, height), layout="constrained")


def as_list(results: T | Sequence[T]) -> list[T]:
    """Return one result, or some, as a list."""
    return list(results) if isinstance(results, Sequence) else [results]


def norm_of(values: NDArray[np.float64], bounds: tuple[float, float] | None = None) -> Normalize:
    """Return the scale of a heat map: logarithmic where the values are of several decades.

    Parameters
    ----------
    values : ndarray
        At least 0; NaN is blank.
    bounds : tuple of float, optional
        Of a logarithmic scale; else it ends at the largest value, and begins at the smallest,
        but not more than four decades below.
    """
    if bounds:
        return LogNorm(*bounds, clip=True)
    above = values[np.isfinite(values) & (values > 0)]
    largest = float(above.max(initial=0)) or 1.0
    smallest = max(float(above.min(initial=largest)), largest * 10.0**-DECADES)
    if largest > 30 * smallest:
        return LogNorm(smallest, largest, clip=True)
    return Normalize(0, largest)


def save(figure: Figure, path: Path) -> None:
    """Save a figure; the suffix chooses the format.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        The figure.
    path : Path
        Ends in ``.png``, ``.svg`` or ``.pdf``.

    Raises
    ------
    ParameterError
        If the suffix is none of these.
    OutputError
        If the file cannot be written.
    """
    check_suffix(path)
    write_atomic(path, [_image(figure, path.suffix.lower())])


def png_bytes(figure: Figure, dpi: int) -> bytes:
    """Return a figure as PNG with a number of pixels per inch."""
    return _image(figure, ".png", dpi=dpi)


def _image(figure: Figure, suffix: str, **options: Any) -> bytes:
    image = io.BytesIO()
    with mpl.rc_context(_STYLE), warnings.catch_warnings():
        warnings.filterwarnings("ignore", r"Glyph .* missing from")  # a box is drawn for it
        figure.savefig(image, format=suffix[1:], metadata=METADATA[suffix], **options)
    return image.getvalue()


def check_suffix(path: Path) -> None:
    """Check that a figure can be saved under a name.

    Raises
    ------
    ParameterError
        If the suffix is not ``.png``, ``.svg`` or ``.pdf``.
    """
    if path.suffix.lower() not in METADATA:
        raise ParameterError(f"{path}: a figure's name ends in .png, .svg or .pdf; rename it")
