"""Write the pages and files that follow from the stimuli: gallery, key reference, JSON Schema.

Run from the top of the source tree: ``python docs/generate_gallery.py``.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

from oppload_cli import stimulus
from oppload_cli.schema import REQUIRED
from oppload_cli.stimulus.courses import Course
from oppload_cli.stimulus.files import contact_sheet, sheet_frames
from oppload_cli.stimulus.objects import Brightness, Growth, Motion, Object
from oppload_cli.stimulus.protocol_tables import Camera, Display, Effects, Scene, Timing
from oppload_cli.video.writers import png_bytes

if TYPE_CHECKING:
    from oppload_cli.schema import DeclaredTable, Parameter
    from oppload_cli.stimulus import Entry

ROOT = Path(__file__).resolve().parents[1]
PICTURES = ROOT / "docs" / "gallery"
GROUPS = {
    "opplod2023": "The OppLoD paper",
    "klapoetke2017": "Klapoetke et al. 2017",
    "controls": "Controls",
    "staged": "Staged approaches",
}
SHOWN = 6
SECTIONS: dict[str, type[DeclaredTable]] = {
    "`[display]`": Display,
    "`[timing]`": Timing,
    "`[[object]]`": Object,
    "`[object.growth]`": Growth,
    "[object.motion] and [scene.motion]": Motion,
    "`[object.brightness]`": Brightness,
    "`[scene]`": Scene,
    "`[camera]`": Camera,
    "`[object.course]`": Course,
    "`[effects]`": Effects,
}


def strip(entry: Entry) -> bytes:
    """Return frames of one stimulus of an entry side by side, as a PNG file."""
    protocols = entry.protocols()
    # of a sweep, one from the middle: the first often shows least
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
        f"The catalogue holds {total} stimuli in {len(entries)} protocols. Each picture shows "
        "evenly spaced frames of a stimulus, from the first to the last; `oppload stimuli generate "
        "NAME --preview` makes such a picture beside the video. [Stimuli](stimuli.md) describes "
        "how to use them.\n",
    ]
    for group, title in GROUPS.items():
        parts.append(f"## {title}\n")
        parts += [section(entry) for entry in entries if entry.name.startswith(f"{group}/")]
    return "\n".join(parts)


def reference() -> str:
    """Return the reference of all keys: a Markdown table for each table of a protocol."""
    parts = []
    for title, table in SECTIONS.items():
        head = (f"## {title}", "", "| key | value | default | meaning |", "|---|---|---|---|")
        parts.append("\n".join([*head, *(reference_row(each) for each in table.declared())]))
    return "\n\n".join(parts) + "\n"


def reference_row(each: Parameter) -> str:
    """Return the row of one key."""
    unit = f", {each.unit}" if each.unit else ""
    bounds = (("≥", each.low), (">", each.above), ("≤", each.high))
    limits = "".join(f", {sign} {bound:g}" for sign, bound in bounds if bound is not None)
    value = " / ".join(f"`{one}`" for one in each.choices) or each.words
    only = f" ({', '.join(each.kinds)} only)" if each.kinds else ""
    meaning = f"{each.meaning}{only}"
    return f"| `{each.name}` | {value}{unit}{limits} | {shown(each.default)} | {meaning} |"


def shown(default: object) -> str:
    """Return a default as TOML writes it."""
    if default is REQUIRED:
        return "**required**"
    if default is None or default == ():
        return ""
    if isinstance(default, bool):
        return f"`{str(default).lower()}`"
    if isinstance(default, tuple):
        return f"`{list(default)}`"
    return f"`{default:g}`" if isinstance(default, float) else f"`{default}`"


def page_of_keys() -> str:
    """Return the page with the reference of all keys as Markdown."""
    return (
        "# Keys of a stimulus\n\nAt the top of [a protocol](stimuli.md#your-own-protocol): "
        "`description`, `source` (texts), `tags` (list of texts), `seed` (whole number, default "
        f"0).\n\n{reference()}"
    )


def main() -> None:
    """Write everything."""
    PICTURES.mkdir(exist_ok=True)
    for old in PICTURES.glob("*.png"):
        old.unlink()
    for entry in stimulus.entries():
        (PICTURES / f"{stimulus.file_stem(entry.name)}.png").write_bytes(strip(entry))
    (ROOT / "docs" / "gallery.md").write_text(gallery_page(), encoding="utf-8")
    (ROOT / "docs" / "stimulus-keys.md").write_text(page_of_keys(), encoding="utf-8")
    schema = json.dumps(stimulus.json_schema(), indent=1, ensure_ascii=False) + "\n"
    (ROOT / "stimuli" / "stimulus.schema.json").write_text(schema, encoding="utf-8")


if __name__ == "__main__":
    main()
