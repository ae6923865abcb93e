"""The columns of ``frames.csv``, defined once for the writer, the reader and the docs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

MODELS = ("opplod", "dlgmd")


@dataclass(frozen=True)
class Column:
    """One column.

    Attributes
    ----------
    name : str
        As in the header.
    unit : str
        Unit of its values.
    meaning : str
        One line for the user.
    """

    name: str
    unit: str
    meaning: str


COMMON = (
    Column("frame", "", "decode ordinal of the frame in the whole input, from 0"),
    Column("time_s", "s", "presentation time minus that of frame 0"),
    Column(
        "luma_change",
        "0 to 1",
        "mean over the frame of P, the absolute luminance change; empty for the first frame",
    ),
)
OF_MODEL = {
    "opplod": (
        Column("opplod_response", "", "enhanced response of OppLoD; empty during warm-up"),
        Column("opplod_alarm", "0 or 1", "whether OppLoD's alarm is on; empty during warm-up"),
        Column("opplod_x", "source px", "left edge of the winning unit's receptive field"),
        Column("opplod_y", "source px", "top edge of the winning unit's receptive field"),
        Column("opplod_width", "source px", "width of the winning unit's receptive field"),
        Column("opplod_height", "source px", "height of the winning unit's receptive field"),
    ),
    "dlgmd": (
        Column("dlgmd_response", "0 to 1", "mean over the frame of G, the grouped map of D-LGMD"),
        Column("dlgmd_alarm", "0 or 1", "whether D-LGMD's alarm is on; empty during warm-up"),
        Column("dlgmd_s", "", "mean over the frame of S, the presynaptic sum of D-LGMD"),
    ),
}
RMO = (
    Column("flow_vectors", "", "motion vectors kept; these columns are empty for the first frame"),
    Column("rom_pairs", "", "pairs of vectors that are opposite and point outward"),
    Column("rom_share", "0 to 1", "their share of all pairs"),
    Column("rmo_mean", "0 to 1", "mean radial motion opponency over these pairs"),
    Column("rmo_max", "0 to 1", "largest radial motion opponency"),
    Column(
        "rmo_index",
        "-1 to 1",
        "outward minus inward opponency over that of all opposite pairs: 1 for expansion, "
        "-1 for contraction, 0 for translation, rotation and noise",
    ),
)


def columns_for(models: Sequence[str], *, rmo: bool) -> tuple[Column, ...]:
    """Return the columns of a result, in their order.

    Parameters
    ----------
    models : sequence of str
        Names of the models that were run.
    rmo : bool
        Whether radial motion opponency was measured.

    Returns
    -------
    tuple of Column
        ``frame``, ``time_s`` and ``luma_change``, then each model's, then those
        of RMO.
    """
    of_models = tuple(column for model in models for column in OF_MODEL[model])
    return COMMON + of_models + (RMO if rmo else ())
