"""``evaluation.html``: the evaluation as one page that needs no other file."""

from __future__ import annotations

import base64
import math
from html import escape
from typing import TYPE_CHECKING, Any

from oppload_cli.evaluation.definitions import CONDITIONS, INTERVALS, MEASURES
from oppload_cli.evaluation.look import STYLE
from oppload_cli.evaluation.stills import RATE
from oppload_cli.evaluation.strip import overlay, strip
from oppload_cli.evaluation.text import NOTHING, cell, duration, marked_up, named, number

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from oppload_cli.evaluation.evaluate import Evaluation
    from oppload_cli.evaluation.stills import Moment

Figures = dict[tuple[str, str], dict[str, dict[str, Any]]]  # measure, condition; contender
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
PLOTS = {
    "detection.png": "Detection rate over false alarms per minute, for every fixed threshold.",
    "roc.png": "ROC over one-second windows; area in brackets.",
    "precision-recall.png": "Precision over recall of the same windows; average in brackets.",
    "within-clip.png": "Correctly ordered pairs of windows within clips; bars: 95 % intervals.",
    "lead-time.png": "Lead of each detected approach.",
    "false-alarms.png": "False alarms per minute by kind of motion, at 1 per minute in all.",
}
CAUSES = {
    True: "Worst misses",
    False: "Largest responses without an approach",
}


def page_of(
    evaluation: Evaluation,
    report: Mapping[str, Any],
    plots: Mapping[str, bytes],
    moments: Sequence[Moment],
    pictures: Mapping[tuple[int, int], bytes],
) -> str:
    """Return the page.

    Parameters
    ----------
    evaluation : Evaluation
        What was measured.
    report : mapping
        From :func:`oppload_cli.evaluation.report.report_of`.
    plots : mapping of str to bytes
        PNG by file name.
    moments : sequence of Moment
        The worst ones.
    pictures : mapping
        JPEG by clip and frame.

    Returns
    -------
    str
        HTML with every picture in it.
    """
    body = "\n".join(
        [
            *_introduction(report),
            *_headline(report),
            *_plots(plots),
            *_stills(evaluation, moments, pictures),
            *_clips(report),
            *_figures(report),
            *_definitions(),
            *_parameters(report),
        ]
    )
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>oppload evaluate</title>\n<style>{STYLE}</style>\n</head>\n"
        f"<body>\n{body}\n</body>\n</html>\n"
    )


def _introduction(report: Mapping[str, Any]) -> Iterator[str]:
    facts = report["manifest"]
    yield f"<h1>Looming detectors on {facts['clips']} labelled clips</h1>"
    yield (
        f"<p>Clips with an approach: {facts['looming']}; without: {facts['none']}; in all "
        f"{facts['frames']} frames, with {duration(facts['minutes_without_approach'])} of footage "
        f"without an approach. From <code>{escape(facts['path'])}</code>. Read each figure "
        "with its 95 % interval, which says how far it depends on which clips these happen to "
        "be.</p>"
    )
    if report["faults"]:
        items = "".join(f"<li>{escape(fault)}</li>" for fault in report["faults"])
        yield (
            '<div class="faults"><strong>Not everything could be used.</strong>'
            f"<ul>{items}</ul></div>"
        )
    tool = report["tool"]
    yield (
        f'<p class="note">oppload {escape(str(tool["oppload"]))}, Python '
        f"{escape(str(tool['python']))}. All figures: evaluation.csv and report.json.</p>"
    )


def _headline(report: Mapping[str, Any]) -> Iterator[str]:
    table = _by_measure(report["figures"])
    head = "".join(f"<th>{title}</th>" for title, _, _ in HEADLINE)
    minutes = report["manifest"]["minutes_without_approach"]
    yield '<section id="summary">\n<h2>At one false alarm per minute</h2>'
    yield (
        f'<p class="note">In these {duration(minutes)} that is at most {int(RATE * minutes)} in '
        "all, by one threshold for each model, chosen on these clips; 'held out' chooses it for "
        "each clip on the others.</p>"
    )
    yield f'<div class="wide"><table><thead><tr><th>model</th>{head}</tr></thead><tbody>'
    for name, contender in report["contenders"].items():
        cells = "".join(
            cell(found)
            if (found := table.get((measure, condition), {}).get(name))
            else f"<td>{NOTHING}</td>"
            for _, measure, condition in HEADLINE
        )
        title = f'<th scope="row" title="{escape(contender["meaning"])}">{named(name)}</th>'
        yield f"<tr>{title}{cells}</tr>"
    yield "</tbody></table></div></section>"


def _plots(plots: Mapping[str, bytes]) -> Iterator[str]:
    yield '<section id="plots">\n<h2>Curves</h2><div class="plots">'
    for name, caption in PLOTS.items():
        data = base64.b64encode(plots[name]).decode("ascii")
        yield (
            f'<figure class="plot"><img src="data:image/png;base64,{data}" '
            f'alt="{escape(caption)}"><figcaption>{escape(caption)}</figcaption></figure>'
        )
    yield "</div></section>"


def _stills(
    evaluation: Evaluation,
    moments: Sequence[Moment],
    pictures: Mapping[tuple[int, int], bytes],
) -> Iterator[str]:
    yield '<section id="stills">\n<h2>Where it fails</h2>'
    yield (
        '<p class="note">Solid: the field of the winning unit and its centre; dashed: the labelled '
        "box. Below, the responses over the whole clip: shaded the approach, dashed the threshold "
        "at 1 false alarm per minute, above three times of which they are cut; the line marks the "
        "frame shown.</p>"
    )
    for name in dict.fromkeys(each.contender for each in moments):
        for missed, title in CAUSES.items():
            part = [e for e in moments if e.contender == name and e.missed == missed]
            if not part:
                continue
            yield f'<h3>{title}: {named(name)}</h3><div class="stills">'
            for moment in part:
                yield _still(evaluation, moment, pictures.get((moment.clip, moment.frame)))
            yield "</div>"
    if not moments:
        yield "<p>No approach was missed, and nothing responded without one.</p>"
    yield "</section>"


def _still(evaluation: Evaluation, moment: Moment, picture: bytes | None) -> str:
    seen = evaluation.clips[moment.clip]
    response = float(seen.answers[moment.contender].response[moment.frame])
    over = response / moment.threshold if moment.threshold > 0 else math.nan
    after = f"{number(over)} times the threshold" if not math.isnan(over) else number(response)
    when = (
        f"{number(seen.lead(moment.frame))} s before contact"
        if moment.missed
        else escape(seen.label.kind)
    )
    alt = f"{seen.label.name}, frame {moment.frame}"
    image = ""
    if picture is not None:
        data = base64.b64encode(picture).decode("ascii")
        image = f'<img src="data:image/jpeg;base64,{data}" alt="{escape(alt)}">'
    return (
        f'<figure class="still"><div class="frame">{image}{overlay(seen, moment)}</div>'
        f"{strip(seen, moment)}<figcaption><strong>{escape(seen.label.name)}</strong>, "
        f"frame {moment.frame} ({when}): {after}</figcaption></figure>"
    )


def _clips(report: Mapping[str, Any]) -> Iterator[str]:
    names = list(report["contenders"])
    head = "".join(f"<th>{named(name)}</th>" for name in names)
    yield '<section id="clips">\n<h2>Clip by clip</h2>'
    yield (
        f'<p class="note">At {RATE:g} false alarm per minute: the lead in seconds where the '
        "approach is detected, and the number of false alarms.</p>"
    )
    yield (
        '<div class="wide"><table><thead><tr><th>clip</th><th>motion</th><th>seconds</th>'
        f"{head}</tr></thead><tbody>"
    )
    for clip in report["clips"]:
        cells = "".join(_outcome(clip["outcomes"][name]["at 1 per minute"]) for name in names)
        yield (
            f'<tr><th scope="row">{escape(clip["file"])}</th>'
            f"<td>{'looming' if clip['label'] == 'looming' else escape(clip['kind'])}</td>"
            f"<td>{number(clip['seconds'])}</td>{cells}</tr>"
        )
    yield "</tbody></table></div></section>"


def _outcome(outcome: Mapping[str, Any]) -> str:
    parts = []
    if outcome["detected"]:
        parts.append(f'<span class="yes">{number(outcome["lead_s"])} s</span>')
    elif outcome["detected"] is not None:
        parts.append('<span class="no">missed</span>')
    false = outcome["false_alarms"]
    if false:
        parts.append(f'<span class="no">{false} false</span>')
    return f"<td>{' '.join(parts) or NOTHING}</td>"


def _figures(report: Mapping[str, Any]) -> Iterator[str]:
    names = list(dict.fromkeys(figure["contender"] for figure in report["figures"]))
    head = "".join(f"<th>{named(name)}</th>" for name in names)
    yield '<section id="figures">\n<h2>All figures</h2>'
    yield (
        '<p class="note">With 95 % intervals, and n: how many clips, windows, pairs or frames each '
        "figure stands on.</p>"
    )
    yield f'<div class="wide"><table class="all"><thead><tr><th></th>{head}</tr></thead><tbody>'
    last = ""
    for (measure, condition), found in _by_measure(report["figures"]).items():
        if measure != last:
            last, of = measure, MEASURES[measure]
            unit = f" ({of.unit})" if of.unit else ""
            yield (f'<tr class="measure"><th colspan="{len(names) + 1}">{of.title}{unit}</th></tr>')
        cells = "".join(
            cell(found[name], counted=True) if name in found else "<td></td>" for name in names
        )
        yield f'<tr><th scope="row">{escape(condition)}</th>{cells}</tr>'
    yield "</tbody></table></div></section>"


def _definitions() -> Iterator[str]:
    yield '<section id="definitions">\n<h2>How each measure is defined</h2><dl>'
    for name, text in CONDITIONS.items():
        yield f"<dt>{escape(name)}</dt><dd>{marked_up(text)}</dd>"
    for each in MEASURES.values():
        unit = f" ({each.unit})" if each.unit else ""
        yield f"<dt>{escape(each.title + unit)}</dt><dd>{marked_up(each.text)}</dd>"
    yield f"<dt>intervals</dt><dd>{marked_up(INTERVALS)}</dd></dl></section>"


def _parameters(report: Mapping[str, Any]) -> Iterator[str]:
    yield '<section id="parameters">\n<h2>Parameters</h2>'
    for name, contender in report["contenders"].items():
        yield f"<details><summary>{named(name)}: {escape(contender['meaning'])}</summary><p>"
        sets = {"working height": contender["height"], "": contender["parameters"] or {}}
        sets["alarm"] = contender["alarm"] or {}
        pairs = [
            (f"{prefix}.{key}".lstrip("."), value)
            for prefix, content in sets.items()
            for key, value in (content.items() if isinstance(content, dict) else [("", content)])
        ]
        yield ", ".join(
            f"<code>{escape(key.rstrip('.'))} = {escape(str(value))}</code>" for key, value in pairs
        )
        yield "</p></details>"
    yield "</section>"


def _by_measure(figures: Sequence[Mapping[str, Any]]) -> Figures:
    """Return the figures by measure and condition, in the order of the definitions."""
    order = {name: at for at, name in enumerate(MEASURES)}
    table: Figures = {}
    for figure in sorted(figures, key=lambda each: order[each["measure"]]):
        key = (figure["measure"], figure["condition"])
        table.setdefault(key, {})[figure["contender"]] = dict(figure)
    return table
