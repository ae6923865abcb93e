"""How every figure looks, and how it is saved: the same result gives the same bytes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import matplotlib as mpl
from matplotlib.figure import Figure

from oppload_cli.errors import ParameterError
from oppload_cli.results.table import cannot_write

if TYPE_CHECKING:
    from pathlib import Path

# Okabe and Ito's palette: told apart by the colour-blind, and in grey by their lightness.
COLOURS = {"opplod": "#D55E00", "dlgmd": "#0072B2"}
NAMES = {"opplod": "OppLoD", "dlgmd": "D-LGMD"}
INK, FAINT = "#222222", "#999999"
STYLE: Any = {  # Any: the stubs list every key there is
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlesize": 10,
    "axes.titlelocation": "left",
    "axes.edgecolor": INK,
    "axes.linewidth": 0.8,
    "lines.linewidth": 1.4,
    "legend.frameon": False,
    "savefig.dpi": 150,
    "svg.hashsalt": "oppload",
    "svg.fonttype": "path",
    "pdf.fonttype": 42,
}
# Without these a file would carry the time at which it was made.
METADATA: dict[str, dict[str, Any]] = {
    ".png": {"Software": "oppload"},
    ".svg": {"Date": None, "Creator": "oppload"},
    ".pdf": {"CreationDate": None, "ModDate": None, "Creator": "oppload", "Producer": "oppload"},
}


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
        If it cannot be written.
    """
    suffix = path.suffix.lower()
    check_suffix(path)
    part = path.with_name(path.name + ".part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with mpl.rc_context(STYLE):
            figure.savefig(part, format=suffix[1:], metadata=METADATA[suffix])
        part.replace(path)
    except OSError as error:
        part.unlink(missing_ok=True)
        raise cannot_write(path, error) from error


def check_suffix(path: Path) -> None:
    """Check that a figure can be saved under a name.

    Parameters
    ----------
    path : Path
        The name.

    Raises
    ------
    ParameterError
        If its suffix is not ``.png``, ``.svg`` or ``.pdf``.
    """
    if path.suffix.lower() not in METADATA:
        raise ParameterError(f"{path}: a figure's name ends in .png, .svg or .pdf; rename it")


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure in the house's style; it needs no display.

    Parameters
    ----------
    width, height : float
        In inches.

    Returns
    -------
    matplotlib.figure.Figure
    """
    return Figure(figsize=(width, height), layout="constrained")
