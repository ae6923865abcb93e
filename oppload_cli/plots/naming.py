"""The names of results and tuning tables in figures, and the order of numbered names."""

from __future__ import annotations

import re
from itertools import takewhile
from typing import TYPE_CHECKING, Any

from oppload_cli.errors import ParameterError, counted
from oppload_cli.plots.style import as_names, escaped
from oppload_cli.results.tuning import Tuning

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from oppload_cli.results.result_files import BaseResult


_NUMBER = re.compile(r"\d+(?:\.\d+)?")


def labels_of(
    read: Sequence[BaseResult] | Sequence[Tuning], given: Sequence[str] = ()
) -> list[str]:
    """Return the names that the user gave to results or tuning tables, or else what differs.

    Raises
    ------
    ParameterError
        If names are given, but not one for each.
    """
    given = as_names(given)
    if given and len(given) != len(read):
        noun = "table" if isinstance(read[0], Tuning) else "result"
        raise ParameterError(
            f"{counted(len(given), 'label')} for {counted(len(read), noun)}; give one for each, "
            "or none"
        )
    return [escaped(name) for name in given or _distinct_names(read)]


def _distinct_names(read: Sequence[BaseResult] | Sequence[Tuning]) -> list[str]:
    """Return what differs between results or tuning tables, a text for each.

    That is what differs between the names of their inputs or stimuli, such as ``l/v 10`` and
    ``l/v 20``. If two names are equal, it is the parameters and values of the
    stimulus that all have, the detectors, the paths, or the numbers of results that are in no file.
    """
    names = [result.name if isinstance(result, Tuning) else result.title for result in read]
    if len(read) == 1:
        return names
    sidecars = [result.sidecar for result in read]
    indicators = [indicator_of(sidecar) for sidecar in sidecars]
    alike = len(set(indicators)) == 1
    indicators = ["" if alike else indicator or "no indicator" for indicator in indicators]
    if len(set(names)) == len(names):
        return _joined(differences(names), indicators)
    settings = _joined(_settings_of(sidecars), indicators)
    for texts in (settings, [", ".join(result.models) for result in read]):
        if len(set(texts)) == len(texts):
            return texts
    paths = [result.path.as_posix() for result in read]
    if len(set(paths)) < len(paths):
        return [f"result {number}" for number in range(1, len(read) + 1)]
    return differences(paths)


def indicator_of(sidecar: Mapping[str, Any]) -> str:
    """Return the calcium indicator of ``oppload tune`` in words, such as ``indicator of 1 s``.

    The text is empty if the sidecar names no indicator.
    """
    seconds = sidecar.get("indicator_s")
    return f"indicator of {seconds:g} s" if isinstance(seconds, int | float) and seconds else ""


def _joined(names: Sequence[str], indicators: Sequence[str]) -> list[str]:
    return [", ".join(filter(None, parts)) for parts in zip(names, indicators, strict=True)]


def _settings_of(sidecars: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the values that differ between the sidecars."""
    tables = [_values_of(sidecar) for sidecar in sidecars]
    shared = [key for key in tables[0] if all(key in table for table in tables)]
    keys = [key for key in shared if len({repr(table[key]) for table in tables}) > 1]
    return [", ".join(f"{key} {table[key]}" for key in keys) for table in tables]


def _values_of(sidecar: Mapping[str, Any]) -> dict[str, Any]:
    """Return the parameters, and the values of the stimulus of a result that was not saved."""
    protocol = (sidecar.get("stimulus") or {}).get("protocol", {})
    tables = {key: value for key, value in protocol.items() if isinstance(value, dict | int)}
    objects = {obj["id"]: obj for obj in protocol.get("object", ())}
    return dict(_flat(sidecar.get("parameters"))) | dict(_flat(tables | objects))


def _flat(table: object, prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in table.items() if isinstance(table, dict) else ():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def differences(names: Sequence[str]) -> list[str]:
    """Return names without the words with which all of them begin or end.

    A number keeps the word before it: ``loom-l-over-v-10.avi`` and ``loom-l-over-v-20.avi`` give
    ``l/v 10`` and ``l/v 20``. If two shortened names would be equal, the names stay as they are.
    """
    plain = [re.sub(r"l-over-v[-_]?", "l/v ", name) for name in names]
    split = [re.findall(r"l/v|\d+(?:\.\d+)?|[^\W\d_]+|[\W_]", name) for name in plain]
    begin = _common_count(split)
    end = _common_count([words[begin:][::-1] for words in split])
    if any(len(words) == begin + end or _NUMBER.fullmatch(words[begin]) for words in split):
        while begin and not split[0][begin - 1][0].isalpha():
            begin -= 1
        begin = max(0, begin - 1)
    shortened = ["".join(words[begin : len(words) - end]).strip(" -_./") for words in split]
    only_suffixes = begin and split[0][begin - 1] == "." and not end
    return plain if only_suffixes or len(set(shortened)) < len(set(names)) else shortened


def _common_count(split: Sequence[Sequence[str]]) -> int:
    """Return the number of words with which all lists of words begin."""
    return sum(1 for _ in takewhile(lambda words: len(set(words)) == 1, zip(*split, strict=False)))


def in_number_order(labels: Sequence[str]) -> list[int]:
    """Return the positions of labels in the order of their numbers, so that 9 comes before 10.

    Labels that differ only in their numbers stand together, at the place of the first of them.
    Other labels keep their order.
    """
    texts = [_NUMBER.sub("", label) for label in labels]

    def key(at: int) -> tuple[int, list[float]]:
        return texts.index(texts[at]), [float(number) for number in _NUMBER.findall(labels[at])]

    return sorted(range(len(labels)), key=key)
