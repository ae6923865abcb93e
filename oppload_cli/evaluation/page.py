"""``evaluation.html``: one page with all measurements, plots, and stills of the worst moments."""

from __future__ import annotations

import math
import tomllib
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import cv2
import numpy as np

from oppload_cli.errors import SourceError, counted
from oppload_cli.evaluation.detectors import full_label
from oppload_cli.evaluation.manifest import STIMULI
from oppload_cli.evaluation.metrics.alarms import AT_ONE
from oppload_cli.evaluation.plots import PLOTS
from oppload_cli.files.html import embedded, rendered
from oppload_cli.results.alarm_log import times
from oppload_cli.stimulus.renderer import Renderer
from oppload_cli.video.source import open_video
from oppload_cli.video.span import Position, Span

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping, Sequence

    from cv2.typing import MatLike

    from oppload_cli.evaluation.engine import Evaluation
    from oppload_cli.evaluation.metrics.clips import Clip, Numbers
    from oppload_cli.stimulus.protocol import Protocol

    _Moment = tuple[int, int]  # the position of a clip, and a frame of it


_MOST = 4  # stills under each title for each detector
_WIDTH, _HEIGHT = 300, 56  # of the strip below a still, in units of its SVG drawing


class _Definition(NamedTuple):
    title: str
    text: str
    unit: str = ""  # empty for a share


_DEFINITIONS = tomllib.loads(
    resources.files(__package__).joinpath("definitions.toml").read_text(encoding="utf-8")
)
CONDITIONS: dict[str, str] = _DEFINITIONS["conditions"]
MEASURES = {
    name: _Definition(**definition) for name, definition in _DEFINITIONS["measures"].items()
}
INTERVALS: str = _DEFINITIONS["intervals"]
NO_VALUE = "\N{EN DASH}"
# Columns of the summary: title, measure, condition.
_HEADLINE = (
    ("at 1 per minute: detected", "detection_rate", "at 1 per minute"),
    ("at 1 per minute: lead (s)", "lead_time_s", "at 1 per minute"),
    ("held out: detected", "detection_rate", "held out at 1 per minute"),
    ("held out: false alarms per minute", "false_alarms_per_minute", "held out at 1 per minute"),
    ("as shipped: detected", "detection_rate", "alarm as shipped"),
    ("as shipped: false alarms per minute", "false_alarms_per_minute", "alarm as shipped"),
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
        battery=sorted((report["battery"] or {}).items(), key=_auc),
        selectivity=embedded(plots["battery.png"]) if report["battery"] else None,
        stills=list(_stills(evaluation)),
        stimuli=evaluation.manifest.path == STIMULI,
        headline=_HEADLINE,
        allowed=int(minutes),
        quiet=f"{number(minutes)} minutes" if minutes >= 1.5 else f"{number(60 * minutes)} s",
        measurements=_by_measure(report["figures"]),
        splits=_splits(report["splits"]),
        measured=list(dict.fromkeys(figure["contender"] for figure in report["figures"])),
        parameters=_parameters,
        conditions=CONDITIONS,
        measures=MEASURES,
        intervals=INTERVALS,
        full_label=full_label,
        number=number,
        counted=counted,
        nothing=NO_VALUE,
        strip_size=(_WIDTH, _HEIGHT),
    )


def _auc(found: tuple[str, Mapping[str, Any]]) -> float:
    """Return a key that sorts the detectors of the battery: the most selective one comes first."""
    return -float(np.nan_to_num(found[1]["auc"], nan=-1.0))


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
    """Yield titles with stills for each detector with units, in the order of `_worst_of`."""
    groups = [
        (f"{title}: {full_label(name)}", name, moments)
        for name in evaluation.performances
        if any(clip.outputs[name].winner is not None for clip in evaluation.clips)
        for title, moments in _worst_of(evaluation, name).items()
        if moments
    ]
    pictures = _pictures(evaluation, {moment for *_, moments in groups for moment in moments})
    for title, name, moments in groups:
        yield title, [_still(evaluation, name, moment, pictures.get(moment)) for moment in moments]


def _still(
    evaluation: Evaluation, name: str, moment: _Moment, picture: bytes | None
) -> dict[str, Any]:
    """Return a frame that the page shows, with the evidence over its clip, for the template."""
    clip, frame = evaluation.clips[moment[0]], moment[1]
    output, decision = clip.outputs[name], evaluation.performances[name].decisions[AT_ONE]
    threshold = float(decision.thresholds[0])  # the same in each clip
    evidence = float(output.evidence[frame])
    multiple = f"{times(evidence / threshold)} times the threshold" if threshold > 0 else ""
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


def _by_measure(
    measurements: Sequence[Mapping[str, Any]],
) -> dict[str, dict[str, dict[str, Mapping[str, Any]]]]:
    """Return measurements by measure, condition and detector, in the order of the definitions."""
    table: dict[str, dict[str, dict[str, Mapping[str, Any]]]] = {name: {} for name in MEASURES}
    for measurement in measurements:
        by_detector = table[measurement["measure"]].setdefault(measurement["condition"], {})
        by_detector[measurement["contender"]] = measurement
    return table


def _splits(
    splits: Sequence[Mapping[str, Any]],
) -> dict[str, dict[tuple[str, str], tuple[int, float]]]:
    """Return by rule, and by detector and other detector, the approaches that only it detects.

    A pair without any such approach is left out; the second value is the p of the pair.
    """
    table: dict[str, dict[tuple[str, str], tuple[int, float]]] = {}
    for split in splits:
        one, other = split["contenders"]
        of_rule = table.setdefault(split["condition"], {})
        if split["only_first"] or split["only_second"]:
            of_rule[one, other] = split["only_first"], split["p"]
            of_rule[other, one] = split["only_second"], split["p"]
    return table


def _parameters(detector: Mapping[str, Any]) -> dict[str, Any]:
    """Return the height, parameters and alarm parameters of a detector in the report."""
    alarm = {f"alarm.{name}": value for name, value in detector["alarm"].items()}
    return {"working height": detector["height"], **detector["parameters"], **alarm}


def _worst_of(evaluation: Evaluation, name: str) -> dict[str, list[_Moment]]:
    """Return the worst moments of a detector by title, at most four under each title.

    The frame of a miss has the largest evidence of the approach; the miss with the smallest such
    evidence comes first. The frame of a clip without an approach, or before its onset, has the
    largest evidence of this footage, whether or not it is a false alarm; the largest comes first.
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
    largest.sort(key=lambda found: (-found[0], found[1]))
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
            evaluation.entries[index].path, {frame for clip, frame in moments if clip == index}
        )
    }


def _frames(path: Path | Protocol, wanted: set[int]) -> Iterator[tuple[int, bytes]]:
    if not isinstance(path, Path):
        renderer = Renderer(path)
        yield from ((frame, _jpeg(renderer.grey(frame))) for frame in sorted(wanted))
        return
    span = Span(start=Position(frame=min(wanted)), end=Position(frame=max(wanted) + 1))
    try:
        with open_video(path, height=270, span=span) as video:
            for frame in video:
                if frame.index in wanted:
                    grey = cv2.convertScaleAbs(frame.luma, alpha=255.0)
                    yield frame.index, _jpeg(grey)
    except SourceError:
        return  # the file has changed since the evaluation: the page has no picture of it


def _jpeg(grey: MatLike) -> bytes:
    _, data = cv2.imencode(".jpg", grey, [cv2.IMWRITE_JPEG_QUALITY, 82])
    return data.tobytes()


def _strip(clip: Clip, evidence: Numbers, threshold: float, shown: int) -> dict[str, Any]:
    """Return the coordinates of a drawing of `_WIDTH` x `_HEIGHT`: the evidence over a clip.

    Evidence above three times the threshold is cut off. In a clip with more than `2 * _WIDTH`
    frames, a point stands for the largest of several frames. The frame `shown` is marked.
    """
    top = float(evidence.max()) or 1.0
    if threshold > 0:
        top = min(max(top, 1.2 * threshold), 3 * threshold)
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
