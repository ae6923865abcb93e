"""Write the pages of docs/ that follow from the code: run ``make docs``."""

from __future__ import annotations

import sys
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING

from oppload_cli.cli.models import SETS
from oppload_cli.errors import ExitCode
from oppload_cli.evaluation.definitions import CONDITIONS, INTERVALS, MEASURES
from oppload_cli.results.columns import COMMON, OF_MODEL, RMO

if TYPE_CHECKING:
    from collections.abc import Iterable

    from oppload_cli.parameters import Parameters
    from oppload_cli.results.columns import Column

DOCS = Path(__file__).parent
EXITS = {
    ExitCode.DONE: "done",
    ExitCode.BUG: "a bug of oppload",
    ExitCode.USAGE: "wrong use, or a result that cannot be written",
    ExitCode.NOTHING_READ: "nothing could be read",
    ExitCode.INCOMPLETE: "done but incomplete: a damaged or truncated input, or some inputs failed",
    ExitCode.CONDITION_MET: "a condition of `--fail-on` was met",
    ExitCode.INTERRUPTED: "interrupted",
}


def formats() -> str:
    """Return the page of file formats and exit codes."""
    parts = [(DOCS / "formats.in.md").read_text(encoding="utf-8")]
    parts += ["### Every result", columns(COMMON)]
    for model, own in OF_MODEL.items():
        parts += [f"### With model `{model}`", columns(own)]
    parts += ["### Unless `--no-rmo`", columns(RMO)]
    parts += [
        "## Exit codes",
        table(("code", "meaning"), ((str(int(c)), m) for c, m in EXITS.items())),
    ]
    return "\n".join(parts) + "\n"


def parameters() -> str:
    """Return the page of all parameters."""
    parts = [
        "# Parameters",
        "Set one with `--set set.parameter=value`, or in a file: see `oppload config`.",
        "*auto* follows from the video: its working height or its frame rate. Defaults are those of"
        " preset `default`; `oppload models` lists what other presets have.",
        "",
    ]
    for name, (meaning, kind) in SETS.items():
        header = ("parameter", "default", "unit", "range", "meaning")
        parts += [f"## `{name}`", meaning, "", table(header, rows(kind))]
    return "\n".join(parts) + "\n"


def evaluation() -> str:
    """Return the page of the evaluation on labelled clips."""
    parts = [(DOCS / "evaluation.in.md").read_text(encoding="utf-8")]
    parts += ["## Ways to decide on an alarm", table(("condition", "meaning"), CONDITIONS.items())]
    measures = ((f"`{name}`", each.title, each.unit, each.text) for name, each in MEASURES.items())
    parts += ["## Measures", table(("measure", "title", "unit", "definition"), measures)]
    parts += ["## Intervals", INTERVALS]
    return "\n".join(parts) + "\n"


def rows(kind: type[Parameters]) -> Iterable[tuple[str, ...]]:
    """Yield a row per parameter of a set."""
    for each in fields(kind):
        meta = each.metadata
        bounds = " to ".join(
            "" if end is None else f"{end:g}" for end in (meta["low"], meta["high"])
        )
        allowed = ", ".join(str(choice) for choice in meta["choices"])
        default = "auto" if each.default is None else str(each.default)
        span = allowed or (bounds if bounds.strip() != "to" else "")
        yield f"`{each.name}`", default, meta["unit"], span, meta["meaning"]


def columns(these: Iterable[Column]) -> str:
    """Return a table of columns."""
    return table(("column", "unit", "meaning"), ((f"`{c.name}`", c.unit, c.meaning) for c in these))


def table(header: tuple[str, ...], body: Iterable[tuple[str, ...]]) -> str:
    """Return a Markdown table."""
    lines = [header, ("---",) * len(header), *body]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


PAGES = {"evaluation.md": evaluation, "formats.md": formats, "parameters.md": parameters}


def main() -> None:
    """Write every page, or with --check say which one is stale."""
    for name, page in PAGES.items():
        path, text = DOCS / name, page()
        if "--check" not in sys.argv:
            path.write_text(text, encoding="utf-8")
        elif path.read_text(encoding="utf-8") != text:
            sys.exit(f"{path} is stale: run 'make docs'")


if __name__ == "__main__":
    main()
