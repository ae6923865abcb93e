"""Short words for the dotted keys of a protocol, such as ``l/v`` and ``size``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from oppload_cli.errors import ParameterError, suggestion

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

# The keys that each word may mean, with {id} for an object.
_DIRECTIONS = ("{id}.axis_deg", "{id}.motion.direction_deg", "scene.rotation_deg")
WORDS = {
    "axis": _DIRECTIONS,
    "direction": _DIRECTIONS,
    "speed": ("{id}.growth.speed_deg_s", "{id}.motion.speed_deg_s"),
    "width": ("{id}.width_deg",),
    "size": ("{id}.size_deg",),
    "l/v": ("{id}.growth.l_over_v_ms",),
    "position": ("{id}.centre_deg", "scene.centre_deg"),
}
# Keys that a word means only where the stimulus sweeps them.
_WHERE_SWEPT = {"size": ("{id}.growth.end_deg",)}


def key_of(
    word: str, name: str, table: Mapping[str, Any], sweep: Collection[str], option: str
) -> str:
    """Return the dotted key that a word of `WORDS`, or a key itself, means in a stimulus.

    Parameters
    ----------
    word : str
        As the user wrote it.
    name : str
        Of the stimulus.
    table : mapping
        The contents of its file.
    sweep : collection of str
        The keys that it sweeps.
    option : str
        The option with the word, for the message.

    Raises
    ------
    ParameterError
        If there is no such word, or the stimulus has no such key, or several.
    """
    if "." in word:
        return word
    if word not in WORDS:
        hint = suggestion(word, WORDS)
        raise ParameterError(
            f"{option} {word}: no parameter '{word}'{hint}; or a key as ID.size_deg"
        )
    found = _meant(word, table, sweep)
    if len(found) == 1:
        return found[0]
    if found:
        raise ParameterError(
            f"{option} {word}: in {name} that is {' or '.join(found)}; write a key in full"
        )
    names = dict.fromkeys(key.rpartition(".")[2] for key in WORDS[word])
    known = [each for each in WORDS if len(_meant(each, table, sweep)) == 1]
    raise ParameterError(
        f"{option} {word}: no object of {name} has {' or '.join(names)}; {option} takes "
        f"{', '.join(known)}, or a full key such as scene.rotation_deg"
    )


def _meant(word: str, table: Mapping[str, Any], sweep: Collection[str]) -> list[str]:
    """Return the keys that a word may mean: the one that is swept, or those with a value."""
    listed = table.get("object", [])
    objects = [one for one in listed if isinstance(one, dict)] if isinstance(listed, list) else []
    patterns = (*WORDS[word], *_WHERE_SWEPT.get(word, ()))
    every = dict.fromkeys(
        pattern.format(id=one.get("id")) for one in objects for pattern in patterns
    )
    own = [key for key in every if key in sweep]
    if len(own) == 1:
        return own
    if word in {"axis", "direction"}:
        return ["scene.rotation_deg"]
    if len(objects) > 1 and word == "position":
        return ["scene.centre_deg"]
    stated = (pattern.format(id=one.get("id")) for one in objects for pattern in WORDS[word])
    return [key for key in dict.fromkeys(stated) if _states(objects, key)]


def _states(objects: Sequence[dict[str, Any]], key: str) -> bool:
    """Tell whether the file gives a value for a key of one of its objects."""
    if value_at({"object": objects}, key) is not None:
        return True
    # An object without a position is in the middle.
    return key.endswith(".centre_deg") and not key.startswith("scene.")


def value_at(table: Mapping[str, Any], key: str) -> Any:
    """Return the value of a dotted key in the table of a protocol; None where it has none."""
    first, *rest = key.split(".")
    value = next((one for one in table.get("object", []) if one.get("id") == first), None)
    value = table.get(first) if value is None else value
    for word in rest:
        value = value.get(word) if isinstance(value, dict) else None
    return value
