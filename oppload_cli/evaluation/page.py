"""``evaluation.html``: the evaluation as one page that needs no other file."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

from oppload_cli.evaluation.detectors import label_of
from oppload_cli.evaluation.plots import PLOTS
from oppload_cli.evaluation.stills import HEIGHT, RATE, WIDTH, Strip, strip, winner_of
from oppload_cli.files.html import embedded, rendered

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from oppload_cli.evaluation.evaluate import Evaluation
    from oppload_cli.evaluation.metrics.clips import Box, Clip
    from oppload_cli.evaluation.stills import Moment

    Pictures = Mapping[tuple[int, int], bytes]  # JPEG by clip and frame


class _Definition(NamedTuple):
    """A measure.

    Attributes
    ----------
    title, unit : str
        For the reader; the unit is empty for a share.
    text : str
        How it is measured, in plain words.
    """

    title: str
    unit: str
    text: str


CONDITIONS = {
    "at 0.5, 1, 2 per minute": "The alarm is one fixed threshold on the response: the lowest that, "
    "like every higher one, gives no more false alarms per minute than that over all footage "
    "without an approach. It is chosen on the same clips, so it flatters; in each draw of the "
    "bootstrap it is chosen again.",
    "held out at 0.5, 1, 2 per minute": "The threshold for each clip is chosen on all "
    "other clips (leave one out): the figures to expect on a new clip.",
    "alarm as shipped": "The detector's own causal alarm, as `oppload run` has it; nothing is "
    "chosen on these clips.",
}
MEASURES = {
    "detection_rate": _Definition(
        "detection rate",
        "",
        "Share of the approaches with a response above the threshold, or the alarm on, at some "
        "frame from onset to contact, both included. n: approaches.",
    ),
    "lead_time_s": _Definition(
        "lead time",
        "s",
        "Time from the first such frame to contact, median over the detected approaches. Compare "
        "it only at similar detection rates: a detector that finds only the easy ones is early. "
        "n: detected approaches.",
    ),
    "false_alarms_per_minute": _Definition(
        "false alarms per minute",
        "1/min",
        "Upward crossings of the threshold, or beginnings of the alarm, in footage without an "
        "approach: clips labelled none, and the others before their onset, clear of warm-up. "
        "A crossing without a second of silence before it belongs to the same false alarm. By kind "
        "of motion, as the manifest names it. n: clips with such footage.",
    ),
    "threshold": _Definition(
        "threshold",
        "response",
        "A response above it is an alarm; in the detector's own unit. n: clips with footage "
        "without an approach.",
    ),
    "roc_auc": _Definition(
        "area under the ROC curve",
        "",
        "Over one-second windows, scored by their largest response. Positive: the last second "
        "before contact. Negative: windows that tile the footage without an approach. Half a "
        "second is enough for a window; ties count half. n: windows.",
    ),
    "average_precision": _Definition(
        "average precision",
        "",
        "Precision averaged over the steps of recall, over the same windows; it depends on the "
        "share of positive windows. n: windows.",
    ),
    "ordered_pairs": _Definition(
        "ordered pairs within clips",
        "",
        "The one-second window that ends some frames before contact is set against each earlier "
        "window of the same clip, tiled back from its start. Share of pairs in which its largest "
        "response is the larger; ties count half; mean over clips. Chance is 0.5. n: pairs.",
    ),
    "distinct_ratio": _Definition(
        "distinct ratio",
        "",
        "Largest response from onset to contact over the largest before onset; over the median of "
        "the clips labelled none if less than half a second comes before. Median over clips. The "
        "responses have different scales (OppLoD's is squared by its enhancing), so that the "
        "ratio compares clips and settings rather than detectors. n: approaches.",
    ),
    "place_inside": _Definition(
        "winning unit inside the box",
        "",
        "Share of the boxed frames in which the centre of the winning unit's field lies in the "
        "labelled box, made 1.5 times as large about its centre; without a winner it does not. "
        "'frame_centre' always points at the middle of the frame. n: frames.",
    ),
    "place_distance_px": _Definition(
        "distance to the box's centre",
        "source px",
        "From the centre of the winning unit's field to that of the labelled box, median over the "
        "boxed frames with a winner. n: these frames.",
    ),
    "place_distance_diagonals": _Definition(
        "distance to the box's centre",
        "box diagonals",
        "The same over the diagonal of the box.",
    ),
    "alarmed_share": _Definition(
        "clips with a false alarm",
        "",
        "Share of the clips without an approach that have at least one alarm, by kind; clips of "
        "stimuli only. n: clips.",
    ),
    "box_overlap": _Definition(
        "overlap of the boxes",
        "",
        "Intersection over union of the box of the strongest looming object and the true box "
        "within the frame, 5 frames before contact; 0 without an object. Median over the "
        "approaches; clips of stimuli only. n: approaches with a true box there.",
    ),
    "contact_within": _Definition(
        "time to contact within 20 %",
        "",
        "Share of the approaches whose times to contact in the last half second have a median "
        "error of at most 20 %; an approach for which none is given counts as an error. n: "
        "approaches.",
    ),
    "contact_error": _Definition(
        "error of the time to contact",
        "",
        "Median over the frames of the last half second with a time to contact, of its error over "
        "the true time; median over the approaches with such frames. n: these approaches.",
    ),
}
INTERVALS = (
    "The clips are drawn with replacement, as many with and without an approach as there are "
    "(`--draws`, 1000 by default, from a fixed seed); 95 % of the draws give a value in the "
    "interval. It says how far a figure depends on the choice of clips of these kinds, and nothing "
    "about other kinds. Where there was no false alarm in T minutes, the upper bound is 3 / T "
    "(the rule of three): a detector with more would have had one with a chance of 95 %."
)


NOTHING = "\N{EN DASH}"
HEADLINE = (
    ("detected", "detection_rate", "at 1 per minute"),
    ("lead (s)", "lead_time_s", "at 1 per minute"),
    ("detected, held out", "detection_rate", "held out at 1 per minute"),
    ("alarm as shipped: detected", "detection_rate", "alarm as shipped"),
    ("its false alarms per minute", "false_alarms_per_minute", "alarm as shipped"),
    ("ROC area", "roc_auc", "last second before contact"),
    ("ordered pairs, 4 frames ahead", "ordered_pairs", "4 frames before contact"),
    ("inside the box", "place_inside", "within 15 frames of contact"),
)


def page_of(
    evaluation: Evaluation,
    report: Mapping[str, Any],
    plots: Mapping[str, bytes],
    moments: Sequence[Moment],
    pictures: Pictures,
) -> str:
    """Return the page as HTML, with every picture in it.

    Parameters
    ----------
    evaluation : Evaluation
        Of all clips.
    report : mapping
        From :func:`oppload_cli.evaluation.output.report_of`.
    plots : mapping of str to bytes
        PNG by file name.
    moments : sequence of Moment
        The worst ones.
    pictures : mapping
        JPEG by clip and frame.
    """
    minutes = report["manifest"]["minutes_without_approach"]
    return rendered(
        "evaluation.html",
        report=report,
        plots=[(embedded(plots[name]), plot.caption) for name, plot in PLOTS.items()],
        stills=list(_stills(evaluation, moments, pictures)),
        headline=HEADLINE,
        allowed=int(RATE * minutes),
        quiet=_duration(minutes),
        figures=_by_measure(report["figures"]),
        measured=list(dict.fromkeys(figure["contender"] for figure in report["figures"])),
        parameters=_parameters,
        conditions=CONDITIONS,
        measures=MEASURES,
        intervals=INTERVALS,
        label_of=label_of,
        number=number,
        nothing=NOTHING,
        strip_size=(WIDTH, HEIGHT),
    )


def number(value: float | None) -> str:
    """Return a number as the page shows it: two significant digits below 1, three above.

    None and NaN become a dash.
    """
    if value is None or math.isnan(value):
        return NOTHING
    if math.isinf(value):
        return "∞"
    if abs(value) >= 99.95:
        return f"{value:.0f}"
    return f"{value:.3g}" if abs(value) >= 0.995 else f"{value:.2g}"


def _duration(minutes: float) -> str:
    """Return a duration with its unit: seconds if it is short."""
    return f"{number(minutes)} minutes" if minutes >= 1.5 else f"{number(60 * minutes)} s"


class _Still(NamedTuple):
    """A moment as the page shows it.

    Attributes
    ----------
    clip : Clip
        The clip.
    frame : int
        The frame.
    picture : str or None
        Its address; None for a frame that could not be decoded again.
    label, winner : tuple of float, or None
        The labelled box, and the field of the winning unit, in source pixels.
    strip : Strip
        The responses over the clip.
    time : str
        Time before contact, or the kind of motion.
    response : str
        In thresholds, if the threshold is known.
    """

    clip: Clip
    frame: int
    picture: str | None
    label: Box | None
    winner: tuple[float, ...] | None
    strip: Strip
    time: str
    response: str


def _stills(
    evaluation: Evaluation, moments: Sequence[Moment], pictures: Pictures
) -> Iterator[tuple[str, list[_Still]]]:
    """Yield the stills by title."""
    titles = {True: "Worst misses", False: "Largest responses without an approach"}
    for detector in dict.fromkeys(each.detector for each in moments):
        for missed, title in titles.items():
            stills = [
                _still(evaluation.clips[each.clip], each, pictures.get((each.clip, each.frame)))
                for each in moments
                if each.detector == detector and each.missed == missed
            ]
            if stills:
                yield f"{title}: {label_of(detector)}", stills


def _still(clip: Clip, moment: Moment, picture: bytes | None) -> _Still:
    response = float(clip.outputs[moment.detector].response[moment.frame])
    over = response / moment.threshold if moment.threshold > 0 else math.nan
    lead = f"{number(clip.lead(moment.frame))} s before contact"
    return _Still(
        clip,
        moment.frame,
        None if picture is None else embedded(picture, "jpeg"),
        clip.label.boxes.get(moment.frame),
        winner_of(clip, moment),
        strip(clip, moment),
        lead if moment.missed else clip.label.kind,
        number(response) if math.isnan(over) else f"{number(over)} times the threshold",
    )


def _by_measure(
    figures: Sequence[Mapping[str, Any]],
) -> dict[str, dict[str, dict[str, Mapping[str, Any]]]]:
    """Return the figures by measure, condition and detector, in the order of the definitions."""
    table: dict[str, dict[str, dict[str, Mapping[str, Any]]]] = {name: {} for name in MEASURES}
    for figure in figures:
        of_condition = table[figure["measure"]].setdefault(figure["condition"], {})
        of_condition[figure["contender"]] = figure
    return table


def _parameters(detector: Mapping[str, Any]) -> dict[str, Any]:
    """Return the parameters of one of the report's detectors, with those of its alarm."""
    alarm = {f"alarm.{name}": value for name, value in (detector["alarm"] or {}).items()}
    return {"working height": detector["height"], **(detector["parameters"] or {}), **alarm}
