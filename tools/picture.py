"""Draw the rooms of the package and their imports: ``python -m tools.picture``.

The picture stands in ``docs/architecture.md``; a test compares it with the imports in the source.
The picture leaves out arrows that follow from others, and arrows to the bottom layer, which all
rooms may use.
"""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

from tools.structure import LAYERS, PACKAGE, ROOT, Graph, reachable, room_graph

if TYPE_CHECKING:
    from pathlib import Path

PICTURE = ROOT / "docs" / "architecture.svg"

# The column of each room (0 at the left), and its purpose.
_ROOMS: dict[str, tuple[int, str]] = {
    PACKAGE: (0, "the public names"),
    "__main__": (3, "the process"),
    "cli": (3, "the commands"),
    "api": (1, "run, results, for Python"),
    "batch": (0, "many inputs"),
    "evaluation": (3, "labelled clips"),
    "reproduction": (4, "the paper's claims"),
    "tuning": (4, "tuning curves"),
    "plots": (3, "figures"),
    "report": (1, "pages of results"),
    "pipeline": (1, "one input, to its files"),
    "annotation": (0, "annotated videos"),
    "stimulus": (3, "protocols, frames, truth"),
    "detection": (2, "alarms, places, contact"),
    "frames": (4, "times, repeats, between"),
    "results": (0, "records, tables, sidecars"),
    "models": (1, "the detectors"),
    "motion": (2, "optical flow, RMO"),
    "video": (3, "decoding, luminance"),
    "compute": (1, "compiled loops"),
    "environment": (3, "versions, processors"),
    "files": (0, "one way to write a file"),
    "processes": (4, "processes, threads, signals"),
    "schema": (0, "parameters"),
    "errors": (1, "errors, exit codes"),
    "frame_times": (5, "times in ticks"),
    "palette": (2, "colours"),
    "reference": (3, "published data"),
    "version": (4, "one number"),
}

# The way of one frame: each room that it enters, and what happens in the room.
_WAY = (
    ("video", "the source decodes a picture and gives Frame(index, time, luma)"),
    ("frames", "repeats are found, the flow is measured"),
    ("pipeline", "the frame goes to all detectors, at the height of each"),
    ("models", "each detector's step(luma) returns a response, or None while it warms up"),
    ("motion", "optical flow, RMO and growth"),
    ("detection", "alarms, places and times to contact, from the frames so far"),
    ("results", "one record per frame, one row per record"),
    ("files", "rows reach the part file, which is renamed at the end"),
)

_WIDE, _HIGH = 176, 40  # of a box
_STEP_X, _STEP_Y = 206, 74
_MARGIN = 100  # left of the boxes, for the names of the layers
_BOTTOM = "ground"
_STYLE = """
text { font: 13px sans-serif; fill: #222 } .small { font-size: 11px; fill: #555 }
.room { fill: #fff; stroke: #555 } .layer { fill: #eef2f6 }
.arrow { fill: none; stroke: #8a97a5; stroke-width: 1.3; marker-end: url(#head) }
.badge { fill: #b5442b } .number { font-size: 11px; fill: #fff; text-anchor: middle }
"""


def _arrows(rooms: Graph) -> list[tuple[str, str]]:
    """Return the imports that do not follow from others, without imports of the bottom layer."""
    bottom = set(LAYERS[_BOTTOM])
    upper = {room: imported - bottom for room, imported in rooms.items() if room not in bottom}
    return [
        (room, other)
        for room, imported in upper.items()
        for other in sorted(imported)
        if not any(other in reachable(upper, between) for between in imported)
    ]


def _rows(rooms: Graph) -> list[tuple[str, list[str]]]:
    """Return the layer and the rooms of each row; a room stands below the rooms that import it."""
    rows = []
    for layer, names in LAYERS.items():
        waiting = [room for room in names if room in rooms]
        while waiting:
            imported = {other for room in waiting for other in rooms[room] if layer != _BOTTOM}
            row = [room for room in waiting if room not in imported]
            rows.append((layer, row))
            waiting = [room for room in waiting if room not in row]
    return rows


def svg(root: Path) -> str:
    """Return the picture of a checkout as SVG."""
    rooms = room_graph(root)
    rows = _rows(rooms)
    corners = {
        room: (_MARGIN + _STEP_X * _ROOMS[room][0], 20 + _STEP_Y * number)
        for number, (_, row) in enumerate(rows)
        for room in row
    }
    width = max(x for x, _ in corners.values()) + _WIDE + 20
    lowest = 20 + _STEP_Y * len(rows)
    height = lowest + 20 * len(_WAY) + 20
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}">',
        f"<style>{_STYLE}</style>",
        '<defs><marker id="head" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" '
        'markerHeight="7" orient="auto"><path d="M0 0 8 4 0 8z" fill="#8a97a5"/></marker></defs>',
        f'<rect width="{width}" height="{height}" fill="#fff"/>',
        *(_band(layer, rows, width) for layer in LAYERS),
        *(_arrow(corners[a], corners[b]) for a, b in _arrows(rooms)),
        *(_box(room, *corner) for room, corner in corners.items()),
    ]
    for number, (room, text) in enumerate(_WAY, 1):
        x, y = corners[room]
        line = lowest + 20 * number
        parts += [_badge(number, x, y), _badge(number, 24, line - 4)]
        parts.append(f'<text x="42" y="{line}"><tspan font-weight="bold">{room}</tspan>: '
                     f"{escape(text)}</text>")  # fmt: skip
    return "\n".join([*parts, "</svg>"]) + "\n"


def _band(layer: str, rows: list[tuple[str, list[str]]], width: int) -> str:
    """Return the coloured band behind a layer, with its name."""
    numbers = [number for number, (name, _) in enumerate(rows) if name == layer]
    top, high = 20 + _STEP_Y * numbers[0] - 10, _STEP_Y * len(numbers) - 14
    return (
        f'<rect class="layer" x="6" y="{top}" width="{width - 12}" height="{high}" rx="6"/>'
        f'<text class="small" x="16" y="{top + high // 2 + 4}">{layer}</text>'
    )


def _box(room: str, x: int, y: int) -> str:
    middle = x + _WIDE // 2
    return (
        f'<rect class="room" x="{x}" y="{y}" width="{_WIDE}" height="{_HIGH}" rx="4"/>'
        f'<text x="{middle}" y="{y + 17}" text-anchor="middle">{room}</text>'
        f'<text class="small" x="{middle}" y="{y + 32}" text-anchor="middle">'
        f"{escape(_ROOMS[room][1])}</text>"
    )


def _arrow(start: tuple[int, int], end: tuple[int, int]) -> str:
    x1, y1, x2, y2 = start[0] + _WIDE // 2, start[1] + _HIGH, end[0] + _WIDE // 2, end[1]
    bend = (y2 - y1) // 2
    return f'<path class="arrow" d="M{x1} {y1}C{x1} {y1 + bend} {x2} {y2 - bend} {x2} {y2}"/>'


def _badge(number: int, x: int, y: int) -> str:
    return (
        f'<circle class="badge" cx="{x}" cy="{y}" r="9"/>'
        f'<text class="number" x="{x}" y="{y + 4}">{number}</text>'
    )


if __name__ == "__main__":
    PICTURE.write_text(svg(ROOT), encoding="utf-8")
