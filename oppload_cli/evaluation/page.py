"""``evaluation.html``: the evaluation as one page that needs no other file.

It shows the measures, the plots, and the frames of the worst misses and false alarms.
"""

from __future__ import annotations

import math
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import cv2
import numpy as np

from oppload_cli.errors import SourceError
from oppload_cli.evaluation.detectors import label_of
from oppload_cli.evaluation.metrics.alarms import AT_ONE
from oppload_cli.evaluation.plots import PLOTS
from oppload_cli.files.html import embedded, rendered
from oppload_cli.stimulus.renderer import Renderer
from oppload_cli.video.inputs import Position, Span
from oppload_cli.video.source import open_video

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from cv2.typing import MatLike

    from oppload_cli.evaluation.evaluate import Evaluation
    from oppload_cli.evaluation.metrics.clips import Box, Clip
    from oppload_cli.stimulus.protocol import Protocol


_MOST = 4  # stills of each kind, for each detector
_PICTURE_HEIGHT = 270  # px, of a still
_QUALITY = 82  # of a still as JPEG
WIDTH, HEIGHT = 300, 56  # of the strip below a still, in units of its drawing
_HIGHEST = 3.0  # times the threshold at the top of a strip


class _Definition(NamedTuple):
    """A measure for the reader: its unit is empty for a share, its text says how it is measured."""

    title: str
    unit: str
    text: str


CONDITIONS = {
    "at 0.5, 1, 2 per minute": "The alarm is one fixed threshold on its evidence (the response; "
    "within `contact_s` of contact the response over `contact_share`): the lowest that, like every "
    "higher one, gives at most this number of false alarms per minute over all footage without "
    "an approach. It is chosen on the clips on which it is judged, so that its results are better "
    "than on new clips; in each draw of the bootstrap it is chosen again.",
    "held out at 0.5, 1, 2 per minute": "The threshold for each clip is chosen on all "
    "clips of other videos (leave one out): the figures to expect on a new video.",
    "alarm as shipped": "The detector's own causal alarm, as `oppload run` has it; nothing is "
    "chosen on these clips.",
}
MEASURES = {
    "detection_rate": _Definition(
        "detection rate",
        "",
        "Share of the approaches with evidence above the threshold, or the alarm on, at some "
        "frame from onset to contact, both included. n: approaches.",
    ),
    "lead_time_s": _Definition(
        "lead time",
        "s",
        "Time from the first such frame to contact, median over the detected approaches. Compare "
        "it only at similar detection rates: a detector that finds only the easy approaches finds "
        "them early. n: detected approaches.",
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
        "Evidence above it is an alarm; in the detector's own unit. n: clips with footage "
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
        "The one-second window that ends some frames before contact is compared with each earlier "
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
        "labelled box, made 1.5 times as large about its centre; a frame without a winner counts "
        "as outside. "
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
        "Distance from the centre of the winning unit to that of the box, over the diagonal of the "
        "box.",
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
        "Error of the time to contact over the true time: median over those frames of the last "
        "half second that have one, then median over the approaches with such frames. n: these "
        "approaches.",
    ),
}
INTERVALS = (
    "The clips are drawn with replacement, as many with and without an approach as there are "
    "(`--draws`, 1000 by default, from a fixed seed), and several approaches in one video "
    "together; 95 % of the draws give a value in the interval. It says how far a figure depends on "
    "the choice of clips of these kinds, and nothing "
    "about other kinds. Where the draws do not differ, as of clips that all agree, the interval is "
    "the exact one: that of Clopper and Pearson for shares, and that of a Poisson process for "
    "rates; without a false alarm in T minutes the upper bound is 3 / T (the rule of three): a "
    "detector with a higher rate would have had one with a chance of 95 %."
)


NOTHING = "\N{EN DASH}"
_HEADLINE = (
    ("detected", "detection_rate", "at 1 per minute"),
    ("lead (s)", "lead_time_s", "at 1 per minute"),
    ("detected, held out", "detection_rate", "held out at 1 per minute"),
    ("its false alarms per minute", "false_alarms_per_minute", "held out at 1 per minute"),
    ("alarm as shipped: detected", "detection_rate", "alarm as shipped"),
    ("its false alarms per minute", "false_alarms_per_minute", "alarm as shipped"),
    ("ROC area", "roc_auc", "last second before contact"),
    ("ordered pairs, 4 frames ahead", "ordered_pairs", "4 frames before contact"),
    ("inside the box", "place_inside", "within 15 frames of contact"),
)


def page_of(evaluation: Evaluation, report: Mapping[str, Any], plots: Mapping[str, bytes]) -> str:
    """Return the page as HTML, with every picture in it.

    Parameters
    ----------
    evaluation : Evaluation
        Of all clips; their files are read again for the pictures of the worst moments.
    report : mapping
        The content of ``report.json``.
    plots : mapping of str to bytes
        PNG by file name.
    """
    minutes = report["manifest"]["minutes_without_approach"]
    return rendered(
        "evaluation.html",
        report=report,
        plots=[(embedded(plots[name]), plot.caption) for name, plot in PLOTS.items()],
        stills=list(_stills(evaluation)),
        headline=_HEADLINE,
        allowed=int(minutes),
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
    """Return a number as the page shows it: two significant digits below 1, else at least three.

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

    `picture` is an address, or None for a frame that could not be decoded again; `label` and
    `winner` are the labelled box and the field of the winning unit, in source pixels; `time` is
    the time before contact, or the kind of motion.
    """

    clip: Clip
    frame: int
    picture: str | None
    label: Box | None
    winner: tuple[float, ...] | None
    strip: _Strip
    time: str
    evidence: str


def _stills(evaluation: Evaluation) -> Iterator[tuple[str, list[_Still]]]:
    """Yield the stills by title: of each detector with units, misses first."""
    moments = [
        moment
        for name in evaluation.performances
        if any(clip.outputs[name].winner is not None for clip in evaluation.clips)
        for moment in _worst_of(evaluation, name)
    ]
    pictures = _pictures(evaluation, moments)
    for (detector, missed), group in groupby(
        moments, key=lambda each: (each.detector, each.missed)
    ):
        title = "Worst misses" if missed else "Largest evidence without an approach"
        yield (
            f"{title}: {label_of(detector)}",
            [
                _still(evaluation.clips[each.clip], each, pictures.get((each.clip, each.frame)))
                for each in group
            ],
        )


def _still(clip: Clip, moment: _Moment, picture: bytes | None) -> _Still:
    output = clip.outputs[moment.detector]
    evidence = float(output.evidence[moment.frame])
    over = (
        f"{number(evidence / moment.threshold)} times the threshold" if moment.threshold > 0 else ""
    )
    winner = None if output.winner is None else output.winner[moment.frame]
    lead = f"{number(clip.lead(moment.frame))} s before contact"
    return _Still(
        clip,
        moment.frame,
        None if picture is None else embedded(picture, "jpeg"),
        clip.label.boxes.get(moment.frame),
        None if winner is None or not np.isfinite(winner).all() else tuple(map(float, winner)),
        _strip(clip, moment),
        lead if moment.missed else clip.label.kind,
        over or number(evidence),
    )


def _by_measure(figures: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, dict[str, Any]]]:
    """Return the figures by measure, condition and detector, in the order of the definitions."""
    table: dict[str, dict[str, dict[str, Any]]] = {name: {} for name in MEASURES}
    for figure in figures:
        of_condition = table[figure["measure"]].setdefault(figure["condition"], {})
        of_condition[figure["contender"]] = figure
    return table


def _parameters(detector: Mapping[str, Any]) -> dict[str, Any]:
    """Return the parameters of one of the report's detectors, with those of its alarm."""
    alarm = {f"alarm.{name}": value for name, value in detector["alarm"].items()}
    return {"working height": detector["height"], **detector["parameters"], **alarm}


class _Moment(NamedTuple):
    """A frame worth a picture.

    Attributes
    ----------
    clip : int
        Position of the clip.
    frame : int
        The frame.
    detector : str
        The detector that was wrong.
    threshold : float
        Of that detector at 1 false alarm per minute.
    missed : bool
        Whether it is a miss; else a false alarm, or the nearest to one.
    """

    clip: int
    frame: int
    detector: str
    threshold: float
    missed: bool


def _worst_of(evaluation: Evaluation, name: str) -> Iterator[_Moment]:
    """Yield the worst moments of a detector: at most four misses, then four false alarms.

    A miss is shown at its largest evidence from onset to contact, the smallest of them
    first; a clip's false alarm at its largest evidence without an approach, the
    largest first.
    """
    decision = evaluation.performances[name].decisions[AT_ONE]
    threshold = float(decision.thresholds[0])

    def peak(index: int, start: int, stop: int) -> tuple[float, int, int]:
        evidence = evaluation.clips[index].outputs[name].evidence
        frame = start + int(evidence[start:stop].argmax())
        return float(evidence[frame]), index, frame

    misses = map(int, np.flatnonzero(decision.outcomes.detected == 0))
    missed = sorted(peak(index, *evaluation.clips[index].approach) for index in misses)
    for _, index, frame in missed[:_MOST]:
        yield _Moment(index, frame, name, threshold, missed=True)
    spans = [(index, *clip.quiet) for index, clip in enumerate(evaluation.clips)]
    largest = [peak(index, start, stop) for index, start, stop in spans if start < stop]
    for evidence, index, frame in sorted(largest, key=lambda each: (-each[0], each[1]))[:_MOST]:
        if evidence > 0:
            yield _Moment(index, frame, name, threshold, missed=False)


def _pictures(evaluation: Evaluation, moments: Sequence[_Moment]) -> dict[tuple[int, int], bytes]:
    """Return the frames of moments as JPEG in grey, by clip and frame.

    A frame that cannot be decoded again is left out.
    """
    return {
        (clip, frame): jpeg
        for clip in sorted({each.clip for each in moments})
        for frame, jpeg in _frames(
            evaluation.entries[clip].path, {each.frame for each in moments if each.clip == clip}
        )
    }


def _frames(path: Path | Protocol, wanted: set[int]) -> Iterator[tuple[int, bytes]]:
    if not isinstance(path, Path):
        drawn = Renderer(path)
        yield from ((frame, _jpeg(drawn.grey(frame))) for frame in sorted(wanted))
        return
    span = Span(start=Position(frame=min(wanted)), end=Position(frame=max(wanted) + 1))
    try:
        with open_video(path, height=_PICTURE_HEIGHT, span=span) as video:
            for frame in video:
                if frame.index in wanted:
                    grey = cv2.convertScaleAbs(frame.luma, alpha=255.0)
                    yield frame.index, _jpeg(grey)
    except SourceError:
        return  # it could be read a moment ago: the page stands without the picture


def _jpeg(grey: MatLike) -> bytes:
    _, data = cv2.imencode(".jpg", grey, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    return data.tobytes()


class _Strip(NamedTuple):
    """A detector's evidence over a clip, as a drawing of `WIDTH` x `HEIGHT`.

    `approach` is its left edge and width; `points` and `threshold` are places of the evidence,
    and `now` is that of the frame shown.
    """

    approach: tuple[float, float] | None
    points: list[tuple[float, float]]
    threshold: float | None
    now: float


def _strip(clip: Clip, moment: _Moment) -> _Strip:
    """Draw the evidence over a complete clip, up to three times the threshold.

    Of very many frames, the largest of every few is drawn.
    """
    evidence = np.nan_to_num(clip.outputs[moment.detector].evidence)
    top = float(evidence.max()) or 1.0
    threshold = moment.threshold
    if threshold > 0:
        top = min(max(top, 1.2 * threshold), _HIGHEST * threshold)
    across = WIDTH / len(clip)
    start, stop = clip.approach

    def height(value: float) -> float:
        return HEIGHT - 2 - (HEIGHT - 6) * min(value / top, 1.0)

    step = max(1, math.ceil(len(evidence) / (2 * WIDTH)))
    firsts = range(0, len(evidence), step)
    shown = [first + int(evidence[first : first + step].argmax()) for first in firsts]
    return _Strip(
        (start * across, (stop - start) * across) if stop > start else None,
        [((frame + 0.5) * across, height(float(evidence[frame]))) for frame in shown],
        None if math.isnan(threshold) else height(threshold),
        (moment.frame + 0.5) * across,
    )
