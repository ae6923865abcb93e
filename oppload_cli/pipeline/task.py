"""A task, which is one input with its settings and outputs, and its outcome."""

from __future__ import annotations

from dataclasses import dataclass, field
from fractions import Fraction
from typing import TYPE_CHECKING, Protocol

from oppload_cli.pipeline.outputs import IfExists
from oppload_cli.video.span import Span

if TYPE_CHECKING:
    from collections.abc import Sequence

    from oppload_cli.pipeline.outputs import Outputs
    from oppload_cli.pipeline.settings import Settings
    from oppload_cli.results.alarms import Verdict
    from oppload_cli.results.record import FrameRecord, ModelSummary
    from oppload_cli.video.source import Video


@dataclass(frozen=True)
class Task:
    """One input, how to analyse it, and where to write the results.

    Attributes
    ----------
    name : str
        The input.
    settings : Settings
        The detectors and their parameters.
    outputs : Outputs or None
        The files to write; None streams the CSV to standard output.
    span : Span
        The part of the input.
    image_rate : Fraction
        Frames per second of images.
    if_exists : IfExists
        What to do where a file exists already.
    command : sequence of str
        The command line, for the sidecar.
    threads : int
        Threads of the decoder, and of the detectors on large frames; 0 lets them choose.
    stem : str
        The beginning of the names of its results.
    boxes : str
        Objects with a box in an annotated video: ``alarm``, ``all`` or ``none``.
    """

    name: str
    settings: Settings
    outputs: Outputs | None = None
    span: Span = field(default_factory=Span)
    image_rate: Fraction = Fraction(30)
    if_exists: IfExists = IfExists.ERROR
    command: Sequence[str] = ()
    threads: int = 0
    boxes: str = "alarm"
    stem: str = ""


@dataclass(frozen=True)
class Outcome:
    """The outcome of a task.

    Attributes
    ----------
    skipped : bool
        Whether the result existed already.
    complete : bool
        Whether every frame that the input declared was decoded.
    frames : int
        Number of rows written.
    wall_s : float
        Seconds from opening to the last row.
    notes : tuple of str
        Faults of the input, a line each.
    remarks : tuple of str
        Unusual properties of the input that are no faults, a line each.
    summaries : dict of str to ModelSummary
        By detector; empty where the result existed.
    verdicts : tuple of Verdict
        Of every detector, those of an existing result included.
    """

    skipped: bool = False
    complete: bool = True
    frames: int = 0
    wall_s: float = 0.0
    notes: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    summaries: dict[str, ModelSummary] = field(default_factory=dict)
    verdicts: tuple[Verdict, ...] = ()

    @property
    def alarmed(self) -> bool:
        """Whether the alarm of any detector went on."""
        return any(each.alarms for each in self.verdicts)


class Watcher(Protocol):
    """An observer of the progress of a task."""

    def opened(self, video: Video) -> None:
        """Take note that the input is open."""

    def frame(self, record: FrameRecord) -> None:
        """Take note that the record of a frame is written."""


class Interrupted(KeyboardInterrupt):
    """The user stopped a task; the message says which rows are kept."""
