"""The result files of one input: what they are called, and whether they are there."""

from __future__ import annotations

import os.path
from dataclasses import dataclass, fields
from enum import StrEnum
from typing import TYPE_CHECKING

from oppload_cli.errors import OutputError
from oppload_cli.video.atomic import part_of
from oppload_cli.video.inputs import ANNOTATED

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path


class IfExists(StrEnum):
    """What to do where a result is there already."""

    ERROR = "error"
    SKIP = "skip"
    OVERWRITE = "overwrite"


@dataclass(frozen=True)
class Outputs:
    """The result files of one input; what is None is not written.

    Attributes
    ----------
    csv : Path
        ``{stem}.frames.csv``, the mark of a finished result: it gets its name last.
    sidecar : Path or None
        ``{stem}.oppload.json``.
    detections : Path or None
        ``{stem}.detections.jsonl``.
    annotated : Path or None
        ``{stem}.annotated.mp4``.
    """

    csv: Path
    sidecar: Path | None = None
    detections: Path | None = None
    annotated: Path | None = None

    @classmethod
    def of(
        cls, folder: Path, stem: str, models: Sequence[str], *, annotate: bool = False
    ) -> Outputs:
        """Return all files of a run.

        Parameters
        ----------
        folder : Path
            Where they are.
        stem : str
            What their names begin with.
        models : sequence of str
            The models of the run; only OppLoD gives detections.
        annotate : bool
            Whether there is an annotated video.

        Returns
        -------
        Outputs
        """
        return cls(
            folder / f"{stem}.frames.csv",
            folder / f"{stem}.oppload.json",
            folder / f"{stem}.detections.jsonl" if "opplod" in models else None,
            folder / f"{stem}{ANNOTATED}" if annotate else None,
        )

    def paths(self) -> list[Path]:
        """Return the files, the table first.

        Returns
        -------
        list of Path
        """
        named = (getattr(self, each.name) for each in fields(self))
        return [path for path in named if path is not None]

    def absolute(self) -> Outputs:
        """Return the same files by whole paths, for another process.

        Returns
        -------
        Outputs
        """
        named = {each.name: getattr(self, each.name) for each in fields(self)}
        return Outputs(**{name: path and path.absolute() for name, path in named.items()})

    def kept(self, if_exists: IfExists) -> bool:
        """Tell whether the files are there and shall be kept.

        A result is whole when every file is there; some alone are what a killed run left.

        Parameters
        ----------
        if_exists : IfExists
            What to do with what is there.

        Returns
        -------
        bool

        Raises
        ------
        OutputError
            If a file is there and nothing was said of it.
        """
        results = self.paths()
        # These say no to a name that may not be looked up; writing it will tell the reason.
        there = [path for path in results if os.path.lexists(path)]
        if if_exists is IfExists.ERROR:
            there += [part_of(path) for path in results if os.path.lexists(part_of(path))]
            if there:
                raise OutputError(
                    f"{there[0]}: exists already; "
                    f"choose --if-exists overwrite or skip, or another --output"
                )
        return if_exists is IfExists.SKIP and len(there) == len(results)
