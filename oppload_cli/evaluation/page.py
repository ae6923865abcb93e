"""``evaluation.html``: one page with all measures, plots, and the worst misses and false alarms."""

from __future__ import annotations

import math
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
    from collections.abc import Collection, Iterator, Mapping, Sequence

    from cv2.typing import MatLike

    from oppload_cli.evaluation.evaluate import Evaluation
    from oppload_cli.evaluation.metrics.clips import Clip, Numbers
    from oppload_cli.stimulus.protocol import Protocol

    _Moment = tuple[int, int]  # the position of a clip, and a frame of it


_MOST = 4  # number of misses, and of false alarms, that the page shows for each detector
_PICTURE_HEIGHT = 270  # height of a still in pixels
_QUALITY = 82  # JPEG quality of a still
_WIDTH, _HEIGHT = 300, 56  # of the strip below a still, in units of its SVG drawing
_HIGHEST = 3.0  # the top of a strip is at most this multiple of the threshold


class _Definition(NamedTuple):
    """The definition of a measure for the page; the unit of a share is empty."""

    title: str
    unit: str
    text: str


CONDITIONS = {
    "at 0.5, 1, 2 per minute": "An alarm is evidence above one fixed threshold. Evidence is the "
    "response; within `contact_s` of contact it is the response divided by `contact_share`. The "
    "threshold is the lowest one such that neither it nor any higher threshold gives more than "
    "this number of false alarms per minute, over all footage without an approach. It is chosen "
    "on the same clips on which it is judged, so the results are better than on new clips. Each "
    "draw of the bootstrap chooses it again.",
    "held out at 0.5, 1, 2 per minute": "The threshold for a clip is chosen in the same way, but "
    "on the clips of all other videos (leave one out). Expect these results on a new video.",
    "alarm as shipped": "The detector's own alarm, as `oppload run` has it. No threshold is "
    "chosen on these clips. Not determined if the detector's alarms are off, as under preset "
    "`paper`.",
}
MEASURES = {
    "detection_rate": _Definition(
        "detection rate",
        "",
        "Share of the approaches in which the evidence is above the threshold, or the alarm is on, "
        "in at least one frame from onset to contact, both included. n: approaches.",
    ),
    "lead_time_s": _Definition(
        "lead time",
        "s",
        "Time from the first such frame to contact, median over the detected approaches. Compare "
        "lead times only at similar detection rates: a detector that detects only the easy "
        "approaches detects them early. n: detected approaches.",
    ),
    "false_alarms_per_minute": _Definition(
        "false alarms per minute",
        "1/min",
        "How often the evidence rises above the threshold, or the alarm starts, in footage "
        "without an approach: clips labelled none, and the other clips before onset, both without "
        "warm-up. If this happens less than a second after the last frame with an alarm, it is the "
        "same false alarm. Also by kind of motion, as the manifest names it. n: clips with such "
        "footage.",
    ),
    "threshold": _Definition(
        "threshold",
        "response",
        "Evidence above the threshold is an alarm; in the detector's own unit. n: clips with "
        "footage without an approach.",
    ),
    "roc_auc": _Definition(
        "area under the ROC curve",
        "",
        "The score of a one-second window is its largest response. Positive windows: the last "
        "second before contact. Negative windows: the footage without an approach, cut into "
        "windows. A window of half a second also counts. Equal scores count half. n: windows.",
    ),
    "average_precision": _Definition(
        "average precision",
        "",
        "Mean precision over the steps of recall, with the same windows. It depends on the share "
        "of positive windows. n: windows.",
    ),
    "ordered_pairs": _Definition(
        "ordered pairs within clips",
        "",
        "The one-second window that ends some frames before contact is compared with each earlier "
        "window of the same clip. Share of the pairs in which the later window has the larger "
        "score; equal scores count half. Mean over clips. Chance gives 0.5. n: pairs.",
    ),
    "distinct_ratio": _Definition(
        "distinct ratio",
        "",
        "Largest response from onset to contact, divided by the largest response before onset. If "
        "less than half a second comes before onset, the divisor is the median of the largest "
        "responses of the clips labelled none. Median over clips. The responses have different "
        "scales (OppLoD squares its response), so use the ratio to compare clips and settings, not "
        "detectors. n: approaches.",
    ),
    "place_inside": _Definition(
        "winning unit inside the box",
        "",
        "Share of the frames with a labelled box in which the centre of the winning unit lies "
        "inside this box, enlarged 1.5 times about its centre. A frame without a winning unit "
        "counts as outside. 'frame_centre' always points at the centre of the frame. n: frames.",
    ),
    "place_distance_px": _Definition(
        "distance to the box's centre",
        "source px",
        "From the centre of the winning unit to the centre of the labelled box, median over the "
        "frames with both. n: these frames.",
    ),
    "place_distance_diagonals": _Definition(
        "distance to the box's centre",
        "box diagonals",
        "The same distance, divided by the diagonal of the box. n: these frames.",
    ),
    "alarmed_share": _Definition(
        "clips with a false alarm",
        "",
        "Share of the clips without an approach that have at least one alarm, by kind. Only for "
        "stimuli. n: clips.",
    ),
    "box_overlap": _Definition(
        "overlap of the boxes",
        "",
        "Intersection over union of two boxes, 5 frames before contact: that of the strongest "
        "looming object that the detector finds, and the part of the true box in the frame. 0 if "
        "the detector finds no object. Median over the approaches. Only for stimuli. n: approaches "
        "with a true box in this frame.",
    ),
    "contact_within": _Definition(
        "time to contact within 20 %",
        "",
        "Share of the approaches in which the times to contact of the last half second have a "
        "median error of at most 20 %. An approach without a time to contact counts as a larger "
        "error. n: approaches.",
    ),
    "contact_error": _Definition(
        "error of the time to contact",
        "",
        "Error of the time to contact, divided by the true time. Median over the frames of the "
        "last half second in which the detector gives a time, then median over the approaches with "
        "such frames. n: these approaches.",
    ),
}
INTERVALS = (
    "A bootstrap draws clips with replacement: as many clips with an approach, and as many "
    "without, as there are. Several approaches in one video are drawn together. The seed is "
    "fixed; `--draws` sets the number of draws, 1000 by default. 95 % of the draws give a value "
    "in the interval. The interval says how far a value depends on the choice of clips of these "
    "kinds; it says nothing about other kinds of clips. For 12 or 40 simulated clips, the "
    "intervals of shares and rates held the true value in 86 to 99 % of 1000 cases each. A "
    "threshold chosen on the same clips keeps to its rate of false alarms there, so the interval "
    "of that rate says nothing about new footage; that of a held-out threshold does. If all draws "
    "give the same value, the interval is the exact one: that of Clopper and Pearson for a share, "
    "and that of a Poisson process for a rate. Without a false alarm in T minutes, the upper "
    "bound of the rate is 3 / T (the rule of three): at a higher rate, a false alarm would have "
    "come with a probability of more than 95 %."
)


NO_VALUE = "\N{EN DASH}"
# Columns of the summary: title, measure, condition.
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

    `report` is the content of ``report.json``, and `plots` has PNG files by name. For the pictures
    of the worst moments, the function decodes the clips of the evaluation again.
    """
    minutes = report["manifest"]["minutes_without_approach"]
    return rendered(
        "evaluation.html",
        report=report,
        plots=[(embedded(plots[name]), caption) for name, (caption, _) in PLOTS.items()],
        stills=list(_stills(evaluation)),
        headline=_HEADLINE,
        allowed=int(minutes),
        quiet=f"{number(minutes)} minutes" if minutes >= 1.5 else f"{number(60 * minutes)} s",
        figures=_by_measure(report["figures"]),
        measured=list(dict.fromkeys(figure["contender"] for figure in report["figures"])),
        parameters=_parameters,
        conditions=CONDITIONS,
        measures=MEASURES,
        intervals=INTERVALS,
        label_of=label_of,
        number=number,
        nothing=NO_VALUE,
        strip_size=(_WIDTH, _HEIGHT),
    )


def number(value: float | None) -> str:
    """Return a number as the page shows it: two significant digits below 1, else at least three.

    None and NaN become a dash.
    """
    if value is None or math.isnan(value):
        return NO_VALUE
    if math.isinf(value):
        return "∞"
    if abs(value) >= 99.95:
        return f"{value:.0f}"
    return f"{value:.3g}" if abs(value) >= 0.995 else f"{value:.2g}"


def _stills(evaluation: Evaluation) -> Iterator[tuple[str, list[dict[str, Any]]]]:
    """Yield titles with stills, for each detector with units: misses, then false alarms."""
    groups = [
        (f"{title}: {label_of(name)}", name, moments)
        for name in evaluation.performances
        if any(clip.outputs[name].winner is not None for clip in evaluation.clips)
        for title, moments in _worst_of(evaluation, name).items()
        if moments
    ]
    pictures = _pictures(evaluation, {each for *_, moments in groups for each in moments})
    for title, name, moments in groups:
        yield title, [_still(evaluation, name, each, pictures.get(each)) for each in moments]


def _still(
    evaluation: Evaluation, name: str, moment: _Moment, picture: bytes | None
) -> dict[str, Any]:
    """Return a frame that the page shows, with the evidence over its clip, for the template."""
    clip, frame = evaluation.clips[moment[0]], moment[1]
    output, decision = clip.outputs[name], evaluation.performances[name].decisions[AT_ONE]
    threshold = float(decision.thresholds[0])  # the same in each clip
    evidence = float(output.evidence[frame])
    multiple = f"{number(evidence / threshold)} times the threshold" if threshold > 0 else ""
    winner = None if output.winner is None else output.winner[frame]
    in_approach = frame >= clip.approach[0]
    return {
        "clip": clip,
        "frame": frame,
        # None if the frame could not be decoded again.
        "picture": None if picture is None else embedded(picture, "jpeg"),
        "label": clip.label.boxes.get(frame),
        "winner": winner.tolist() if winner is not None and np.isfinite(winner).all() else None,
        "strip": _strip(clip, np.nan_to_num(output.evidence), threshold, frame),
        "time": f"{number(clip.lead(frame))} s before contact" if in_approach else clip.label.kind,
        "evidence": multiple or number(evidence),
    }


def _by_measure(figures: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, dict[str, Any]]]:
    """Return the figures by measure, condition and detector, in the order of the definitions."""
    table: dict[str, dict[str, dict[str, Any]]] = {name: {} for name in MEASURES}
    for figure in figures:
        of_condition = table[figure["measure"]].setdefault(figure["condition"], {})
        of_condition[figure["contender"]] = figure
    return table


def _parameters(detector: Mapping[str, Any]) -> dict[str, Any]:
    """Return the height, parameters and alarm parameters of a detector in the report."""
    alarm = {f"alarm.{name}": value for name, value in detector["alarm"].items()}
    return {"working height": detector["height"], **detector["parameters"], **alarm}


def _worst_of(evaluation: Evaluation, name: str) -> dict[str, list[_Moment]]:
    """Return the worst moments of a detector by title: at most four misses and four false alarms.

    The frame of a miss has the largest evidence of the approach; the miss with the smallest such
    evidence comes first. The frame of a false alarm has the largest evidence of the clip's footage
    without an approach; the largest comes first.
    """

    def peak(index: int, start: int, stop: int) -> tuple[float, _Moment]:
        evidence = evaluation.clips[index].outputs[name].evidence
        frame = start + int(evidence[start:stop].argmax())
        return float(evidence[frame]), (index, frame)

    detected = evaluation.performances[name].decisions[AT_ONE].outcomes.detected
    misses = map(int, np.flatnonzero(detected == 0))
    missed = sorted(peak(index, *evaluation.clips[index].approach) for index in misses)
    spans = [(index, *clip.quiet) for index, clip in enumerate(evaluation.clips)]
    largest = [peak(index, start, stop) for index, start, stop in spans if start < stop]
    largest.sort(key=lambda each: (-each[0], each[1]))
    return {
        "Worst misses": [moment for _, moment in missed[:_MOST]],
        "Largest evidence without an approach": [
            moment for evidence, moment in largest[:_MOST] if evidence > 0
        ],
    }


def _pictures(evaluation: Evaluation, moments: Collection[_Moment]) -> dict[_Moment, bytes]:
    """Return grey JPEGs by moment, without frames that cannot be decoded again."""
    return {
        (index, frame): jpeg
        for index in sorted({index for index, _ in moments})
        for frame, jpeg in _frames(
            evaluation.entries[index].path, {frame for at, frame in moments if at == index}
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
        return  # the file has changed since the evaluation: the page has no picture of it


def _jpeg(grey: MatLike) -> bytes:
    _, data = cv2.imencode(".jpg", grey, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    return data.tobytes()


def _strip(clip: Clip, evidence: Numbers, threshold: float, shown: int) -> dict[str, Any]:
    """Return the coordinates of a drawing of `_WIDTH` x `_HEIGHT`: the evidence over a clip.

    Evidence above three times the threshold is cut off. In a clip with more than `2 * _WIDTH`
    frames, a point stands for the largest of several frames. The frame `shown` is marked.
    """
    top = float(evidence.max()) or 1.0
    if threshold > 0:
        top = min(max(top, 1.2 * threshold), _HIGHEST * threshold)
    frame_width = _WIDTH / len(clip)
    start, stop = clip.approach

    def y(value: float) -> float:
        return _HEIGHT - 2 - (_HEIGHT - 6) * min(value / top, 1.0)

    step = max(1, math.ceil(len(evidence) / (2 * _WIDTH)))
    firsts = range(0, len(evidence), step)
    frames = [first + int(evidence[first : first + step].argmax()) for first in firsts]
    approach = (start * frame_width, (stop - start) * frame_width)  # left edge and width
    return {
        "approach": approach if stop > start else None,
        "points": [((frame + 0.5) * frame_width, y(float(evidence[frame]))) for frame in frames],
        "threshold": None if math.isnan(threshold) else y(threshold),
        "now": (shown + 0.5) * frame_width,
    }
