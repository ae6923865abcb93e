"""Stimuli and settings that several figures use."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from oppload_cli.models.opplod import Opplod
from oppload_cli.settings import resolve
from oppload_cli.stimulus.catalogue import load_all
from oppload_cli.tuning.present import StimulusVideo, present

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    import numpy as np
    from numpy.typing import NDArray

    from oppload_cli.models.kernels import Map
    from oppload_cli.settings import Settings
    from oppload_cli.stimulus.protocol import Protocol
    from oppload_cli.tuning.present import Responses

TITLES = {"default": "preset default", "paper": "preset paper (literal)"}
# The paper's own model; preset robust departs from it.
PRESET_NAMES = tuple(TITLES)
# Without a pause before the motion: after one, the first moving frames meet no delayed
# inhibition yet, and give a transient that is the same for every direction.
NO_PAUSE = {"timing.before_s": 0}
DPI = 130
WIDE = 7.2


def settings_of(
    preset: str, assignments: Sequence[str] = (), *, height: str | None = None, models: str = ""
) -> Settings:
    """Return the settings of a preset.

    Parameters
    ----------
    preset : str
        ``default`` or ``paper``.
    assignments : sequence of str
        As for ``--set``; for preset ``default`` only, as ``paper`` is literal.
    height : str, optional
        Working height; else the preset's.
    models : str
        One model; both if empty.

    Returns
    -------
    Settings
    """
    return resolve(
        preset=preset,
        assignments=assignments if preset == "default" else (),
        height=height,
        models=[models] if models else (),
    )


def presented(
    name: str, settings: Settings, changes: dict[str, Any] | None = None
) -> dict[str, dict[str, Responses]]:
    """Show all members of a stimulus to the models.

    Parameters
    ----------
    name : str
        Of the catalogue.
    settings : Settings
        Models and working height.
    changes : dict, optional
        Values of the stimulus to change.

    Returns
    -------
    dict of str to dict of str to Responses
        By the member's name, then by model.
    """
    return {each.name: present(each, settings) for each in load_all(name, changes)}


def peak_of(responses: Responses) -> float:
    """Return the largest response, 0 where there is none.

    Parameters
    ----------
    responses : Responses
        Of one model.

    Returns
    -------
    float
    """
    best = responses.peak
    return 0.0 if best is None else float(responses.response[best])


def plain(value: float) -> str:
    """Return a number in few digits, without an exponent unless it is very small.

    Parameters
    ----------
    value : float
        The number.

    Returns
    -------
    str
    """
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.2g}"


def pathway_maps(
    protocol: Protocol, settings: Settings
) -> Iterator[tuple[int, NDArray[np.float32], dict[int, Map]]]:
    """Yield the MDE maps of a stimulus, frame by frame.

    Parameters
    ----------
    protocol : Protocol
        The stimulus.
    settings : Settings
        Parameters of OppLoD and working height.

    Yields
    ------
    index : int
        Of the frame.
    luma : ndarray of float32, shape (height, width)
        At the working size.
    maps : dict of int to ndarray
        S_phi by direction in degrees; overwritten by the next frame.
    """
    video = StimulusVideo(protocol, settings.height)
    model = Opplod(video.working.shape, settings.opplod)
    for frame in video:
        if model.step(frame.luma) is not None:
            yield frame.index, frame.luma, model.pathways
