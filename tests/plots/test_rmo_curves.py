from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from oppload_cli.errors import ResultError
from oppload_cli.models.registry import detector_named
from oppload_cli.plots.rmo_curves import plot_rmo
from oppload_cli.results.result_files import read_result
from tests.results.make import frame_rows, write_result, write_rows

if TYPE_CHECKING:
    from pathlib import Path


def test_rmo_over_time(tmp_path: Path) -> None:
    result = read_result(write_result(tmp_path / "a.frames.csv"))
    figure, panels = plot_rmo([result, result], labels=["one", "two"], title="two results")
    (title,) = (text for text in figure.texts if text.get_text() == "two results")
    assert (title.get_horizontalalignment(), title.get_fontsize()) == ("left", 8)
    assert [len(panel.lines) for panel in panels] == [2, 2, 1] * 2
    assert panels[0].get_ylim() == pytest.approx((-1.08, 1.08))
    _, (index, size, share) = plot_rmo(result, labels=["a name"], xlim=(0.5, 1))
    assert (index.get_title("left"), share.get_xlim()) == ("a name", (0.5, 1))
    assert set(np.asarray(index.lines[1].get_ydata())[1:]) == {0.5}
    assert [line.get_label() for line in size.lines] == ["mean of ROM pairs", "max of ROM pairs"]
    assert [set(np.asarray(line.get_ydata())[1:]) for line in size.lines] == [{0.8}, {0.9}]
    assert set(np.asarray(share.lines[0].get_ydata())[1:]) == {10}
    assert share.get_ylabel() == "ROM pairs (%)"
    drawn = {str(line.get_color()) for line in (index.lines[1], *size.lines, *share.lines)}
    assert not drawn & {detector_named(name).colour for name in ("opplod", "dlgmd")}


def test_without_rmo_the_column_is_named(tmp_path: Path) -> None:
    rows = [
        {name: cell for name, cell in row.items() if not name.startswith("rmo_")}
        for row in frame_rows()
    ]
    result = read_result(write_rows(tmp_path / "a.frames.csv", rows))
    with pytest.raises(ResultError, match=r"no column 'rmo_mean'.*without --no-rmo"):
        plot_rmo([result])
