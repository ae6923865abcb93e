"""How each measure is defined: for the page of an evaluation, and for the documentation."""

from __future__ import annotations

from typing import NamedTuple

from oppload_cli.evaluation.contenders import DLGMD, FLOW, MEAN_P, PREFIX


class Definition(NamedTuple):
    """A measure.

    Attributes
    ----------
    title, unit : str
        What the reader sees; the unit is empty for a share.
    text : str
        How it is measured, in plain words.
    """

    title: str
    unit: str
    text: str


CONDITIONS = {
    "at 0.5, 1, 2 per minute": "The alarm is one fixed threshold on the response, the lowest at "
    "which, and above which, there are no more false alarms per minute than that over all footage "
    "without an approach. It is chosen on the same clips, so it flatters; in each draw of the "
    "bootstrap it is chosen again.",
    "held out at 0.5, 1, 2 per minute": "The threshold for each clip is chosen on all "
    "other clips (leave one out): what to expect on a new clip.",
    "alarm as shipped": "The model's own causal alarm, as `oppload run` has it; nothing is chosen "
    "on these clips.",
}
MEASURES = {
    "detection_rate": Definition(
        "detection rate",
        "",
        "Share of the approaches with a response above the threshold, or the alarm on, at some "
        "frame from onset to contact, both included. n: approaches.",
    ),
    "lead_time_s": Definition(
        "lead time",
        "s",
        "Time from the first such frame to contact, median over the detected approaches. Compare "
        "it only at like detection rates: who detects only the easy ones has them early. "
        "n: detected approaches.",
    ),
    "false_alarms_per_minute": Definition(
        "false alarms per minute",
        "1/min",
        "Upward crossings of the threshold, or beginnings of the alarm, in footage without an "
        "approach: clips labelled none, and the others before their onset, clear of warm-up. "
        "What follows without a second of silence is the same one. By kind of motion, as the "
        "manifest names it. "
        "n: clips with such footage.",
    ),
    "threshold": Definition(
        "threshold",
        "response",
        "What a response must be above, in the contender's own unit. n: clips with footage "
        "without an approach.",
    ),
    "roc_auc": Definition(
        "area under the ROC curve",
        "",
        "Over one-second windows, scored by their largest response. Positive: the last second "
        "before contact. Negative: windows that tile the footage without an approach. Half a "
        "second is enough for a window; ties count half. n: windows.",
    ),
    "average_precision": Definition(
        "average precision",
        "",
        "Precision averaged over the steps of recall, over the same windows; it depends on the "
        "share of positive windows. n: windows.",
    ),
    "ordered_pairs": Definition(
        "ordered pairs within clips",
        "",
        "The one-second window that ends some frames before contact is set against each earlier "
        "window of the same clip, tiled back from its start. Share of pairs in which its largest "
        "response is the larger; ties count half; mean over clips. Chance is 0.5. n: pairs.",
    ),
    "distinct_ratio": Definition(
        "distinct ratio",
        "",
        "Largest response from onset to contact over the largest before onset; over the median of "
        "the clips labelled none where under half a second comes before. Median over clips. The "
        "responses have different scales (OppLoD's is squared by its enhancing), so that the "
        "ratio compares clips and settings rather than contenders. n: approaches.",
    ),
    "place_inside": Definition(
        "winning unit inside the box",
        "",
        "Share of the boxed frames in which the centre of the winning unit's field lies in the "
        "labelled box, made 1.5 times as large about its centre; without a winner it does not. "
        "'frame_centre' always points at the middle of the frame. n: frames.",
    ),
    "place_distance_px": Definition(
        "distance to the box's centre",
        "source px",
        "From the centre of the winning unit's field to that of the labelled box, median over the "
        "boxed frames with a winner. n: these frames.",
    ),
    "place_distance_diagonals": Definition(
        "distance to the box's centre",
        "box diagonals",
        "The same over the diagonal of the box.",
    ),
}
INTERVALS = (
    "The clips are drawn with replacement, as many with and without an approach as there are "
    "(`--draws`, 1000 by default, from a fixed seed); 95 % of the draws give a value in the "
    "interval. It says how far a figure depends on which clips of these kinds there happen to be, "
    "and nothing of other kinds of clips."
)
NAMES = {
    DLGMD: "D-LGMD",
    FLOW: "flow divergence",
    MEAN_P: "mean of P",
    "frame_centre": "frame centre",
}


def displayed(contender: str) -> str:
    """Return what a reader sees for a contender.

    Parameters
    ----------
    contender : str
        Its name.

    Returns
    -------
    str
        E.g. ``OppLoD default``.
    """
    if contender.startswith(PREFIX):
        return f"OppLoD {contender.removeprefix(PREFIX)}"
    return NAMES.get(contender, contender)
