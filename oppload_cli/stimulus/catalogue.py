"""The catalogue: protocols found by name, by pattern or by file, and their sweeps."""

from __future__ import annotations

import fnmatch
import glob
import itertools
import json
import math
import os
import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from oppload_cli.errors import ParameterError, StimulusError, nearest, suggestion
from oppload_cli.files.reading import is_file, path_of, reading, text_of
from oppload_cli.stimulus.protocol import Protocol
from oppload_cli.stimulus.protocol_tables import (
    SURROUNDINGS,
    WORDS,
    excluded_by,
    key_of,
    value_at,
    with_value,
    without,
)

if TYPE_CHECKING:
    from collections.abc import Iterable

_MOST_MEMBERS = 10_000


@dataclass(frozen=True)
class Entry:
    """One TOML file: a protocol, or a family of protocols (members) if it has a sweep.

    Attributes
    ----------
    name : str
        ``group/name`` in the catalogue; for a user's own file, its name without ``.toml``.
    path : Path
        The file.
    table : dict
        The contents of the file with all changes, but without the sweep.
    sweep : dict
        Lists of values by dotted key.
    only : str
        A pattern for the names of the wanted members; ``*`` for all.
    changes : dict
        The values that differ from the file, by dotted key.
    """

    name: str
    path: Path
    table: dict[str, Any] = field(repr=False)  # so that a list of all entries can be read
    sweep: dict[str, list[Any]]
    only: str = "*"
    changes: dict[str, Any] = field(default_factory=dict)

    @property
    def label(self) -> str:
        """The entry in messages: its file, or its name and its changes, if any."""
        return f"{self.name} with {_listed(self.changes)}" if self.changes else str(self.path)

    @property
    def description(self) -> str:
        """The content of the stimulus in one line."""
        return str(self.table.get("description", ""))

    @property
    def source(self) -> str:
        """The publication or the purpose of the stimulus."""
        return str(self.table.get("source", ""))

    @property
    def tags(self) -> list[str]:
        """Words to search for."""
        tags = self.table.get("tags", [])
        return [str(tag) for tag in tags] if isinstance(tags, list) else []

    def values(self) -> dict[str, dict[str, Any]]:
        """Return the swept values of each member: by the member's name, then by dotted key.

        Raises
        ------
        StimulusError
            If two values of a key give members of the same name.
        """
        for dotted, values in self.sweep.items():
            if len({_in_name(value) for value in values}) < len(values):
                raise StimulusError(
                    f"{self.label}: sweep: two values of {dotted} give stimuli of the same name; "
                    "make them differ more"
                )
        members = {}
        for combination in itertools.product(*self.sweep.values()):
            chosen = dict(zip(self.sweep, combination, strict=True))
            name = f"{self.name}/{_name_of_member(chosen)}" if chosen else self.name
            if fnmatch.fnmatchcase(name, self.only):
                members[name] = chosen
        return members

    def protocols(self) -> list[Protocol]:
        """Return the protocol of each member, at least one.

        Raises
        ------
        StimulusError
            If a protocol is not valid; the message names the key, and the file or the changes.
        """
        protocols = []
        for name, values in self.values().items():
            table = self.table
            for dotted, value in values.items():
                table = with_value(table, dotted, value, f"{self.path}: sweep")
            # A changed key that is swept has another value in each member.
            changes = self.changes | {key: values[key] for key in self.changes if key in values}
            where = replace(self, changes=changes).label
            protocols.append(Protocol.from_table({**table, "name": name}, where))
        return protocols

    def with_settings(self, settings: dict[str, Any], option: str = "--change") -> Entry:
        """Return a copy with some values changed.

        Parameters
        ----------
        settings : dict
            Values by dotted key, e.g. ``{"bar.axis_deg": 45}``, or by a word such as ``l/v``. For
            a swept key, the value or list of values replaces the values of the sweep. A key that
            excludes a key of the file (``pixels_per_degree`` and ``field_of_view_deg``) replaces
            this key. Other swept keys keep the values of the wanted members.
        option : str
            The user's option that has the settings, for messages.

        Raises
        ------
        StimulusError
            If a key names no table or object of the file, or if a word means no key or several.
        """
        table, sweep, only = self.table, dict(self.sweep), self.only
        settings = self.in_full(settings, option)
        excluded = {dotted: excluded_by(dotted) for dotted in settings}
        # The names of members change, so that `only` would select none.
        if sweep.keys() & {*settings, *excluded.values()}:
            sweep, only = self._swept_by_members(), "*"
        for dotted, value in settings.items():
            replaced = excluded[dotted]
            if replaced and replaced not in settings:
                table = without(table, replaced)
                sweep.pop(replaced, None)
            if dotted in sweep:
                several = _depth(value) > _depth(sweep[dotted][0])
                sweep[dotted] = value if several else [value]
            else:
                table = with_value(table, dotted, value, f"{self.name}: {option} {dotted}", WORDS)
        changes = {**self.changes, **settings}
        return replace(self, table=table, sweep=sweep, only=only, changes=changes)

    def _swept_by_members(self) -> dict[str, list[Any]]:
        """Return the sweep with the values of the wanted members alone."""
        members = self.values().values()
        return {
            dotted: [
                value for value in values if any(member[dotted] == value for member in members)
            ]
            for dotted, values in self.sweep.items()
        }

    def in_full(self, settings: dict[str, Any], option: str = "--change") -> dict[str, Any]:
        """Return settings by dotted key; a word such as ``l/v`` becomes the key that it means.

        `option` is the user's option that has the settings, for messages.

        Raises
        ------
        StimulusError
            If a word means no key of this stimulus, or several.
        """
        facts = self.name, self.table, self.sweep, option
        try:
            keys = [key_of(word, *facts) if word in WORDS else word for word in settings]
        except ParameterError as error:
            raise StimulusError(str(error)) from None
        return dict(zip(keys, settings.values(), strict=True))

    def with_changes_described(self) -> Entry:
        """Return a copy whose description, which the changes may contradict, lists the changes."""
        if not self.changes or "description" in self.changes:
            return self
        description = f"{self.description} (changed: {_listed(self.changes)})".lstrip()
        return replace(self, table={**self.table, "description": description})

    def value_of(self, dotted: str) -> object:
        """Return the value of a dotted key, the list of values of a swept key, or None."""
        return self.sweep.get(dotted, value_at(self.table, dotted))


def catalogue_directory() -> Path:
    """Return the folder of the catalogue: inside an installed package, or beside it in a checkout.

    Raises
    ------
    StimulusError
        If there is no such folder.
    """
    package = Path(__file__).resolve().parents[1]
    for folder in (package / "stimuli", package.parent / "stimuli"):
        if folder.is_dir():
            return folder
    raise StimulusError(f"the catalogue is not in {package / 'stimuli'}; install oppload again")


@cache
def entries() -> tuple[Entry, ...]:
    """Return all entries of the catalogue, sorted by name.

    Examples
    --------
    >>> from oppload_cli import stimulus
    >>> [entry.name for entry in stimulus.entries() if entry.name.endswith("-ring")]
    ['controls/looming-ring']
    """
    root = catalogue_directory()
    return tuple(
        read_entry(path, path.relative_to(root).with_suffix("").as_posix())
        for path in sorted(root.rglob("*.toml"))
    )


def read_entry(path: str | Path, name: str | None = None) -> Entry:
    """Read a protocol file without checking its protocols.

    Parameters
    ----------
    path : str or Path
        A TOML file.
    name : str or None
        Name of the entry; None for the file's name without ``.toml``.

    Raises
    ------
    StimulusError
        If the file cannot be read or is not TOML, or if its sweep is not valid.
    """
    path = path_of(path, "path")
    with reading(path, StimulusError, form="TOML"):
        table = {
            key: _with_paths(value, path.parent) if key in {"scene", "object", "sweep"} else value
            for key, value in tomllib.loads(text_of(path, pipes=True)).items()
        }
    table.pop("name", None)
    sweep = _sweep_of(table.pop("sweep", {}), str(path))
    return Entry(name or path.stem, path, table, sweep)


def _with_paths(part: Any, folder: Path, key: str = "") -> Any:
    """Return a part of a protocol in which the names of files are paths that start at a folder."""
    if isinstance(part, dict):
        return {name: _with_paths(value, folder, name) for name, value in part.items()}
    if isinstance(part, list):
        return [_with_paths(one, folder, key) for one in part]
    background = key in {"background", "scene.background"} and part not in SURROUNDINGS
    if not background and key.rpartition(".")[2] != "file":
        return part
    return str(folder / part) if isinstance(part, str) and part else part


def find(wanted: str) -> list[Entry]:
    """Find protocols.

    Parameters
    ----------
    wanted : str
        A TOML file, a member of a file (``FILE.toml/MEMBER``), the name of an entry or a member,
        the last parts of a name, a part that only one name has, or a pattern with ``*``, ``?`` or
        ``[]``.

    Returns
    -------
    list of Entry
        At least one. If `wanted` names members, the attribute ``only`` of an entry selects them.

    Raises
    ------
    StimulusError
        If no name fits (the message suggests the nearest one), or if part of a name fits several.
    """
    if not isinstance(wanted, str):
        raise StimulusError(f"a stimulus must be a name or a path, not {wanted!r:.60}")
    file, toml, member = wanted.rpartition(".toml")
    member = member.replace(os.sep, "/")  # Windows completes a path with its own separators
    if toml and (not member or member.startswith("/")):
        return [_members_of_file(read_entry(Path(file + toml)), member)]
    exact = [entry for entry in entries() if entry.name == wanted]
    if exact:
        return exact
    matching = []
    for entry in entries():
        if fnmatch.fnmatchcase(entry.name, wanted):
            matching.append(entry)
        elif entry.sweep and any(fnmatch.fnmatchcase(name, wanted) for name in entry.values()):
            matching.append(replace(entry, only=wanted))
    matching = matching or _by_part(wanted)
    if not matching:
        raise StimulusError(f"no stimulus '{wanted}' in the catalogue; {_hint(wanted)}")
    return matching


def _hint(wanted: str) -> str:
    """Return the advice for a name that is not the name of a stimulus."""
    stem, _, member = wanted.partition("/")
    if member and is_file(f"{stem}.toml"):
        return f"did you mean '{stem}.toml/{member}'?"
    if any(entry.name.startswith(f"{wanted}/") for entry in entries()):
        return f"did you mean '{wanted}/*'?"
    short = {entry.name.rpartition("/")[2] for entry in entries()}
    if similar := nearest(wanted, short | _names()):
        return f"did you mean '{similar}'?"
    return "see 'oppload stimuli list', or give FILE.toml or FILE.toml/MEMBER"


def _names() -> set[str]:
    return {name for entry in entries() for name in (entry.name, *entry.values())}


def meant_by(wanted: str) -> str:
    """Return the stimulus that may be meant by the name of an input that does not exist.

    The text is empty if none is like the name, or if the name is that of a file, camera or stream.
    """
    if not re.fullmatch(r"[\w/+-]+(\.\d[\w/+-]*)*", wanted):
        return ""
    try:
        return find(wanted)[0].name
    except StimulusError:
        return nearest(wanted, _names())


def _members_of_file(entry: Entry, member: str) -> Entry:
    """Return the entry of a file, or its members whose names fit ``/MEMBER``, maybe a pattern."""
    chosen = replace(entry, only=glob.escape(entry.name) + member) if member else entry
    if not chosen.values():
        known = [f"{entry.path}{name.removeprefix(entry.name)}" for name in entry.values()]
        hint = suggestion(f"{entry.path}{member}", known)
        raise StimulusError(f"{entry.path}: has no member '{member[1:]}'{hint}")
    return chosen


def _by_part(wanted: str) -> list[Entry]:
    """Return the only entry or member whose name ends with `wanted`, or else contains it.

    Raises StimulusError if there are several.
    """
    entry_of = {entry.name: entry for entry in entries()}
    if any(name.startswith(f"{wanted}/") for name in entry_of):  # a folder
        return []
    member_of = {name: entry for entry in entries() if entry.sweep for name in entry.values()}
    for names in (entry_of, member_of):
        ending = sorted(name for name in names if name.endswith(f"/{wanted}"))
        fitting = ending or sorted(name for name in names if len(wanted) > 2 and wanted in name)
        if len(fitting) == 1:
            entry = names[fitting[0]]
            return [entry if fitting[0] == entry.name else replace(entry, only=fitting[0])]
        if fitting:
            more = f" and {len(fitting) - 3} more" if len(fitting) > 3 else ""
            raise StimulusError(
                f"'{wanted}' could be {', '.join(fitting[:3])}{more}; write more of the name"
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
        If there is no such stimulus, or more than one, or if a value is not valid.

    Examples
    --------
    >>> from oppload_cli import stimulus
    >>> slow = stimulus.load("klapoetke2017/loom-l-over-v", {"disk.growth.l_over_v_ms": 80})
    >>> slow.objects[0].growth.l_over_v_ms, slow.frame_count
    (80.0, 72)
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

    Examples
    --------
    >>> from oppload_cli import stimulus
    >>> [protocol.name for protocol in stimulus.load_all("controls/looming-square")]
    ['controls/looming-square/axis-0', 'controls/looming-square/axis-45']
    """
    if not isinstance(settings, Mapping | None):
        raise StimulusError(
            f"settings must be a dict, e.g. {{'display.frame_rate': 60}}, not {settings!r:.60}"
        )
    originals = [read_entry(wanted)] if isinstance(wanted, Path) else find(wanted)
    changed = [entry.with_settings(settings or {}, "settings") for entry in originals]
    return [
        protocol for entry in changed for protocol in entry.with_changes_described().protocols()
    ]


def parsed_settings(texts: Iterable[str]) -> dict[str, Any]:
    """Read texts ``key=value`` of a command line; a value that is not TOML is a text.

    Raises
    ------
    StimulusError
        If there is no ``=``, or if numbers with commas have no brackets.
    """
    settings: dict[str, Any] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        if not equals or not name.strip():
            raise StimulusError(
                f"--change takes key=value, not '{text}'; e.g. display.frame_rate=60"
            )
        try:
            settings[name.strip()] = tomllib.loads(f"value = {value}")["value"]
        except ValueError:
            # Numbers as --over takes them.
            if re.fullmatch(r"\s*[-+.\d]+\s*(,\s*[-+.\d]+\s*)+", value):
                raise StimulusError(
                    f"--change {text}: a list needs brackets; write '{name}=[{value}]'"
                ) from None
            settings[name.strip()] = value.strip()
    return settings


def _sweep_of(table: object, where: str, prefix: str = "") -> dict[str, list[Any]]:
    """Return the lists of values of a ``[sweep]`` table by dotted key."""
    if not isinstance(table, dict):
        raise StimulusError(f"{where}: sweep must be a table of lists, not {table!r}")
    if prefix.count(".") > 20:
        raise StimulusError(f"{where}: sweep is nested too deeply; write keys such as bar.axis_deg")
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


def _depth(value: object) -> int:
    """Return how many lists lie in one another: 0 for a number, 1 for a position."""
    return 1 + _depth(value[0]) if isinstance(value, list) and value else 0


def in_toml(value: object) -> str:
    """Return a value of a protocol for a message: similar to TOML, and at most 80 characters."""
    text = json.dumps(value, ensure_ascii=False, default=str)
    return text if len(text) <= 80 else f"{text[:77]}..."


def _listed(changes: dict[str, Any]) -> str:
    return ", ".join(f"{dotted} = {in_toml(value)}" for dotted, value in changes.items())


def _name_of_member(values: dict[str, Any]) -> str:
    """Return the last part of a member's name, such as ``speed-20_width-10``."""
    leaves = [dotted.rpartition(".")[2] for dotted in values]
    names = leaves if len(set(leaves)) == len(leaves) else list(values)
    pairs = zip(names, values.values(), strict=True)
    return "_".join(f"{_without_unit(name)}-{_in_name(value)}" for name, value in pairs)


def _without_unit(name: str) -> str:
    """Remove the unit from a key: ``speed_deg_s`` becomes ``speed``."""
    plain = re.sub(r"(_deg_s|_deg|_ms|_s|_hz|_per_s)$", "", name)
    return re.sub(r"[._]+", "-", plain)


def _in_name(value: object) -> str:
    if isinstance(value, list):
        return "x".join(_in_name(one) for one in value)
    if isinstance(value, float):
        return f"{value:g}"
    return re.sub(r"[^A-Za-z0-9.+-]+", "-", str(value).lower())
