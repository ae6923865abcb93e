"""Stimuli, settings and numbers that several figures use."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from oppload_cli.models.presets import STUDY_PRESET
from oppload_cli.pipeline.settings import resolve
from oppload_cli.stimulus.catalogue import load_all
from oppload_cli.tuning.present import present

if TYPE_CHECKING:
    from collections.abc import Sequence

    from oppload_cli.pipeline.settings import Settings
    from oppload_cli.tuning.present import Responses


# The presets that are the paper's own model; preset default departs from it.
TITLES = {STUDY_PRESET: "preset reference", "paper": "preset paper (literal)"}
PRESETS = tuple(TITLES)
# Without a pause before the motion: after one, the first moving frames meet no delayed
# inhibition yet, and give a transient that is the same for every direction.
NO_PAUSE = {"timing.before_s": 0}
DPI = 130
WIDE = 7.2  # inches


def settings_of(
    preset: str, assignments: Sequence[str] = (), *, height: str | None = None, detector: str = ""
) -> Settings:
    """Return the settings of a preset.

    Parameters
    ----------
    preset : str
        ``reference`` or ``paper``.
    assignments : sequence of str
        As for ``--set``; for preset ``reference`` only, as ``paper`` is literal.
    height : str, optional
        Working height; else the preset's.
    detector : str
        The only detector to run; both if empty.
    """
    return resolve(
        preset=preset,
        assignments=assignments if preset == STUDY_PRESET else (),
        height=height,
        models=[detector] if detector else (),
    )


def presented(
    name: str, settings: Settings, changes: dict[str, Any] | None = None
) -> dict[str, dict[str, Responses]]:
    """Show all members of a stimulus of the catalogue, some of its values changed.

    Returns
    -------
    dict of str to dict of str to Responses
        By the member's name, then by detector.
    """
    return {each.name: present(each, settings) for each in load_all(name, changes)}


def peak_of(responses: Responses) -> float:
    """Return the largest response, 0 if nothing responded."""
    best = responses.peak
    return 0.0 if best is None else float(responses.response[best])


def plain(value: float) -> str:
    """Return a number in few digits, without an exponent unless it is very small."""
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.2g}"
