"""How every figure looks, and how it is saved: the same result gives the same bytes."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
from matplotlib.figure import Figure

from oppload_cli import palette
from oppload_cli.errors import ParameterError
from oppload_cli.results.table import cannot_write

if TYPE_CHECKING:
    from pathlib import Path

COLOURS, NAMES, INK, FAINT = palette.COLOURS, palette.NAMES, palette.INK, palette.FAINT
UNITS = {"opplod": "arbitrary unit", "dlgmd": "mean of G"}
CYCLE = ("#D55E00", "#0072B2", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
DASHES = ("-", (0, (5, 1.5)), (0, (1.5, 1.2)), (0, (6, 1.5, 1.5, 1.5)))
SHADES = "cividis"
LPLC2 = "#000000"
# The width of a column of a journal: 8.5 cm. What is drawn wider is not shrunk to it.
COLUMN = 8.5 / 2.54
STYLE: Any = {  # Any: the stubs list every key there is
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
PARAMETER_UNITS = {
    "_deg_s": "deg/s",
    "_deg": "deg",
    "_ms": "ms",
    "_hz": "Hz",
    "_per_s": "1/s",
    "_s": "s",
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


def png_bytes(figure: Figure, dpi: int) -> bytes:
    """Return a figure as PNG; the same figure gives the same bytes.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        The figure.
    dpi : int
        Pixels per inch.

    Returns
    -------
    bytes
    """
    buffer = io.BytesIO()
    with mpl.rc_context(STYLE):
        figure.savefig(buffer, format="png", dpi=dpi, metadata=METADATA[".png"])
    return buffer.getvalue()


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


def described(parameter: str) -> str:
    """Return the label of an axis over a swept parameter, with its unit.

    Parameters
    ----------
    parameter : str
        A dotted key such as ``disk.growth.speed_deg_s``.

    Returns
    -------
    str
        E.g. ``speed (deg/s)``.
    """
    *_, owner, leaf = ("", *parameter.split("."))
    if leaf in {"right", "up"}:  # of a place, which is in degrees
        return f"{leaf} (deg)"
    if leaf == "l_over_v_ms":
        return "l/v (ms)"
    for suffix, unit in PARAMETER_UNITS.items():
        if leaf.endswith(suffix):
            return f"{leaf.removesuffix(suffix).replace('_', ' ')} ({unit})"
    return f"{owner} {leaf}".replace("_", " ").strip()


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
