"""Writing a stimulus: the video, its ground truth and a contact sheet."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from oppload_cli.errors import StimulusError, suggestion
from oppload_cli.stimulus.renderer import Renderer
from oppload_cli.stimulus.sheet import contact_sheet, sheet_frames
from oppload_cli.stimulus.truth import ground_truth_text
from oppload_cli.video.archive import png_bytes
from oppload_cli.video.atomic import remove, write_atomic
from oppload_cli.video.writer import FORMATS, open_writer, target_of

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from oppload_cli.stimulus.protocol import Protocol


@dataclass(frozen=True)
class Written:
    """The files of one stimulus.

    Attributes
    ----------
    video, truth : Path
        The video (a folder for ``png``) and its ``.stimulus.json``.
    preview : Path or None
        The contact sheet, where one was asked for.
    frames : int
        Number of frames.
    """

    video: Path
    truth: Path
    preview: Path | None
    frames: int


def file_stem(name: str) -> str:
    """Return the file name of a stimulus, without suffix.

    Parameters
    ----------
    name : str
        E.g. ``klapoetke2017/bar-expand-10/axis-45``.

    Returns
    -------
    str
        E.g. ``klapoetke2017_bar-expand-10_axis-45``.
    """
    return name.replace("/", "_")


def check_fits(protocol: Protocol, form: str, where: str) -> None:
    """Check that a format can hold a stimulus.

    Parameters
    ----------
    protocol : Protocol
        The stimulus.
    form : str
        A key of :data:`oppload_cli.video.writer.FORMATS`.
    where : str
        Its name or file, for the message.

    Raises
    ------
    StimulusError
        If it cannot; the message names the key to change.
    """
    if form not in FORMATS:
        raise StimulusError(f"no video format '{form}'{suggestion(form, FORMATS)}")
    display, known = protocol.display, FORMATS[form]
    for key in ("width", "height"):
        pixels = getattr(display, key)
        if known.even and pixels % 2:
            raise StimulusError(
                f"{where}: display.{key} = {pixels} is odd, and {form} holds even sizes only; "
                "change it or use format ffv1"
            )
    if known.fastest_hz is not None and display.frame_rate > known.fastest_hz:
        raise StimulusError(
            f"{where}: display.frame_rate = {float(display.frame_rate):g} is more than the "
            f"{known.fastest_hz:g} Hz that {form} holds; lower it or use format ffv1"
        )


def targets(protocol: Protocol, directory: Path, form: str, *, preview: bool = False) -> Written:
    """Return the files that :func:`write` makes.

    Parameters
    ----------
    protocol : Protocol
        The stimulus.
    directory : Path
        Where they go.
    form : str
        A key of :data:`oppload_cli.video.writer.FORMATS`.
    preview : bool
        Whether there is a contact sheet.

    Returns
    -------
    Written

    Raises
    ------
    StimulusError
        If the format cannot hold the stimulus.
    """
    check_fits(protocol, form, protocol.name)
    stem = file_stem(protocol.name)
    return Written(
        target_of(directory, stem, form),
        directory / f"{stem}.stimulus.json",
        directory / f"{stem}.preview.png" if preview else None,
        protocol.frame_count,
    )


def write(
    protocol: Protocol,
    directory: Path,
    *,
    form: str = "ffv1",
    preview: bool = False,
    progress: Callable[[int], object] | None = None,
) -> Written:
    """Write a stimulus: the video, its ground truth, maybe a contact sheet.

    Parameters
    ----------
    protocol : Protocol
        The stimulus.
    directory : Path
        Where the files go; made if it is not there. What is there is overwritten.
    form : str
        A key of :data:`oppload_cli.video.writer.FORMATS`.
    preview : bool
        Whether to write a contact sheet too.
    progress : callable or None
        Called with 1 after each frame.

    Returns
    -------
    Written

    Raises
    ------
    StimulusError
        If the format cannot hold the stimulus.
    OutputError
        If it cannot be written; nothing of this stimulus is left then.
    """
    made = targets(protocol, directory, form, preview=preview)
    display, renderer = protocol.display, Renderer(protocol)
    shown = set(sheet_frames(protocol.frame_count)) if preview else set()
    kept = []
    with open_writer(
        made.video,
        form,
        width=display.width,
        height=display.height,
        frame_rate=display.frame_rate,
        count=protocol.frame_count,
    ) as video:
        for index in range(protocol.frame_count):
            grey = renderer.grey(index)
            video.write(grey)
            if index in shown:
                kept.append(grey)
            if progress is not None:
                progress(1)
    try:
        write_atomic(made.truth, (text.encode() for text in ground_truth_text(protocol)))
        if made.preview is not None:
            write_atomic(made.preview, [png_bytes(contact_sheet(kept))])
    except BaseException:
        # a video without its truth would be taken for a whole result
        for path in (made.video, made.truth):
            remove(path)
        raise
    return made
