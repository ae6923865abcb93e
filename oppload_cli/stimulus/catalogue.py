"""The catalogue: protocols found by name, by pattern or by file, and their sweeps."""

from __future__ import annotations

import fnmatch
import itertools
import json
import math
import re
import tomllib
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

from oppload_cli.errors import ParameterError, StimulusError, suggestion
from oppload_cli.files.reading import reading, text_of
from oppload_cli.stimulus.protocol import Protocol
from oppload_cli.stimulus.tables import SURROUNDINGS
from oppload_cli.stimulus.words import WORDS, key_of, value_at

_TABLES = ("display", "timing", "scene", "camera", "effects")
_PAIRS = (("pixels_per_degree", "field_of_view_deg"), ("file", "drawing"))
# By key: the one that stands in its place.
_EITHER = {one: other for pair in _PAIRS for one, other in (pair, pair[::-1])}
_MOST_MEMBERS = 10_000
_LONGEST = 80  # characters of a value in a message
_DEEPEST = 20  # dots in a swept key


@dataclass(frozen=True)
class Entry:
    """One TOML file: a protocol, or a family of them where it holds a sweep.

    Attributes
    ----------
    name : str
        ``group/name`` in the catalogue, the file's stem for a user's own file.
    path : Path
        The file.
    table : dict
        The contents of the file, settings applied and the sweep taken out.
    sweep : dict
        Values by dotted key.
    only : str
        A pattern that picks some members; ``*`` for all.
    changes : dict
        The values that differ from the file, by dotted key.
    """

    name: str
    path: Path
    table: dict[str, Any]
    sweep: dict[str, list[Any]]
    only: str = "*"
    changes: dict[str, Any] = field(default_factory=dict)

    @property
    def label(self) -> str:
        """The words for it in messages: the file, or the name and the changes, if any."""
        return f"{self.name} with {_listed(self.changes)}" if self.changes else str(self.path)

    @property
    def description(self) -> str:
        """The content of the stimulus in one line."""
        return str(self.table.get("description", ""))

    @property
    def source(self) -> str:
        """Its publication or its purpose."""
        return str(self.table.get("source", ""))

    @property
    def tags(self) -> list[str]:
        """Words to search for."""
        tags = self.table.get("tags", [])
        return [str(tag) for tag in tags] if isinstance(tags, list) else []

    def values(self) -> dict[str, dict[str, Any]]:
        """Return the swept values by dotted key of each member, by the member's name.

        Raises
        ------
        StimulusError
            If two values of a key have one name.
        """
        for dotted, several in self.sweep.items():
            if len({_text(value) for value in several}) < len(several):
                raise StimulusError(
                    f"{self.label}: sweep: two values of {dotted} have one name; make them differ "
                    "more"
                )
        named = {}
        for chosen in itertools.product(*self.sweep.values()):
            values = dict(zip(self.sweep, chosen, strict=True))
            name = f"{self.name}/{_label_of(values)}" if values else self.name
            if fnmatch.fnmatchcase(name, self.only):
                named[name] = values
        return named

    def protocols(self) -> list[Protocol]:
        """Return a protocol for each combination of the sweep's values, at least one.

        Raises
        ------
        StimulusError
            If it is not a valid protocol; the message names the key, and the file or the changes.
        """
        made = []
        for name, values in self.values().items():
            table = self.table
            for dotted, value in values.items():
                table = _with_value(table, dotted, value, f"{self.path}: sweep")
            made.append(Protocol.from_table({**table, "name": name}, self.label))
        return made

    def with_settings(self, settings: dict[str, Any]) -> Entry:
        """Return a copy with some values changed.

        Parameters
        ----------
        settings : dict
            Values by dotted key, e.g. ``{"bar.axis_deg": 45}``, or by a word such as ``l/v``; a
            swept key is then swept over this value only, or over a list of values. Of two keys of
            which a protocol has only one, the one that is given replaces that of the file.

        Raises
        ------
        StimulusError
            If a key names no table or object of the file.
        """
        table, sweep, only = self.table, dict(self.sweep), self.only
        settings = self.in_full(settings)
        for dotted, value in settings.items():
            other = _instead_of(dotted)
            if other and other not in settings:
                table, _ = _without(table, other), sweep.pop(other, None)
            if dotted in sweep:
                several = isinstance(value, list) and not isinstance(sweep[dotted][0], list)
                sweep[dotted] = value if several and value else [value]
                only = "*"
            else:
                table = _with_value(table, dotted, value, f"{self.name}: --change {dotted}")
        changes = {**self.changes, **settings}
        return replace(self, table=table, sweep=sweep, only=only, changes=changes)

    def in_full(self, settings: dict[str, Any]) -> dict[str, Any]:
        """Return values by dotted key where some are given by a word such as ``l/v``.

        Raises
        ------
        StimulusError
            If a word means no key of this stimulus, or several.
        """
        try:
            return {
                key_of(word, self.name, self.table, self.sweep, "--change")
                if word in WORDS
                else word: value
                for word, value in settings.items()
            }
        except ParameterError as error:
            raise StimulusError(str(error)) from None

    def telling_changes(self) -> Entry:
        """Return a copy whose description names the changed values, as it may not fit them."""
        if not self.changes or "description" in self.changes:
            return self
        told = f"{self.description} (changed: {_listed(self.changes)})".lstrip()
        return replace(self, table={**self.table, "description": told})

    def held(self, dotted: str) -> object:
        """Return the value of a dotted key, the list of a swept one, or None without any."""
        return self.sweep.get(dotted, value_at(self.table, dotted))


def catalogue_directory() -> Path:
    """Return the folder of the catalogue.

    In an installed wheel it is inside the package, otherwise at the top of the source tree.

    Raises
    ------
    StimulusError
        If it is in neither place.
    """
    package = Path(__file__).resolve().parents[1]
    for place in (package / "stimuli", package.parent / "stimuli"):
        if place.is_dir():
            return place
    raise StimulusError(f"the catalogue is not in {package / 'stimuli'}; install oppload again")


@cache
def entries() -> tuple[Entry, ...]:
    """Return all entries of the catalogue, sorted by name."""
    root = catalogue_directory()
    return tuple(
        read_entry(path, path.relative_to(root).with_suffix("").as_posix())
        for path in sorted(root.rglob("*.toml"))
    )


def read_entry(path: Path, name: str | None = None) -> Entry:
    """Read a protocol file without resolving it.

    Parameters
    ----------
    path : Path
        A TOML file.
    name : str or None
        Name of the entry; the file's stem where None.

    Raises
    ------
    StimulusError
        If it cannot be read, is not TOML, or its sweep is not valid.
    """
    with reading(path, StimulusError, form="TOML"):
        table = _beside(tomllib.loads(text_of(path, pipes=True)), path.parent)
    table.pop("name", None)
    sweep = _sweep_of(table.pop("sweep", {}), str(path))
    return Entry(name or path.stem, path, table, sweep)


def _beside(table: dict[str, Any], folder: Path) -> dict[str, Any]:
    """Look for the files that a protocol names in the folder of the protocol."""

    def there(key: str, value: object) -> object:
        own = isinstance(value, str) and value and "\0" not in value
        if isinstance(value, list):
            return [there(key, one) for one in value]
        if not own or (key == "background" and value in SURROUNDINGS):
            return value
        return str(folder / str(value))

    def changed(part: object) -> object:
        if isinstance(part, list):
            return [changed(one) for one in part]
        if not isinstance(part, dict):
            return part
        return {
            key: there(key.rpartition(".")[2], value)
            if key.rpartition(".")[2] == "file" or key in {"background", "scene.background"}
            else changed(value)
            for key, value in part.items()
        }

    return {
        key: changed(value) if key in {"scene", "object", "sweep"} else value
        for key, value in table.items()
    }


def find(wanted: str) -> list[Entry]:
    """Find protocols.

    Parameters
    ----------
    wanted : str
        A TOML file, one of its members (``FILE.toml/MEMBER``), an entry's or a member's name, the
        last parts of one, a fragment that only one has, or a pattern with ``*``, ``?``, ``[]``.

    Returns
    -------
    list of Entry
        At least one; with ``only`` set where members were named.

    Raises
    ------
    StimulusError
        If there is no such file or entry, or several; the message suggests the nearest name, or
        names all of them.
    """
    file, is_file, member = wanted.partition(".toml")
    if is_file and (not member or member.startswith("/")):
        return [_of_file(read_entry(Path(file + is_file)), member)]
    known = entries()
    exact = [entry for entry in known if entry.name == wanted]
    if exact:
        return exact
    found = []
    for entry in known:
        if fnmatch.fnmatchcase(entry.name, wanted):
            found.append(entry)
        elif entry.sweep and any(fnmatch.fnmatchcase(name, wanted) for name in entry.values()):
            found.append(replace(entry, only=wanted))
    if not found:
        found = _by_part(wanted, known)
    if not found:
        raise StimulusError(f"no stimulus '{wanted}' in the catalogue; {_hint(wanted, known)}")
    return found


def _hint(wanted: str, known: tuple[Entry, ...]) -> str:
    """Return the words that help after a name that is no stimulus."""
    own, _, member = wanted.partition("/")
    if member and Path(f"{own}.toml").is_file():
        return f"did you mean '{own}.toml/{member}'?"
    names = {entry.name for entry in known}
    if any(name.startswith(f"{wanted}/") for name in names):
        return f"did you mean '{wanted}/*'?"
    near = {name for entry in known for name in entry.values()} | names
    hint = suggestion(wanted, near | {name.rpartition("/")[2] for name in names})
    if "did you mean" in hint:
        return hint.removeprefix("; ")
    return "see 'oppload stimuli list', or give FILE.toml or FILE.toml/MEMBER"


def _of_file(entry: Entry, member: str) -> Entry:
    """Return the entry of a file, or some of its members: of ``/MEMBER``, a name or a pattern."""
    chosen = replace(entry, only=entry.name + member) if member else entry
    if not chosen.values():
        known = [f"{entry.path}{name.removeprefix(entry.name)}" for name in entry.values()]
        hint = suggestion(f"{entry.path}{member}", known)
        raise StimulusError(f"{entry.path}: has no member '{member[1:]}'{hint}")
    return chosen


def _by_part(wanted: str, known: tuple[Entry, ...]) -> list[Entry]:
    """Return the only entry or member whose name ends with a text, or else the only one with it.

    Raises
    ------
    StimulusError
        If there are several.
    """
    entry_of = {entry.name: entry for entry in known}
    if any(name.startswith(f"{wanted}/") for name in entry_of):  # a folder
        return []
    member_of = {name: entry for entry in known if entry.sweep for name in entry.values()}
    for names in (entry_of, member_of):
        for fits in (lambda name: name.endswith(f"/{wanted}"), lambda name: wanted in name):
            near = sorted(filter(fits, names))
            if len(near) == 1:
                entry = names[near[0]]
                return [entry if near[0] == entry.name else replace(entry, only=near[0])]
            if near and wanted:
                more = f" and {len(near) - 3} more" if len(near) > 3 else ""
                raise StimulusError(
                    f"'{wanted}' could be {', '.join(near[:3])}{more}; write more of the name"
                )
    return []


def load(wanted: str | Path, settings: dict[str, Any] | None = None) -> Protocol:
    """Load one protocol.

    Parameters
    ----------
    wanted : str or Path
        A TOML file, or a name of the catalogue.
    settings : dict or None
        Values to change, by dotted key.

    Raises
    ------
    StimulusError
        If there is no such stimulus, or more than one.
    """
    protocols = load_all(wanted, settings)
    if len(protocols) > 1:
        raise StimulusError(
            f"'{wanted}' is {len(protocols)} stimuli; name one of them, such as "
            f"'{protocols[0].name}', or use load_all"
        )
    return protocols[0]


def load_all(wanted: str | Path, settings: dict[str, Any] | None = None) -> list[Protocol]:
    """Load every protocol that a name, a pattern or a file stands for.

    Parameters
    ----------
    wanted : str or Path
        A TOML file, a name of the catalogue, or a pattern.
    settings : dict or None
        Values to change, by dotted key.

    Returns
    -------
    list of Protocol
        At least one.

    Raises
    ------
    StimulusError
        If there is no such stimulus, or if one is not valid.
    """
    found = [read_entry(wanted)] if isinstance(wanted, Path) else find(wanted)
    changed = [entry.with_settings(settings or {}).telling_changes() for entry in found]
    return [protocol for entry in changed for protocol in entry.protocols()]


def parsed_setting(text: str) -> tuple[str, Any]:
    """Read ``key=value`` from a command line.

    Parameters
    ----------
    text : str
        The value as in TOML; a value that is not TOML is taken as a text.

    Returns
    -------
    str
        The key.
    object
        The value.

    Raises
    ------
    StimulusError
        If there is no ``=``.
    """
    name, equals, value = text.partition("=")
    if not equals or not name.strip():
        raise StimulusError(f"--change takes key=value, not '{text}'; e.g. display.frame_rate=60")
    try:
        return name.strip(), tomllib.loads(f"value = {value}")["value"]
    except ValueError:
        return name.strip(), value.strip()


def _sweep_of(table: object, where: str, prefix: str = "") -> dict[str, list[Any]]:
    """Flatten a ``[sweep]`` table to lists of values by dotted key."""
    if not isinstance(table, dict):
        raise StimulusError(f"{where}: sweep must be a table of lists, not {table!r}")
    if prefix.count(".") > _DEEPEST:
        raise StimulusError(f"{where}: sweep is nested too deep; write keys such as bar.axis_deg")
    flat: dict[str, list[Any]] = {}
    for key, value in table.items():
        name = f"{prefix}{key}"
        if isinstance(value, dict):
            flat.update(_sweep_of(value, where, f"{name}."))
        elif not isinstance(value, list):
            raise StimulusError(f"{where}: sweep: {name} takes a list of values, not {value!r}")
        elif not value:
            raise StimulusError(f"{where}: sweep: {name} has no values; add some or remove it")
        else:
            flat[name] = value
    members = math.prod(len(values) for values in flat.values())
    if members > _MOST_MEMBERS:
        raise StimulusError(f"{where}: sweep makes {members} stimuli; the most is {_MOST_MEMBERS}")
    return flat


def in_toml(value: object) -> str:
    """Return a value of a protocol nearly as TOML has it, for a message; a long one is cut."""
    text = json.dumps(value, ensure_ascii=False, default=str)
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 3]}..."


def _listed(changes: dict[str, Any]) -> str:
    return ", ".join(f"{dotted} = {in_toml(value)}" for dotted, value in changes.items())


def _label_of(values: dict[str, Any]) -> str:
    """Part of a member's name that the others do not have, e.g. ``speed-20_width-10``."""
    leaves = [dotted.rpartition(".")[2] for dotted in values]
    names = leaves if len(set(leaves)) == len(leaves) else list(values)
    parts = [
        f"{_word(name)}-{_text(value)}" for name, value in zip(names, values.values(), strict=True)
    ]
    return "_".join(parts)


def _with_value(table: dict[str, Any], dotted: str, value: object, where: str) -> dict[str, Any]:
    """Copy a protocol's table and put in the value of ``seed``, ``ID.growth.speed_deg_s``, ..."""
    first, _, rest = dotted.partition(".")
    if first in _TABLES and rest:
        return {**table, first: _put(table.get(first, {}), rest, value, where)}
    if dotted in {"seed", "description", "source", "tags"}:
        return {**table, dotted: value}
    listed = table.get("object", [])
    objects = listed if isinstance(listed, list) else []
    ids = [str(one.get("id")) for one in objects if isinstance(one, dict)]
    if first not in ids or not rest:
        known = [*(f"{name}.KEY" for name in (*_TABLES, *ids)), "seed"]
        hint = suggestion(first, (*_TABLES, *ids, "seed")) if rest else ""
        hint = hint if "did you mean" in hint else f"; a key starts with {', '.join(known)}"
        raise StimulusError(f"{where}: no key '{dotted}'{hint}")
    changed = [
        _put(one, rest, value, where) if isinstance(one, dict) and one.get("id") == first else one
        for one in objects
    ]
    return {**table, "object": changed}


def _instead_of(dotted: str) -> str | None:
    """Return the key that a protocol must not have beside another one, if there is such a key."""
    owner, _, leaf = dotted.rpartition(".")
    return f"{owner}.{_EITHER[leaf]}" if leaf in _EITHER else None


def _without(table: dict[str, Any], dotted: str) -> dict[str, Any]:
    """Copy a protocol's table without a key of one of its tables or objects."""
    first, _, leaf = dotted.partition(".")

    def cut(part: Any) -> Any:
        return {key: value for key, value in part.items() if key != leaf}

    if isinstance(table.get(first), dict):
        return {**table, first: cut(table[first])}
    listed = table.get("object", [])
    if not isinstance(listed, list):
        return table
    kept = [cut(one) if isinstance(one, dict) and one.get("id") == first else one for one in listed]
    return {**table, "object": kept}


def _put(table: object, dotted: str, value: object, where: str) -> dict[str, Any]:
    if not isinstance(table, dict):
        raise StimulusError(f"{where}: '{dotted}' is within {table!r}, which is not a table")
    first, _, rest = dotted.partition(".")
    return {**table, first: _put(table.get(first, {}), rest, value, where) if rest else value}


def _word(name: str) -> str:
    """Take the unit off a key: ``speed_deg_s`` becomes ``speed``."""
    plain = re.sub(r"(_px)?(_deg_s|_deg|_ms|_s|_hz|_per_s)$", "", name)
    return re.sub(r"[._]+", "-", plain)


def _text(value: object) -> str:
    if isinstance(value, list):
        return "x".join(_text(one) for one in value)
    if isinstance(value, float):
        return f"{value:g}"
    return re.sub(r"[^A-Za-z0-9.+-]+", "-", str(value).lower())
