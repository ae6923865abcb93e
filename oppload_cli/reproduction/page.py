"""``index.html``: the report as one page that needs no other file."""

from __future__ import annotations

import base64
from html import escape
from typing import TYPE_CHECKING, Any

from oppload_cli.reproduction.claims import Verdict

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

MARKS = {Verdict.HOLDS: "yes", Verdict.IN_PART: "part", Verdict.DOES_NOT: "no"}
STYLE = """
:root { color-scheme: light; }
body { font: 16px/1.5 system-ui, sans-serif; color: #222; background: #fff; margin: 0 auto;
  max-width: 60rem; padding: 1.5rem; }
h1 { font-size: 1.6rem; line-height: 1.25; } h2 { font-size: 1.25rem; margin: 0 0 .25rem; }
section { border-top: 1px solid #ccc; padding-top: 1.25rem; margin-top: 2.5rem; }
figure { margin: 1rem 0; } img { max-width: 100%; height: auto; display: block; margin: 0 auto; }
figcaption { color: #555; font-size: .9rem; }
table { border-collapse: collapse; width: 100%; margin: .75rem 0; font-size: .95rem; }
th, td { text-align: left; vertical-align: top; padding: .35rem .6rem;
  border-bottom: 1px solid #ddd; }
th { font-weight: 600; } section table { table-layout: fixed; }
section th:first-child { width: 6rem; } section th:last-child { width: 8rem; }
code { background: #f3f3f3; padding: .1rem .35rem; border-radius: 3px; }
.statement { font-weight: 600; margin: 1rem 0 0; } .rule { color: #555; font-size: .85rem;
  margin: .1rem 0; }
.verdict { white-space: nowrap; padding: .05rem .5rem; border-radius: 3px; border: 1px solid; }
.yes { color: #00533c; background: #e3f4ee; } .part { color: #6b4a00; background: #fdf1d8; }
.no { color: #8a2b00; background: #fbe6dc; } .notes { font-size: .95rem; }
"""


def page_of(report: Mapping[str, Any], pictures: Mapping[str, bytes]) -> str:
    """Return the page.

    Parameters
    ----------
    report : mapping
        From :func:`oppload_cli.reproduction.report.report_of`.
    pictures : mapping of str to bytes
        PNG by the figure's name.

    Returns
    -------
    str
        HTML with every picture in it.
    """
    body = "\n".join(
        [
            *_introduction(report),
            *(part for each in report["figures"] for part in _section(each, pictures)),
        ]
    )
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>oppload reproduce</title>\n<style>{STYLE}</style>\n</head>\n"
        f"<body>\n{body}\n</body>\n</html>\n"
    )


def introduction(report: Mapping[str, Any]) -> str:
    """Return what the reader is told first, also in the docs.

    Parameters
    ----------
    report : mapping
        The report.

    Returns
    -------
    str
        Plain text.
    """
    counts = dict.fromkeys(map(str, MARKS), 0)
    for figure in report["figures"]:
        for claim in figure["claims"]:
            for finding in claim["measured"].values():
                counts[finding["verdict"]] += 1
    stated = ", ".join(f"{count} '{verdict}'" for verdict, count in counts.items())
    return (
        "Every synthetic figure of the OppLoD paper, made by oppload alone. Each statement of "
        "the paper, in our words, stands beside what was measured; the verdict follows from the "
        "measurement by the rule that is printed with it. Preset 'paper' is the paper to the "
        "letter, preset 'default' the same model made to work. Verdicts: "
        f"{stated}. The table gives each figure's verdict, and how many of its statements hold."
    )


def tally(figure: Mapping[str, Any], preset: str) -> str:
    """Return how many statements of a figure hold for a preset.

    Parameters
    ----------
    figure : mapping
        One of the report's.
    preset : str
        One of its presets.

    Returns
    -------
    str
        E.g. ``2 of 4``.
    """
    judged = [claim["measured"] for claim in figure["claims"] if preset in claim["measured"]]
    held = sum(measured[preset]["verdict"] == Verdict.HOLDS for measured in judged)
    return f"{held} of {len(judged)}"


def _introduction(report: Mapping[str, Any]) -> Iterator[str]:
    yield f"<h1>{escape(report['paper'])}: what holds</h1>"
    yield f"<p>{escape(introduction(report))}</p>"
    presets = list(
        dict.fromkeys(preset for figure in report["figures"] for preset in figure["verdicts"])
    )
    head = "".join(f"<th>{escape(preset)}</th>" for preset in presets)
    yield f"<table><thead><tr><th>figure</th>{head}</tr></thead><tbody>"
    for figure in report["figures"]:
        cells = "".join(
            f"<td>{_verdict(figure['verdicts'][preset])} {tally(figure, preset)}</td>"
            if preset in figure["verdicts"]
            else "<td></td>"
            for preset in presets
        )
        link = f'<a href="#{figure["name"]}">{escape(figure["title"])}</a>'
        yield f"<tr><td>{link}</td>{cells}</tr>"
    yield "</tbody></table>"
    tool = report["tool"]
    yield (
        f'<p class="rule">oppload {escape(str(tool["oppload"]))}, Python '
        f"{escape(str(tool['python']))}, {report['wall_s']} s. All numbers: report.json.</p>"
    )


def _section(figure: Mapping[str, Any], pictures: Mapping[str, bytes]) -> Iterator[str]:
    name, title = figure["name"], escape(figure["title"])
    data = base64.b64encode(pictures[name]).decode("ascii")
    yield f'<section id="{name}">\n<h2>{title}</h2>'
    for claim in figure["claims"]:
        yield f'<p class="statement">The paper: {escape(claim["statement"])}</p>'
        yield f'<p class="rule">Verdict: {escape(claim["rule"])}.</p>'
        yield "<table><thead><tr><th>preset</th><th>measured</th><th>verdict</th></tr></thead>"
        yield "<tbody>"
        for preset, finding in claim["measured"].items():
            yield (
                f'<tr><td class="preset">{escape(preset)}</td>'
                f'<td class="measured">{escape(finding["text"])}</td>'
                f"<td>{_verdict(finding['verdict'])}</td></tr>"
            )
        yield "</tbody></table>"
    yield (
        f'<figure><img src="data:image/png;base64,{data}" alt="{title}">'
        f"<figcaption>{escape(figure['shows'])}</figcaption></figure>"
    )
    if figure["notes"]:
        notes = "".join(f"<li>{escape(note)}</li>" for note in figure["notes"])
        yield f'<ul class="notes">{notes}</ul>'
    yield f'<p>This figure alone: <code class="command">{escape(figure["command"])}</code></p>'
    yield "</section>"


def _verdict(verdict: str) -> str:
    return f'<span class="verdict {MARKS[Verdict(verdict)]}">{escape(verdict)}</span>'
