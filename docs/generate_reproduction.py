"""Write docs/reproduction.md and its pictures from the folder of 'oppload reproduce'.

oppload reproduce -o reproduction && python docs/generate_reproduction.py reproduction
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from PIL import Image

from oppload_cli.reproduction.claims import detectors_in, introduction, stated, tally

if TYPE_CHECKING:
    from collections.abc import Iterator

DOCS = Path(__file__).parent
PICTURES = "reproduction"


def page(report: dict[str, Any]) -> str:
    """Return the page as Markdown."""
    return "\n".join(
        [*summary(report), *(line for figure in report["figures"] for line in part(figure))]
    )


def summary(report: dict[str, Any]) -> Iterator[str]:
    """Yield the introduction and the table of verdicts."""
    figures = report["figures"]
    detectors = detectors_in(report)
    yield "# The OppLoD paper: which statements hold"
    yield introduction(report)
    yield ""
    yield (
        "Generated from the `report.json` of `oppload reproduce` by "
        "`docs/generate_reproduction.py`. The paper's figures of real videos are missing, as their "
        "clips are not public."
    )
    yield ""
    yield f"| figure | {' | '.join(detectors)} | settings |"
    yield f"|---{'|---' * len(detectors)}|---|"
    for figure in figures:
        verdicts = " | ".join(
            f"{figure['verdicts'][detector]} ({tally(figure, detector)})"
            if detector in figure["verdicts"]
            else ""
            for detector in detectors
        )
        title = figure["title"]
        yield f"| [{title}](#{anchor(title)}) | {verdicts} | {settings(figure)} |"
    yield ""


def part(figure: dict[str, Any]) -> Iterator[str]:
    """Yield the section of one figure."""
    yield f"## {figure['title']}"
    yield f"`{figure['command']}`"
    yield ""
    yield f"![{figure['shows']}]({PICTURES}/{figure['file']})"
    yield ""
    yield f"*{figure['shows']}*"
    for claim in figure["claims"]:
        yield ""
        yield f"**{'The paper' if claim['source'] else 'Our reading'}:** {claim['statement']}"
        yield ""
        if claim["source"]:
            yield f"*{claim['source']}*"
            yield ""
        yield f"Verdict: {claim['rule']}."
        yield ""
        yield "| detector | measured | verdict |"
        yield "|---|---|---|"
        for detector, found in claim["measured"].items():
            yield f"| {detector} | {found['text'].replace('|', chr(92) + '|')} | {stated(found)} |"
    yield ""
    if figure["settings"]:
        yield f"- Settings: {settings(figure)}."
    for note in figure["notes"]:
        yield f"- {note}"
    yield ""


def settings(figure: dict[str, Any]) -> str:
    """Return the working height and the changed parameters of each detector."""
    return "; ".join(f"{detector}: {text}" for detector, text in figure["settings"].items())


def anchor(title: str) -> str:
    """Return the anchor that Markdown viewers give a heading."""
    kept = "".join(letter for letter in title.lower() if letter.isalnum() or letter in " -")
    return kept.replace(" ", "-")


def main(folder: Path) -> None:
    """Write the page and its pictures."""
    report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    pictures = DOCS / PICTURES
    pictures.mkdir(exist_ok=True)
    for figure in report["figures"]:
        # With a palette of 128 colours a picture takes a third of the bytes.
        picture = Image.open(folder / figure["file"]).convert("RGB").quantize(128)
        picture.save(pictures / figure["file"], optimize=True)
    (DOCS / "reproduction.md").write_text(page(report), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
