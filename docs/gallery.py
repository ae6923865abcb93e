"""Make what follows from the stimuli: the gallery, the key reference, the JSON Schema.

Run from the top of the source tree: ``python docs/gallery.py``.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

from oppload_cli import stimulus
from oppload_cli.stimulus.schema import json_schema, reference
from oppload_cli.stimulus.sheet import contact_sheet, sheet_frames
from oppload_cli.video.archive import png_bytes

if TYPE_CHECKING:
    from oppload_cli.stimulus import Entry

ROOT = Path(__file__).resolve().parents[1]
PICTURES = ROOT / "docs" / "gallery"
START, END = "<!-- keys: start -->", "<!-- keys: end -->"
GROUPS = {
    "opplod2023": "The OppLoD paper",
    "klapoetke2017": "Klapoetke et al. 2017",
    "controls": "Controls",
}
SHOWN = 6


def strip(entry: Entry) -> bytes:
    """Return frames of one stimulus of an entry side by side, as a PNG file."""
    protocols = entry.protocols()
    # of a sweep, one from the middle: the first is often the least telling
    renderer = stimulus.Renderer(protocols[len(protocols) // 3])
    chosen = sheet_frames(renderer.protocol.frame_count, SHOWN)
    pictures = [renderer.grey(frame) for frame in chosen]
    return png_bytes(contact_sheet(pictures, side=80, columns=SHOWN))


def section(entry: Entry) -> str:
    """Return an entry's part of the page."""
    members = list(entry.values())
    shown = members[len(members) // 3]
    several = f" {len(members)} stimuli, such as `{shown}`." if len(members) > 1 else ""
    return (
        f"### `{entry.name}`\n\n{entry.description}.{several}\n\n"
        f"![{entry.name}](gallery/{stimulus.file_stem(entry.name)}.png)\n\n"
        f"Source: {entry.source}.\n"
    )


def gallery_page() -> str:
    """Return the gallery as Markdown."""
    entries = stimulus.entries()
    total = sum(len(entry.values()) for entry in entries)
    parts = [
        "# Gallery of stimuli\n",
        f"{len(entries)} protocols, {total} stimuli. Each picture shows evenly spaced frames, "
        "from the first to the last.\nThis page is made by `python docs/gallery.py`; how to use "
        "the stimuli stands in [stimuli.md](stimuli.md).\n",
    ]
    for group, title in GROUPS.items():
        parts.append(f"## {title}\n")
        parts += [section(entry) for entry in entries if entry.name.startswith(f"{group}/")]
    return "\n".join(parts)


def main() -> None:
    """Write everything."""
    PICTURES.mkdir(exist_ok=True)
    for old in PICTURES.glob("*.png"):
        old.unlink()
    for entry in stimulus.entries():
        (PICTURES / f"{stimulus.file_stem(entry.name)}.png").write_bytes(strip(entry))
    (ROOT / "docs" / "gallery.md").write_text(gallery_page(), encoding="utf-8")
    page = ROOT / "docs" / "stimuli.md"
    text = page.read_text(encoding="utf-8")
    before, after = text.split(START)[0], text.split(END)[1]
    page.write_text(f"{before}{START}\n\n{reference()}\n{END}{after}", encoding="utf-8")
    schema = json.dumps(json_schema(), indent=1, ensure_ascii=False) + "\n"
    (ROOT / "stimuli" / "stimulus.schema.json").write_text(schema, encoding="utf-8")


if __name__ == "__main__":
    main()
