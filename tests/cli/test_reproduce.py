from __future__ import annotations

import base64
import json
import subprocess
import sys
from html.parser import HTMLParser
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pytest

from docs.generate_reproduction import DOCS, part
from oppload_cli.reproduction import claims
from oppload_cli.reproduction.claims import FIGURES, ClaimVerdict
from tests.cli.inside import oppload

if TYPE_CHECKING:
    from pathlib import Path

    from tests.browser import Browser


class Page(HTMLParser):
    """The content of the page, by section."""

    def __init__(self) -> None:
        super().__init__()
        self.sections: dict[str, dict[str, list[str]]] = {}
        self.links: list[str] = []
        self._section = ""
        self._kind = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = {name: value or "" for name, value in attrs}
        self.links += [values[name] for name in ("src", "href") if name in values]
        if tag == "section":
            self._section = values["id"]
            self.sections[self._section] = {}
        elif tag == "img":
            self._add("img", values["src"])
        self._kind = values.get("class", "").split(" ", maxsplit=1)[0]

    def handle_data(self, data: str) -> None:
        if data.strip():
            self._add(self._kind, data.strip())

    def handle_endtag(self, tag: str) -> None:
        self._section = "" if tag == "section" else self._section
        self._kind = ""

    def _add(self, kind: str, text: str) -> None:
        if self._section:
            self.sections[self._section].setdefault(kind, []).append(text)


def check_page(folder: Path, names: list[str]) -> None:
    """Check that every figure is embedded, decodes, and has all its parts."""
    page = Page()
    page.feed((folder / "index.html").read_text())
    assert list(page.sections) == names
    for name, parts in page.sections.items():
        (source,) = parts["img"]
        data = base64.b64decode(source.removeprefix("data:image/png;base64,"), validate=True)
        assert data == (folder / f"{name}.png").read_bytes()
        picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE)
        assert picture is not None
        assert picture.shape[1] > 600
        assert picture.std() > 5
        assert len(parts["statement"]) >= 1
        assert len(parts["measured"]) == len(parts["verdict"]) >= len(parts["statement"])
        verdicts = {text.removesuffix(", hardly responds") for text in parts["verdict"]}
        assert verdicts <= set(ClaimVerdict)
        assert parts["command"] == [f"oppload reproduce --only {name}"]
    # Nothing is fetched: pictures are in the page, and links stay in it.
    assert all(link.startswith(("data:image/png;base64,", "#")) for link in page.links)


@pytest.fixture(scope="module")
def one_figure(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("reproduced")
    done = oppload("reproduce", "--only", "rmo-definition", "-o", folder)
    names = [f"rmo-definition.{end}" for end in ("png", "csv")] + ["report.json", "index.html"]
    assert done.returncode == 0
    judged = json.loads((folder / "report.json").read_text())["figures"][0]["claims"]
    given = [finding["verdict"] for claim in judged for finding in claim["measured"].values()]
    counts = ", ".join(f"{given.count(verdict)} '{verdict}'" for verdict in ClaimVerdict)
    assert done.stderr == f"verdicts on the statements of the paper: {counts}\n"
    assert done.stdout.split() == [str(folder / name) for name in names]
    assert sorted(path.name for path in folder.iterdir()) == sorted(names)
    return folder


@pytest.mark.long
def test_the_page_holds_statement_measurement_verdict_and_command(one_figure: Path) -> None:
    check_page(one_figure, ["rmo-definition"])


@pytest.mark.long
def test_the_report_says_the_same(one_figure: Path) -> None:
    report: dict[str, Any] = json.loads((one_figure / "report.json").read_text())
    assert report["schema"] == "oppload.reproduction/1"
    (figure,) = report["figures"]
    page = Page()
    page.feed((one_figure / "index.html").read_text())
    parts = page.sections["rmo-definition"]
    found = [one for claim in figure["claims"] for one in claim["measured"].values()]
    assert parts["measured"] == [one["text"] for one in found]
    assert parts["verdict"] == [one["verdict"] for one in found]


@pytest.mark.long
def test_the_page_of_the_documentation_has_the_same_section(one_figure: Path) -> None:
    [figure] = json.loads((one_figure / "report.json").read_text())["figures"]
    page = (DOCS / "reproduction.md").read_text("utf-8")
    assert "\n".join(part(figure)).strip() in page, "run: python docs/generate_reproduction.py"
    assert (DOCS / "reproduction" / figure["file"]).exists()


@pytest.mark.long
def test_a_browser_shows_the_figure(one_figure: Path, browser: Browser) -> None:
    browser.open(one_figure / "index.html")
    assert browser.pictures() == 1


@pytest.mark.long
def test_figures_in_another_format_are_written_as_they_are_done(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[list[str]] = []
    pages = claims.pages_of

    def noted(*arguments: Any) -> Any:
        seen.append(sorted(path.name for path in tmp_path.iterdir()))
        return pages(*arguments)

    monkeypatch.setattr("oppload_cli.cli.reproduce.pages_of", noted)
    call = "reproduce", "--only", "rmo-definition", "--plot", "svg", "-o", tmp_path, "-j", "1"
    assert oppload(*call).returncode == 0
    assert [name for name in seen[0] if not name.endswith(".part")] == [
        "rmo-definition.csv",
        "rmo-definition.svg",
    ]
    assert "</svg>" in (tmp_path / "rmo-definition.svg").read_text()
    rows = (tmp_path / "rmo-definition.csv").read_text().splitlines()
    assert rows[:2] == ["pattern,rom_pairs,rmo", '"outward, equal",1,1']
    (figure,) = json.loads((tmp_path / "report.json").read_text())["figures"]
    assert (figure["file"], figure["table"]) == ("rmo-definition.svg", "rmo-definition.csv")


def test_the_names_of_the_figures() -> None:
    assert oppload("reproduce", "--list").stdout.split() == list(FIGURES)


def test_wrong_use(one_figure: Path, tmp_path: Path) -> None:
    done = oppload("reproduce", "--only", "looming-center", "-o", tmp_path / "out")
    assert (done.returncode, "did you mean 'looming-centre'" in done.stderr) == (2, True)
    assert not (tmp_path / "out").exists()
    report = (one_figure / "report.json").read_bytes()
    done_again = oppload("reproduce", "--only", "rmo-definition", "-o", one_figure)
    assert (done_again.returncode, "exists already" in done_again.stderr) == (2, True)
    assert (one_figure / "report.json").read_bytes() == report
    (tmp_path / "file").write_text("in the way")
    blocked = oppload("reproduce", "-o", tmp_path / "file" / "inside")
    assert (blocked.returncode, "cannot be written" in blocked.stderr) == (2, True)


@pytest.mark.slow
def test_every_figure_of_the_paper(tmp_path: Path, browser: Browser) -> None:
    folder = tmp_path / "all"
    done = subprocess.run(
        [sys.executable, "-m", "oppload_cli", "reproduce", "-o", str(folder)],
        capture_output=True, text=True, check=False, timeout=900,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    check_page(folder, list(FIGURES))
    browser.open(folder / "index.html")
    assert browser.pictures() == len(FIGURES)
    report: dict[str, Any] = json.loads((folder / "report.json").read_text())
    verdicts = {figure["name"]: figure["verdicts"] for figure in report["figures"]}
    assert verdicts["up-down"]["opplod_reference"] == "holds"
    assert verdicts["inward"]["opplod_paper"] == "does not hold"
    assert {one for given in verdicts.values() for one in given.values()} == set(ClaimVerdict)
