"""The catalogue: finding protocols by name, by pattern or by file."""

from __future__ import annotations

import fnmatch
import tomllib
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

from oppload_cli.errors import StimulusError, suggestion
from oppload_cli.stimulus.protocol import Protocol
from oppload_cli.stimulus.sweep import expanded, label_of, sweep_of, with_value


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
        What it holds, the sweep and the settings applied to it taken out.
    sweep : dict
        Values by dotted key.
    only : str
        A pattern that picks some members; ``*`` for all.
    """

    name: str
    path: Path
    table: dict[str, Any]
    sweep: dict[str, list[Any]]
    only: str = "*"

    @property
    def description(self) -> str:
        """One line on what it shows."""
        return str(self.table.get("description", ""))

    @property
    def source(self) -> str:
        """Where it was published."""
        return str(self.table.get("source", ""))

    @property
    def tags(self) -> list[str]:
        """Words to find it by."""
        tags = self.table.get("tags", [])
        return [str(tag) for tag in tags] if isinstance(tags, list) else []

    def values(self) -> dict[str, dict[str, Any]]:
        """Return the values of each member.

        Returns
        -------
        dict of str to dict
            Swept values by dotted key, by the member's name.
        """
        named = {}
        for values in expanded(self.sweep):
            name = f"{self.name}/{label_of(values)}" if values else self.name
            if fnmatch.fnmatchcase(name, self.only):
                named[name] = values
        return named

    def protocols(self) -> list[Protocol]:
        """Return the members, resolved.

        Returns
        -------
        list of Protocol
            One, or one for each combination of the sweep's values.

        Raises
        ------
        StimulusError
            If the file is not a valid protocol; the message names the key and the file.
        """
        made = []
        for name, values in self.values().items():
            table = self.table
            for dotted, value in values.items():
                table = with_value(table, dotted, value, f"{self.path}: sweep")
            made.append(Protocol.from_table({**table, "name": name}, str(self.path)))
        return made

    def with_settings(self, settings: dict[str, Any]) -> Entry:
        """Return a copy with some values changed.

        Parameters
        ----------
        settings : dict
            Values by dotted key, e.g. ``{"bar.axis_deg": 45}``; a swept key is then swept
            over this value only, or over a list of values.

        Returns
        -------
        Entry

        Raises
        ------
        StimulusError
            If a key names no table or object of the file.
        """
        table, sweep, only = self.table, dict(self.sweep), self.only
        for dotted, value in settings.items():
            if dotted in sweep:
                several = isinstance(value, list) and not isinstance(sweep[dotted][0], list)
                sweep[dotted] = value if several and value else [value]
                only = "*"
            else:
                table = with_value(table, dotted, value, f"{self.path}: --set {dotted}")
        return replace(self, table=table, sweep=sweep, only=only)


def catalogue_directory() -> Path:
    """Return where the catalogue is.

    Returns
    -------
    Path
        In an installed wheel inside the package, otherwise at the top of the source tree.

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
    """Return all entries of the catalogue, by name.

    Returns
    -------
    tuple of Entry
    """
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
        Its name; the file's stem where None.

    Returns
    -------
    Entry

    Raises
    ------
    StimulusError
        If it cannot be read, is not TOML, or its sweep is not valid.
    """
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as problem:
        raise StimulusError(f"{path}: cannot read: {problem.strerror}; check the path") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as problem:
        raise StimulusError(f"{path}: not valid TOML: {problem}; correct the file") from None
    table.pop("name", None)
    sweep = sweep_of(table.pop("sweep", {}), str(path))
    return Entry(name or path.stem, path, table, sweep)


def find(wanted: str) -> list[Entry]:
    """Find protocols.

    Parameters
    ----------
    wanted : str
        A TOML file, an entry's or a member's name, or a pattern with ``*``, ``?``, ``[]``.

    Returns
    -------
    list of Entry
        At least one; with ``only`` set where members were named.

    Raises
    ------
    StimulusError
        If there is no such file or entry; the nearest name is suggested.
    """
    if wanted.endswith(".toml"):
        return [read_entry(Path(wanted))]
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
        names = {entry.name for entry in known}
        near = {name for entry in known for name in entry.values()} | names
        hint = suggestion(wanted, near)
        if any(name.startswith(f"{wanted}/") for name in names):
            hint = f"; did you mean '{wanted}/*'?"
        elif "did you mean" not in hint:
            hint = "; see 'oppload stimuli list', or give a .toml file"
        raise StimulusError(f"no stimulus '{wanted}' in the catalogue{hint}")
    return found


def load(wanted: str | Path, settings: dict[str, Any] | None = None) -> Protocol:
    """Load one protocol.

    Parameters
    ----------
    wanted : str or Path
        A TOML file, or a name of the catalogue.
    settings : dict or None
        Values to change, by dotted key.

    Returns
    -------
    Protocol

    Raises
    ------
    StimulusError
        If there is none such, or more than one.
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
        If there is none such, or if one is not valid.
    """
    found = [read_entry(wanted)] if isinstance(wanted, Path) else find(wanted)
    return [
        protocol for entry in found for protocol in entry.with_settings(settings or {}).protocols()
    ]
