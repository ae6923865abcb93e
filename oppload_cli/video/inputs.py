"""What the user names, turned into single inputs and the stems of their results."""

from __future__ import annotations

import glob
import os
import re
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from oppload_cli.errors import SourceError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

VIDEO_SUFFIXES = {
    *(".avi", ".flv", ".gif", ".h264", ".hevc", ".ivf", ".m2ts", ".m4v", ".mjpeg", ".mkv"),
    *(".mov", ".mp4", ".mpeg", ".mpg", ".mts", ".mxf", ".nut", ".ogv", ".ts", ".webm"),
    *(".wmv", ".y4m"),
}
IMAGE_SUFFIXES = {".bmp", ".jpeg", ".jpg", ".pgm", ".png", ".ppm", ".tif", ".tiff", ".webp"}

ANNOTATED = ".annotated.mp4"  # a result: in a folder it is no input
NUMBERED = re.compile(r"\d\.[^.]+$")  # frame_0001.png
LONGEST_STEM = 200  # bytes; a name may have 255 in all


class Found(NamedTuple):
    """A single input, or why there is none.

    Attributes
    ----------
    name : str
        The input; with `error` what was looked at in vain.
    error : SourceError or None
        What was wrong with it.
    """

    name: str
    error: SourceError | None = None


def found_inputs(name: str, *, recursive: bool = False) -> Iterator[Found]:
    """Yield the single inputs that a name stands for.

    Parameters
    ----------
    name : str
        A file, a folder, a pattern of the shell (``clips/*.mp4``, with ``**`` for
        folders of any depth), a pattern of images, ``camera:0``, or an address.
    recursive : bool
        Whether folders are searched to any depth, for videos and for folders of
        numbered images. Hidden folders and links to folders are left out.

    Yields
    ------
    Found
        Something that cannot be read does not hide the rest.
    """
    matches = _matches(name)
    if not matches:
        yield Found(name, SourceError(f"{name}: matches no file; check the pattern"))
    for match in matches:
        if recursive and os.path.isdir(match):  # noqa: PTH112 - it says no to any name
            yield from _below(match)
            continue
        try:
            yield from map(Found, single_inputs(match))
        except SourceError as error:
            yield Found(match, error)


def _matches(name: str) -> list[str]:
    if not glob.has_magic(name) or "://" in name or os.path.lexists(name):
        return [name]
    return sorted(glob.glob(name, recursive=True))  # noqa: PTH207 - absolute ones too


def _below(root: str) -> Iterator[Found]:
    """Yield the inputs in a folder and in those within."""
    refused: list[OSError] = []
    empty = True
    for folder, within, files in os.walk(root, onerror=refused.append):
        within[:] = sorted(each for each in within if not each.startswith("."))
        visible = sorted(each for each in files if not each.startswith("."))
        videos = [each for each in visible if _is_video(each)]
        # A picture or two among other things, such as plots, are no sequence.
        numbered = [e for e in visible if _suffix(e) in IMAGE_SUFFIXES and NUMBERED.search(e)]
        if videos:
            yield from (Found(os.path.join(folder, each)) for each in videos)  # noqa: PTH118
        elif len(numbered) > 1:
            yield Found(folder)
        empty = empty and not videos and len(numbered) < 2
    for error in refused:
        reason = (error.strerror or str(error)).lower()
        refusal = f"{error.filename}: cannot be read ({reason}); check the path"
        yield Found(str(error.filename), SourceError(refusal))
    if empty and not refused:
        reason = "no video and no numbered images in this folder or below"
        yield Found(root, SourceError(f"{root}: {reason}; check the path"))


def _is_video(name: str) -> bool:
    return _suffix(name) in VIDEO_SUFFIXES and not name.endswith(ANNOTATED)


def _suffix(name: str) -> str:
    return os.path.splitext(name)[1].lower()  # noqa: PTH122 - many times faster than a Path


def single_inputs(name: str) -> list[str]:
    """Return the inputs that a name stands for.

    Parameters
    ----------
    name : str
        A file, a folder, a pattern of images, ``camera:0``, or an address.

    Returns
    -------
    list of str
        The videos of a folder of videos, in the order of their names and without
        annotated ones; else `name`.

    Raises
    ------
    SourceError
        If a folder holds neither videos nor images, or cannot be listed.
    """
    path = Path(name)
    try:
        if not path.is_dir():
            return [name]
        suffixes = {
            entry: entry.suffix.lower()
            for entry in path.iterdir()
            # Some systems put a hidden twin beside each file, which is no video.
            if entry.is_file() and not entry.name.startswith(".")
        }
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise SourceError(f"{name}: cannot be read ({reason}); check the path") from error
    videos = sorted(entry for entry in suffixes if _is_video(entry.name))
    if videos:
        return [str(video) for video in videos]
    if not IMAGE_SUFFIXES.intersection(suffixes.values()):
        raise SourceError(f"{name}: no video and no image in this folder; check the path")
    return [name]


def result_stems(inputs: Sequence[str]) -> list[str]:
    """Return the stem of each input's results; equal ones are told apart by a hash of the path.

    Parameters
    ----------
    inputs : sequence of str
        Single inputs, each once: see :func:`each_once`.

    Returns
    -------
    list of str
        As many, all different, also where capitals and small letters are one.
    """
    stems = [_stem(name) for name in inputs]
    counts = Counter(stem.casefold() for stem in stems)
    return [
        _told_apart(stem, name)
        if counts[stem.casefold()] > 1 or len(os.fsencode(stem)) > LONGEST_STEM
        else stem
        for stem, name in zip(stems, inputs, strict=True)
    ]


def each_once(names: Iterable[str]) -> list[str]:
    """Leave out the inputs that are named twice, be it in two spellings.

    Parameters
    ----------
    names : iterable of str
        Single inputs.

    Returns
    -------
    list of str
        Those that differ, in their order; a link and its target differ by their names.
    """
    return list({(_stem(name), _bytes(name)): name for name in reversed(list(names))}.values())[
        ::-1
    ]


def _told_apart(stem: str, name: str) -> str:
    short = os.fsencode(stem)[:LONGEST_STEM].decode("utf-8", "ignore")
    import hashlib  # noqa: PLC0415 - seldom needed

    return f"{short}-{hashlib.sha256(_bytes(name)).hexdigest()[:8]}"


def _bytes(name: str) -> bytes:
    path = name if "://" in name or name.startswith("camera:") else str(Path(name).resolve())
    return path.encode("utf-8", "surrogateescape")


def _stem(name: str) -> str:
    if "://" in name or name.startswith("camera:"):
        return re.sub(r"[^A-Za-z0-9.]+", "-", name.partition("?")[0]).strip("-.")
    path = Path(name).resolve() if Path(name).is_dir() else Path(name)
    if path.is_dir():
        return path.name or "root"
    # "frames_%04d.png" gives "frames".
    without_number = re.sub(r"[_\-. ]*%0?\d*d", "", path.stem)
    return without_number or path.resolve().parent.name or "input"
