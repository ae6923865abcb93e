"""Writing a stimulus: the video, its ground truth and a contact sheet."""

from __future__ import annotations

import json
import math
import os.path
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from oppload_cli.errors import (
    OpploadError,
    OutputError,
    ParameterError,
    StimulusError,
    suggestion,
)
from oppload_cli.files.atomic import remove, write_atomic
from oppload_cli.files.reading import is_file, path_of
from oppload_cli.processes import cores
from oppload_cli.processes.pool import Seldom, outcomes
from oppload_cli.stimulus.catalogue import find
from oppload_cli.stimulus.renderer import Renderer
from oppload_cli.stimulus.truth import ground_truth_text, read_ground_truth
from oppload_cli.video.inputs import GROUND_TRUTH
from oppload_cli.video.writers import FORMATS, IMAGE, open_writer, png_bytes

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from oppload_cli.stimulus.coverage import Grey
    from oppload_cli.stimulus.protocol import Protocol


_GUTTER = 6  # pixels between the pictures of a contact sheet
_CAPTION = 14  # pixels for the time under a picture


def sheet_frames(count: int, shown: int = 8) -> list[int]:
    """Return the numbers of at most `shown` of `count` frames, evenly spaced from first to last."""
    return sorted({round(index * (count - 1) / (shown - 1)) for index in range(shown)})


def contact_sheet(
    pictures: Sequence[Grey], side: int = 160, columns: int = 4, times_s: Sequence[float] = ()
) -> Grey:
    """Put pictures in rows on a white sheet, with a black line around each.

    The line and the sheet separate black pictures as well as white ones.

    Parameters
    ----------
    pictures : sequence of ndarray
        uint8 (h, w), all of one size.
    side : int
        Longer side of a picture on the sheet, in pixels.
    columns : int
        Pictures in a row.
    times_s : sequence of float
        Times in seconds to write under the pictures; may be empty.
    """
    scale = min(1.0, side / max(pictures[0].shape))
    height, width = (max(1, round(size * scale)) for size in pictures[0].shape)
    columns = min(columns, len(pictures))
    rows = math.ceil(len(pictures) / columns)
    row_step, column_step = height + _GUTTER + _CAPTION * bool(times_s), width + _GUTTER
    shape = (rows * row_step + _GUTTER, columns * column_step + _GUTTER)
    sheet = np.full(shape, 255, dtype=np.uint8)
    for index, picture in enumerate(pictures):
        small = cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)
        top = _GUTTER + index // columns * row_step
        left = _GUTTER + index % columns * column_step
        sheet[top - 1 : top + height + 1, left - 1 : left + width + 1] = 0
        sheet[top : top + height, left : left + width] = small
        if times_s:
            origin = left, top + height + _CAPTION - 2
            text, font = f"{times_s[index]:.3g} s", cv2.FONT_HERSHEY_SIMPLEX
            cv2.putText(sheet, text, origin, font, 0.4, 0, 1, cv2.LINE_AA)
    return sheet


@dataclass(frozen=True)
class Written:
    """The files of one stimulus.

    Attributes
    ----------
    video, truth : Path
        The video (a folder for ``png``) and its ``.stimulus.json``.
    preview : Path or None
        The contact sheet, if there is one.
    frames : int
        Number of frames.
    """

    video: Path
    truth: Path
    preview: Path | None
    frames: int


def file_stem(name: str) -> str:
    """Return the name of a stimulus as a file name without suffix: ``/`` becomes ``_``.

    Examples
    --------
    >>> from oppload_cli import stimulus
    >>> stimulus.file_stem("controls/looming-square/axis-0")
    'controls_looming-square_axis-0'
    """
    given: object = name  # a caller may give a number, in spite of the type
    if not isinstance(given, str):
        raise ParameterError(f"the name of a file must be a text, not {given!r:.60}")
    return name.replace("/", "_")


def _check_fits(protocol: Protocol, form: str, where: str) -> None:
    """Refuse a format that cannot hold a stimulus; `where` names the stimulus in the message."""
    if str(form) not in FORMATS:  # a caller may give a list or an array, in spite of the type
        raise StimulusError(f"no video format '{form}'{suggestion(form, FORMATS)}")
    display, video_format = protocol.display, FORMATS[form]
    for key in ("width", "height"):
        pixels = getattr(display, key)
        if video_format.even and pixels % 2:
            raise StimulusError(
                f"{where}: display.{key} = {pixels} is odd, and {form} holds even sizes only; "
                "change it or use format ffv1"
            )
    if video_format.fastest_hz is not None and display.frame_rate > video_format.fastest_hz:
        fits = "ffv1" if display.frame_rate <= (FORMATS["ffv1"].fastest_hz or 0) else "png or npz"
        raise StimulusError(
            f"{where}: display.frame_rate = {float(display.frame_rate):g} is more than the "
            f"{video_format.fastest_hz:g} Hz that {form} holds; lower it or use format {fits}"
        )


def stimuli_named(
    names: Sequence[str], settings: dict[str, Any], form: str
) -> tuple[list[Protocol], list[OpploadError]]:
    """Return the stimuli that :func:`find` finds, and an error for each name that is wrong.

    `settings` are values to change, by dotted key; `form` is the format of the files.
    """
    stimuli: dict[str, Protocol] = {}
    problems: list[OpploadError] = []
    for name in names:
        try:
            for entry in find(name):
                changed = entry.with_settings(settings).with_changes_described()
                for protocol in changed.protocols():
                    _check_fits(protocol, form, changed.label)
                    if stimuli.setdefault(protocol.name, protocol) != protocol:
                        raise OutputError(
                            f"{entry.path}: two different stimuli are named '{protocol.name}'; "
                            "rename a file or generate them one by one"
                        )
        except OpploadError as problem:
            problems.append(problem)
    return list(stimuli.values()), problems


def not_made_yet(
    protocols: Sequence[Protocol], directory: Path, form: str, if_exists: str, *, preview: bool
) -> list[Protocol]:
    """Return the stimuli to write; `if_exists` is ``error``, ``skip`` or ``overwrite``.

    With ``skip``, a stimulus is written unless all its files exist, with `preview` also its sheet.

    Raises
    ------
    OutputError
        If a file exists and `if_exists` is ``error``; if it is ``skip``, and the existing files
        were made from another protocol; or if the video of another protocol in another format would
        get the new ground truth.
    """
    wanted = []
    for protocol in protocols:
        video, truth, sheet = _paths(protocol, directory, form)
        paths = [video, truth, sheet] if preview else [video, truth]
        old = [path for path in paths if os.path.lexists(path)]
        if old and if_exists == "error":
            raise OutputError(
                f"{old[0]}: exists already; choose --if-exists overwrite or skip, or another "
                "--output"
            )
        difference = _difference(truth, protocol) if truth in old else ""
        others = _in_other_formats(protocol, directory, form) if difference else []
        if others:
            raise OutputError(
                f"{others[0]}: exists already, {difference}, and its ground truth would be "
                "replaced; remove it, or choose another --output"
            )
        if difference and if_exists == "skip":
            raise OutputError(
                f"{old[0]}: exists already, {difference}; choose --if-exists overwrite, or "
                "another --output"
            )
        if len(old) < len(paths) or if_exists == "overwrite":
            wanted.append(protocol)
    return wanted


def _paths(protocol: Protocol, directory: Path, form: str) -> tuple[Path, Path, Path]:
    """Return the paths of a stimulus's video, of its ground truth and of its contact sheet."""
    stem = str(directory / file_stem(protocol.name))
    return Path(stem + FORMATS[form].suffix), Path(stem + GROUND_TRUTH), Path(f"{stem}.preview.png")


def _in_other_formats(protocol: Protocol, directory: Path, form: str) -> list[Path]:
    """Return the videos of a stimulus in other formats that share its ground truth."""
    paths = [_paths(protocol, directory, other)[0] for other in FORMATS if other != form]
    # A folder of this name may hold anything else, such as results.
    return [path for path in paths if is_file(path) or is_file(path / IMAGE.format(0))]


def _difference(truth: Path, protocol: Protocol) -> str:
    """Return in words how a protocol differs from that of a ground truth; empty if it does not."""
    try:
        old = dict(read_ground_truth(truth)["protocol"])
    except (StimulusError, KeyError, TypeError, ValueError):
        return "but its ground truth cannot be read"
    new = json.loads(json.dumps(protocol.as_table()))  # with lists in place of tuples
    for key in {**new, **old}:
        if key != "description" and old.get(key) != new.get(key):
            return f"with another {key}"
    return ""


def write(
    protocol: Protocol,
    directory: Path | str,
    *,
    form: str = "ffv1",
    preview: bool = False,
    new: bool = False,
    progress: Callable[[int], object] | None = None,
) -> Written:
    """Write a stimulus: the video, its ground truth and, if wanted, a contact sheet.

    Parameters
    ----------
    protocol : Protocol
        The stimulus.
    directory : Path or str
        The folder of the files; it is made if it does not exist.
    form : str
        ``ffv1`` (AVI) and ``mkv`` are lossless videos, ``mp4`` is a lossy one (H.264); ``png`` is a
        folder of images, ``npz`` an array, ``gif`` an animation for slides.
    preview : bool
        Whether to write a contact sheet too.
    new : bool
        If true, an existing video is an error; otherwise existing files are overwritten.
    progress : callable or None
        Called with 1 after each frame.

    Raises
    ------
    StimulusError
        If the format cannot hold the stimulus.
    OutputError
        If a file cannot be written; then no file of this stimulus remains.
    """
    renderer = Renderer(protocol)
    _check_fits(protocol, form, protocol.name)
    display, count = protocol.display, protocol.frame_count
    video, truth, sheet = _paths(protocol, path_of(directory, "directory"), form)
    shown = sheet_frames(count) if preview else []
    previewed: list[Grey] = []
    shape = count, display.height, display.width
    with open_writer(video, form, shape, display.frame_rate, new=new) as write_frame:
        for index in range(count):
            grey = renderer.grey(index)
            write_frame(grey)
            if index in shown:
                previewed.append(grey)
            if progress is not None:
                progress(1)
    try:
        texts = ground_truth_text(protocol)
        # The name of a file in the protocol may be of any bytes.
        write_atomic(truth, (text.encode(errors="backslashreplace") for text in texts))
        if preview:
            times = [protocol.time_of(index) for index in shown]
            write_atomic(sheet, png_bytes(contact_sheet(previewed, times_s=times)))
    except BaseException:
        # Users would take a video without its ground truth for a complete result.
        for path in (video, truth):
            remove(path)
        raise
    return Written(video, truth, sheet if preview else None, count)


def write_all(
    protocols: Sequence[Protocol],
    directory: Path,
    *,
    form: str = "ffv1",
    preview: bool = False,
    new: bool = False,
    jobs: int = 0,
    progress: Callable[[int], object] | None = None,
) -> list[Written | OpploadError]:
    """Write stimuli; if one of them fails, the others are still written.

    Parameters
    ----------
    protocols : sequence of Protocol
        The stimuli.
    directory, form, preview, new
        As for :func:`write`.
    jobs : int
        Largest number of processes that write stimuli at the same time; 0: one per core.
    progress : callable or None
        Called with the number of frames written since the last call.

    Returns
    -------
    list of Written or OpploadError
        In the order of `protocols`.
    """
    write_one = partial(_written, directory=directory, form=form, preview=preview, new=new)
    # To start a process takes as long as to write one or two stimuli.
    jobs = max(1, min(len(protocols) // 2, jobs or cores()))
    run = outcomes(write_one, protocols, jobs, named=attrgetter("name"), on_message=progress)
    with closing(run) as coming:
        done: dict[int, Written | OpploadError] = dict(coming)
    return [done[position] for position in range(len(protocols))]


def _written(protocol: Protocol, tell: Callable[[int], object], **options: Any) -> Written:
    count = Seldom(tell)
    written = write(protocol, progress=count, **options)
    count.flush()
    return written
