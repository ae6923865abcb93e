"""What the sidecar of a run says."""

from __future__ import annotations

import os.path
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2

from oppload_cli.environment import environment
from oppload_cli.errors import OpploadError

if TYPE_CHECKING:
    from oppload_cli.task import Outcome, Task
    from oppload_cli.video.source import Video


def sidecar_content(task: Task, video: Video, outcome: Outcome, repeats: int) -> dict[str, Any]:
    """Return the content of the sidecar.

    Parameters
    ----------
    task : Task
        What was done.
    video : Video
        The input, read to its end.
    outcome : Outcome
        What came of it.
    repeats : int
        How many frames were exact repeats.

    Returns
    -------
    dict
        Ready for JSON; the keys are those of ``docs/formats.md``.
    """
    settings, facts, decode = task.settings, video.facts, video.decode
    working = video.working
    rate = facts.frame_rate
    groups = {
        **settings.groups,
        "opplod": settings.opplod.resolved(working.height, float(rate) if rate else None),
    }
    return {
        "tool": environment(),
        "command": list(task.command),
        "preset": settings.preset,
        "models": list(settings.models),
        "parameters": {name: params.as_dict() for name, params in groups.items()},
        "input": facts.as_dict(),
        "span": asdict(task.span),
        "working": {
            "width": working.width,
            "height": working.height,
            "source_px_per_px_x": working.scale_x,
            "source_px_per_px_y": working.scale_y,
            "source_px_per_s_at_1_px_per_frame": (working.scale_x * float(rate) if rate else None),
        },
        "decode": {
            "declared": facts.frames_declared,
            "decoded": decode.decoded,
            "analysed": outcome.frames,
            "failures": decode.failures,
            "corrupt": decode.corrupt,
            "missing": decode.missing,
            "repeats": repeats,
            "complete": decode.complete,
            "messages": decode.messages,
        },
        "threads": {
            "decoder": decode.threads,
            "decoder_apart": decode.apart,
            "models": cv2.getNumThreads(),
        },
        "stimulus": _ground_truth(Path(task.name)),
        "wall_s": round(outcome.wall_s, 3),
        "frames_per_s": round(outcome.frames / outcome.wall_s, 1) if outcome.wall_s else None,
        "summary": {name: summary.as_dict() for name, summary in outcome.summaries.items()},
    }


def _ground_truth(video: Path) -> dict[str, Any] | None:
    """Return what the ground truth beside a stimulus's video says; None if there is none."""
    path = video.with_name(f"{video.stem}.stimulus.json")
    if not os.path.lexists(path):  # which says no to a name too long to look up
        return None
    from oppload_cli.stimulus.truth import read_ground_truth  # noqa: PLC0415 - few inputs have it

    try:
        truth = read_ground_truth(path)
    except OpploadError as error:
        return {"path": str(path), "error": str(error)}
    kept = ("name", "looming", "contact_time_s", "display")
    return {"path": str(path), **{key: truth[key] for key in kept}}
