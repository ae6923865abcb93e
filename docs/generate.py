"""Write the pages of docs/ that follow from the code: run ``make docs``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from oppload_cli.errors import ExitCode
from oppload_cli.evaluation.page import CONDITIONS, INTERVALS, MEASURES
from oppload_cli.models.columns import ALL, COMMON, RMO, USUAL, VIEW, columns_of
from oppload_cli.models.registry import default_names, detectors
from oppload_cli.pipeline.settings import parameter_sets

if TYPE_CHECKING:
    from collections.abc import Iterable

    from oppload_cli.models.columns import RecordColumn
    from oppload_cli.models.detector import Detector
    from oppload_cli.schema import Parameters

DOCS = Path(__file__).parent
EXITS = {
    ExitCode.DONE: "done",
    ExitCode.BUG: "a bug of oppload",
    ExitCode.USAGE: "wrong use, or a result that cannot be written; no result for `collect`, or"
    " none that `plot` and `report` can read",
    ExitCode.NOTHING_READ: "nothing could be read: no input, no clip of `evaluate`, or none of the"
    " results of `collect`; also if the system has no further memory, processes or open files",
    ExitCode.INCOMPLETE: "done but incomplete: a damaged or truncated input, or some inputs failed",
    ExitCode.CONDITION_MET: "a condition of `--fail-on` was met",
    ExitCode.INTERRUPTED: "interrupted, or the program that reads standard output has ended",
}


def formats() -> str:
    """Return the page of file formats and exit codes."""
    above, below = (DOCS / "formats.in.md").read_text(encoding="utf-8").split("<!-- columns -->\n")
    tables = {name: columns_with(name, detector) for name, detector in detectors().items()}
    parts = [above + "### Every result", columns(one for one in COMMON if one.of == USUAL)]
    parts += [line for name in default_names() for line in tables.pop(name)]
    seen = "Each detector that has a box also has these columns, with its name in front:\n"
    parts += ["### With `--columns all`", columns(one for one in COMMON if one.of == ALL)]
    seen_by = (
        "Each detector also has the column `over_threshold`, with its name in front; a detector"
        " that has a box has all of these columns:\n"
    )
    parts += [seen_by, columns(general_details())]
    parts += ["### With `--fov`, and for stimuli with ground truth", seen, columns(VIEW)]
    parts += ["### Unless `--no-rmo`", columns(RMO) + below]
    parts += [
        "## Exit codes",
        table(("code", "meaning"), ((str(int(c)), m) for c, m in EXITS.items())),
        "## Columns of the other detectors",
    ]
    parts += [line for lines in tables.values() for line in lines]
    return "\n".join(parts) + "\n"


def columns_with(name: str, detector: type[Detector]) -> list[str]:
    """Return the lines about the columns of one detector."""
    lines = [f"### With model `{name}`", columns(columns_of(detector))]
    own = {f"{name}_{column.name}" for column in detector.details}
    details = [one for one in columns_of(detector, details=True) if one.name in own]
    return lines + (["With `--columns all` also:\n", columns(details)] if details else [])


def general_details() -> Iterable[RecordColumn]:
    """Yield the columns that every detector with boxes has with ``--columns all``."""
    detector = detectors()["opplod"]
    own = {column.name for column in detector.details}
    for column in columns_of(detector, details=True):
        name = column.name.removeprefix(f"{detector.name}_")
        if column.of == ALL and name not in own:
            yield column._replace(name=name)


def parameters() -> str:
    """Return the page of all parameters."""
    parts = [
        "# Parameters",
        "Set a parameter with `--set`, such as `--set opplod.gain=2` for the parameter `gain` of"
        " the set `opplod`, or in a configuration file (see `oppload config`).",
        "The default *auto* of a size follows from the working height; other values *auto* are"
        " the detector's own.",
        "",
    ]
    for name, (meaning, kind) in parameter_sets().items():
        header = ("parameter", "default", "unit", "range", "meaning")
        listed = list(rows(kind))
        parts += [f"## `{name}`", meaning, ""]
        parts += [table(header, listed) if listed else "It has no parameters.\n"]
    return "\n".join(parts) + "\n"


def evaluation() -> str:
    """Return the page of the evaluation on labelled clips."""
    parts = [(DOCS / "evaluation.in.md").read_text(encoding="utf-8")]
    parts += ["## Ways to decide on an alarm", table(("condition", "meaning"), CONDITIONS.items())]
    measures = ((f"`{name}`", one.title, one.unit, one.text) for name, one in MEASURES.items())
    parts += ["## Measures", table(("measure", "title", "unit", "definition"), measures)]
    parts += ["## Intervals", INTERVALS]
    return "\n".join(parts) + "\n"


def rows(kind: type[Parameters]) -> Iterable[tuple[str, ...]]:
    """Yield a row per parameter of a set."""
    for parameter in kind.declared():
        default = "auto" if parameter.default is None else str(parameter.default)
        yield f"`{parameter.name}`", default, parameter.unit, parameter.allowed, parameter.meaning


def columns(these: Iterable[RecordColumn]) -> str:
    """Return a table of columns."""
    return table(("column", "unit", "meaning"), ((f"`{c.name}`", c.unit, c.meaning) for c in these))


def table(header: tuple[str, ...], body: Iterable[tuple[str, ...]]) -> str:
    """Return a Markdown table."""
    lines = [header, ("---",) * len(header), *body]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


PAGES = {"evaluation.md": evaluation, "formats.md": formats, "parameters.md": parameters}


def main() -> None:
    """Write every page."""
    for name, page in PAGES.items():
        (DOCS / name).write_text(page(), encoding="utf-8")


if __name__ == "__main__":
    main()
