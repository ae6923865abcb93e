"""Tuning over two parameters, as heat maps."""

from __future__ import annotations

from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np

from oppload_cli.errors import ResultError
from oppload_cli.plots.style import COLUMN, NAMES, SHADES, STYLE, UNITS, described, new_figure

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.image import AxesImage

    from oppload_cli.results.tuning import Tuning


def plot_heat(tuning: Tuning, models: Sequence[str] = ()) -> Figure:
    """Draw the peak response over two swept parameters, a map per model.

    Parameters
    ----------
    tuning : Tuning
        A table over two parameters, or over places.
    models : sequence of str
        The models to draw; none for all.

    Returns
    -------
    matplotlib.figure.Figure
        Every cell is a condition, with its peak over the largest one; a combination
        that was not shown is blank.

    Raises
    ------
    ResultError
        If there are not two parameters.
    """
    if len(tuning.parameters) != 2:
        raise ResultError(
            f"{tuning.path}: column{'s' * (len(tuning.parameters) > 1)} "
            f"{', '.join(tuning.parameters)} swept; a heat map needs two parameters"
        )
    names = [name for name in tuning.models if name in (models or tuning.models)]
    if not names:
        raise ResultError(f"{tuning.path}: column 'model' never holds '{models[0]}'; leave it out")
    rows = tuning.rows[tuning.parameters[1]].nunique()
    with mpl.rc_context(STYLE):
        figure = new_figure(COLUMN, 0.2 + len(names) * (0.75 + min(2.4, max(0.9, 0.28 * rows))))
        axes = figure.subplots(len(names), 1, squeeze=False)[:, 0]
        for panel, model in zip(axes, names, strict=True):
            image = _draw_map(panel, tuning, model)
            bar = figure.colorbar(image, ax=panel, pad=0.02)
            bar.set_label("peak / largest peak")
            bar.outline.set_linewidth(0.5)
    return figure


def _draw_map(axes: Axes, tuning: Tuning, model: str) -> AxesImage:
    across, up = tuning.parameters
    cells = tuning.of(model).pivot_table(index=up, columns=across, values="peak")
    values = cells.to_numpy(float)
    largest = float(np.nanmax(values))
    share = values / largest if largest > 0 else values
    image = axes.imshow(share, origin="lower", aspect="auto", cmap=SHADES, vmin=0, vmax=1)
    axes.set_xticks(range(share.shape[1]), [_number(value) for value in cells.columns])
    axes.set_yticks(range(share.shape[0]), [_number(value) for value in cells.index])
    if share.size <= 100:
        for (row, column), value in np.ndenumerate(share):
            if np.isfinite(value):
                ink = "black" if value > 0.55 else "white"
                axes.text(column, row, f"{value:.2g}", ha="center", va="center", color=ink, size=6)
    axes.set_xlabel(described(across))
    axes.set_ylabel(described(up))
    axes.set_title(f"{NAMES[model]}, largest peak {largest:.3g} ({UNITS[model]})")
    return image


def _number(value: object) -> str:
    return f"{value:g}" if isinstance(value, int | float) else str(value)
