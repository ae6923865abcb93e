"""The generated pages are those that the code gives."""

from __future__ import annotations

import ast
import re
import runpy
import shlex
import sys
from pathlib import Path
from types import ModuleType

import click
import numpy as np
import pytest

import oppload_cli
from oppload_cli.cli import oppload
from oppload_cli.errors import FrameError

DOCS = Path(__file__).resolve().parents[1] / "docs"


def test_generated_pages_are_fresh() -> None:
    pages = runpy.run_path(str(DOCS / "generate.py"))["PAGES"]
    assert len(pages) == 3
    for name, page in pages.items():
        assert (DOCS / name).read_text(encoding="utf-8") == page(), "stale: run 'make docs'"


def test_links_between_pages_lead_somewhere() -> None:
    for page in _pages():
        for name, heading in re.findall(r"\]\(([^)#:]*)#?([^):]*)\)", page.read_text("utf-8")):
            target = page.parent / name if name else page
            assert target.exists(), f"{page.name} -> {name}"
            assert not heading or heading in _anchors(target), f"{page.name} -> {name}#{heading}"


def test_every_cited_paper_is_on_the_page_of_references() -> None:
    page, package = DOCS / "references.md", DOCS.parent / "oppload_cli"
    entries = re.findall(r"^- \*\*(.+) (\d{4})\*\*: ", page.read_text("utf-8"), re.MULTILINE)
    known = {(re.findall(r"[A-Z]\w+", names)[0], year) for names, year in entries}
    assert len(known) == len(entries)
    name, year = r"([A-Z][a-z]\w*)", r"((?:19|20)\d\d)"
    others = r"(?: [A-Z]\.)?(?: et al\.|(?:, [A-Z]\w+)*\s+and [A-Z]\w+)"
    forms = (
        rf"{name}{others},?\s\(?{year}\b",
        rf"\({name},? {year}[,)]",
        rf"(?<!and )\b{name} \({year}, ",
    )
    cited = set()
    for path in [*_pages(), *package.rglob("*.*")]:
        if path.suffix in {".md", ".py", ".csv", ".toml"} and path != page:
            text = path.read_text("utf-8")
            cited |= {pair for form in forms for pair in re.findall(form, text)}
    assert len(cited) > 20
    assert cited - known == set()
    assert known - cited == {("Fu", "2023"), ("Fu", "2026")}  # programs, named by their files


def test_the_citation_file_names_papers_as_the_references_do() -> None:
    references = (DOCS / "references.md").read_text("utf-8")
    _, *papers = (DOCS.parent / "CITATION.cff").read_text("utf-8").split("- type: article")
    assert len(papers) == 3
    for paper in papers:
        [doi] = re.findall(r"doi: (\S+)", paper)
        [line] = [line for line in references.splitlines() if f"](https://doi.org/{doi})" in line]
        names, year = re.findall(r"^- \*\*(.+) (\d{4})\*\*: ", line)[0]
        assert re.split(", | and ", names) == re.findall(r"family-names: (.+?),", paper)
        assert f"year: {year}" in paper
        [title] = re.findall(r'title: "(.+)"', paper)
        assert f"*{title}*" in line


def test_every_page_has_its_place_in_the_site() -> None:
    listed = {DOCS / "index.md"}
    for page in _pages():
        for block in re.findall(r"^```{toctree}\n(.*?)^```", page.read_text("utf-8"), re.M | re.S):
            names = [line for line in block.splitlines() if line and not line.startswith(":")]
            assert len(names) == len(set(names)), f"{page.name} lists a page twice"
            listed |= {(page.parent / f"{name}.md").resolve() for name in names}
    pages = {page for page in _pages() if DOCS in page.parents and ".in." not in page.name}
    assert {page.relative_to(DOCS).as_posix() for page in pages - listed} == set()


def test_the_page_of_the_python_api_lists_every_public_name() -> None:
    listed = set(re.findall(r"^   (\w+)$", (DOCS / "reference/api.md").read_text(), re.MULTILINE))
    assert set(oppload_cli.__all__) - listed == {"__version__", "stimulus"}
    assert set(oppload_cli.stimulus.__all__) - listed == set()


def test_pages_are_short_but_for_the_reference() -> None:
    reference = (DOCS / "reference" / "index.md").read_text("utf-8")
    longer = {
        page.name: count
        for page in _pages()
        if (count := len(re.findall(r"\S*\w\S*", page.read_text("utf-8")))) > 2000
        and f"../{page.stem}\n" not in reference
        and ".in." not in page.name
    }
    assert longer == {}


def test_the_command_line_takes_what_the_pages_show() -> None:
    shown = 0
    context = click.Context(oppload)
    for page in _pages():
        blocks = re.findall(r"^```.*?^```|^    \S.*?$", page.read_text("utf-8"), re.M | re.S)
        for line in "\n".join(blocks).replace("\\\n", " ").splitlines():
            if not line.strip().startswith("oppload "):
                continue
            command = re.split(r" (?:\||>|&&|&|\|\|)(?: |$)", line.strip())[0]
            # a number stands for a shell's variable
            _, *words = shlex.split(re.sub(r'"\$\w+"', "1", command), comments=True)
            while words[0] == "--load":  # loading is a side effect
                words = words[2:]
            name, *words = words
            sub = oppload.get_command(context, name)
            while isinstance(sub, click.Group):
                name, *words = words
                sub = sub.get_command(context, name)
            assert sub is not None, f"{page.name}: {line}"
            try:
                sub.make_context(name, words)
            except click.UsageError as error:
                if error.message.endswith("does not exist."):
                    continue
                raise AssertionError(f"{page.name}: {line}: {error.message}") from error
            shown += 1
    assert shown > 100


def test_the_tests_that_pages_name_exist() -> None:
    named = 0
    for page in _pages():
        for command in re.findall(r"`(pytest [^`]*-k [^`]*)`", page.read_text("utf-8")):
            words = shlex.split(command)
            name = words[words.index("-k") + 1]
            places = [DOCS.parent / word for word in words if word.startswith("tests/")]
            files = [each for place in places for each in (place, *place.rglob("test_*.py"))]
            tests = [
                each
                for file in files
                if file.is_file()
                for each in ast.parse(file.read_text("utf-8")).body
                if isinstance(each, ast.FunctionDef) and name in each.name
            ]
            slow = {"pytest.mark.slow" in map(ast.unparse, each.decorator_list) for each in tests}
            assert ("slow" in words) in slow, f"{page.name}: {command}"
            named += 1
    assert named > 10


def test_pages_name_only_files_of_the_project_that_exist() -> None:
    top = DOCS.parent
    named = 0
    for page in _pages():
        prose = re.sub(r"```.*?```", "", page.read_text("utf-8"), flags=re.DOTALL)
        for name in re.findall(r"`((?:[\w.-]+/)+[\w.-]*\.(?:py|c|h|toml|md))`", prose):
            if name.startswith("../"):
                continue  # beside the project
            places = (top / name, top / "oppload_cli" / name)
            assert any(place.exists() for place in places), f"{page.name} names {name}"
            named += 1
    assert named > 5


def test_the_list_of_how_to_pages_can_be_read_without_the_site() -> None:
    listed = (DOCS / "howto" / "index.md").read_text("utf-8")
    pages = {page for page in (DOCS / "howto").glob("*.md") if page.name != "index.md"}
    titles = {page.name: page.read_text("utf-8").splitlines()[0][2:] for page in pages}
    links = re.findall(r"^- \[(.*)\]\((.*)\)$", listed, re.MULTILINE)
    assert {name: title for title, name in links} == titles


def _pages() -> list[Path]:
    top = DOCS.parent
    others = [top / "README.md", top / "CONTRIBUTING.md", top / "benchmarks" / "README.md"]
    pages = [page for page in DOCS.rglob("*.md") if "_build" not in page.parts]
    return [*pages, *others]


def _anchors(page: Path) -> set[str]:
    """Return the names under which a page's headings can be linked to."""
    headings = re.findall(r"^#+ (.*)$", page.read_text("utf-8"), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def test_the_detector_of_contributing_is_complete(monkeypatch: pytest.MonkeyPatch) -> None:
    text = (DOCS.parent / "CONTRIBUTING.md").read_text("utf-8")
    code = re.search(r"^```python\n(.*?)^```", text, re.M | re.S)
    assert code is not None
    made = ModuleType("darkening")
    monkeypatch.setitem(sys.modules, made.__name__, made)  # dataclasses look their module up
    exec(compile(code[1], "CONTRIBUTING.md", "exec"), vars(made))  # noqa: S102 - the page's code
    model = made.Darkening((2, 2))
    bright, darker = np.ones((2, 2), np.float32), np.array([[0.9, 1], [1, 1]], np.float32)
    with pytest.raises(FrameError, match="must be a float32 array"):
        model.step(bright[1:])
    assert model.step(bright) is None
    assert model.step(darker).response == 0.25


def test_the_page_on_adding_a_detector_shows_what_lgmd2_has() -> None:
    page = (DOCS / "adding-a-detector.md").read_text("utf-8")
    lines = (DOCS.parent / "oppload_cli/models/published/lgmd2.py").read_text("utf-8")
    shown = re.findall(r"^    def (\w+\(.*\) -> \w+): \.\.\.$", page, re.M)
    assert len(shown) == 2
    assert all(f"    def {each}:\n" in lines for each in shown)
    assert f"lgmd2.py`, {len(lines.splitlines())} lines)" in page
