"""Figure of the RMO index: what it says of looming and other stimuli."""

from __future__ import annotations

from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np

from oppload_cli.motion.flow import DenseFlow
from oppload_cli.plots.style import CYCLE, FAINT, STYLE, new_figure, png_bytes
from oppload_cli.reproduction.claims import NO_PRESET, Built, Claim, Finding, Verdict
from oppload_cli.reproduction.material import DPI, NO_PAUSE, WIDE
from oppload_cli.stimulus.catalogue import load_all
from oppload_cli.stimulus.truth import frame_truth
from oppload_cli.tuning.present import StimulusVideo

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from oppload_cli.stimulus.protocol import Protocol

    Point = NDArray[np.float64]

HEIGHT, SLOWEST = 240, 0.5
LOOMING = {
    "opplod2023/looming-disk-centre": {},
    "opplod2023/looming-disk-off-centre": {},
    "opplod2023/approaching-block": {},
    "klapoetke2017/loom-l-over-v": {"disk.growth.l_over_v_ms": [40, 100]},
    "controls/looming-on-static-texture": {},
}
OTHERS = {
    "controls/translating-disk-speed": {"disk.motion.speed_deg_s": [20, 40]},
    "controls/translating-disk-direction": {"scene.rotation_deg": [45]},
    "controls/receding-disk": {"disk.growth.l_over_v_ms": [40, 100]},
    "controls/rotating-bar": {},
    "controls/texture-rotation": {},
    "controls/texture-pan": {"ground.motion.direction_deg": [0, 45]},
}


def stimuli() -> Built:
    """Measure the RMO index of looming and other stimuli.

    Returns
    -------
    Built
    """
    looming = {name: index for stimulus in LOOMING for name, index in _indices(stimulus, LOOMING)}
    others = {name: index for stimulus in OTHERS for name, index in _indices(stimulus, OTHERS)}
    least = min(float(index.min()) for index in looming.values())
    most = max(float(index.max()) for index in others.values())
    most_name = max(others, key=lambda name: float(others[name].max()))
    apart = np.median(np.concatenate(list(looming.values()))) > np.median(
        np.concatenate(list(others.values()))
    )
    overlap = Verdict.IN_PART if apart else Verdict.DOES_NOT
    claim = Claim(
        "Looming is the motion of high radial motion opponency, so that a detector sensitive to "
        "it is selective for looming.",
        "RMO index per frame while an edge moves over 0.5 px/frame at a height of 240; holds: "
        "every looming frame is above every other frame; in part: the medians are",
        {
            NO_PRESET: Finding(
                f"Looming frames give at least {least:.2f}; the others at most {most:.2f} "
                f"({most_name.partition('/')[2]}).",
                Verdict.HOLDS if least > most else overlap,
                {"least_of_looming": least, "largest_of_others": most},
            )
        },
    )
    return Built(
        "rmo-stimuli",
        "RMO index of looming and other stimuli",
        "The range over the frames (line), and the median (dot), per stimulus.",
        (claim,),
        png_bytes(_draw_stimuli(looming, others), DPI),
        (
            "The paper does not say where motion vectors come from; here they are dense optical "
            "flow on a grid.",
            "An index of 0 while something looms is a frame without vectors: the very first one "
            "of the paper's disk, in which its radius grows from 2 to 4 px at a height of 240.",
            "A turning bar on a plain ground is the hard case: a straight edge shows only motion "
            "across itself (the aperture problem).",
        ),
    )


def _indices(name: str, stimuli: dict[str, dict[str, list[int]]]) -> (
    list[tuple[str, NDArray[np.float64]]]
):  # fmt: skip
    made = []
    for protocol in load_all(name, {**NO_PAUSE, **stimuli[name]}):
        index = _index(protocol)
        if index.size:
            made.append((protocol.name, index))
    return made


def _index(protocol: Protocol) -> NDArray[np.float64]:
    """Return the RMO index of the frames in which something moves fast enough."""
    flow, scale = DenseFlow(), HEIGHT / protocol.display.height
    values = []
    for frame in StimulusVideo(protocol, HEIGHT):
        metrics = flow.step(frame.luma)
        moving = [thing for thing in frame_truth(protocol, frame.index).objects if thing.visible]
        speed = max((abs(thing.edge_speed_px_frame) for thing in moving), default=0.0) * scale
        turning = any(thing.motion and thing.motion.rotation_deg_s for thing in protocol.objects)
        if metrics is not None and (speed > SLOWEST or turning):
            values.append(metrics.rmo_index)
    return np.array(values)


def _draw_stimuli(
    looming: dict[str, NDArray[np.float64]], others: dict[str, NDArray[np.float64]]
) -> Figure:
    rows = [*looming.items(), *others.items()]
    with mpl.rc_context(STYLE):
        figure = new_figure(WIDE, 0.6 + 0.2 * len(rows))
        axes = figure.subplots()
        for row, (name, index) in enumerate(rows):
            colour = CYCLE[0] if name in looming else CYCLE[1]
            axes.plot([index.min(), index.max()], [row, row], color=colour, lw=2.5, alpha=0.5)
            axes.plot(np.median(index), row, "o", color=colour, markersize=4)
        axes.set_yticks(range(len(rows)), [name.partition("/")[2] for name, _ in rows])
        axes.invert_yaxis()
        axes.axhline(len(looming) - 0.5, color=FAINT, lw=0.6)
        axes.set(xlabel="RMO index (orange: looming, blue: others)", xlim=(-1.05, 1.05))
        axes.grid(axis="x", color=FAINT, lw=0.3)
    return figure
