"""Pages made from templates."""

from __future__ import annotations

import base64

import pytest
from jinja2 import UndefinedError

from oppload_cli.files.html import embedded, rendered


def test_a_picture_is_embedded_as_its_address() -> None:
    kind, data = embedded(b"\xff\xd8", "jpeg").split(",")
    assert kind == "data:image/jpeg;base64"
    assert base64.b64decode(data) == b"\xff\xd8"


def test_text_in_a_page_is_escaped_and_nothing_may_be_missing() -> None:
    report = {
        "paper": "<script>", "figures": [], "wall_s": 1, "tool": {"oppload": "1", "python": "3"},
    }  # fmt: skip
    page = rendered("reproduction.html", report=report, introduction="a & b", detectors=[])
    assert "<h1>&lt;script&gt;: which statements hold</h1>" in page
    assert "<p>a &amp; b</p>" in page
    assert "img { height: auto;" in page
    with pytest.raises(UndefinedError):
        rendered("reproduction.html", report=report, detectors=[])
