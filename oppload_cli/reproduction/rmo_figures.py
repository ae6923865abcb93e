"""Figures of radial motion opponency: its definition, and its index for many stimuli."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from oppload_cli.motion.flow import DenseFlow, rmo_of
from oppload_cli.motion.rmo import RmoMetrics, RmoParams, rmo, rmo_metrics
from oppload_cli.pipeline.sources import StimulusVideo
from oppload_cli.plots.style import CYCLE, FAINT, INK, styled_figure
from oppload_cli.reproduction.claims import (
    NO_DETECTOR,
    NO_PAUSE,
    WIDE,
    Built,
    Claim,
    ClaimVerdict,
    Finding,
)
from oppload_cli.stimulus.catalogue import load_all
from oppload_cli.stimulus.truth import frame_truth

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from oppload_cli.stimulus.protocol import Protocol

    Point = NDArray[np.float64]
    Index = NDArray[np.float64]


_PAIRS, _SAMPLES, _SEED = 300, 20001, 7
# Typical pairs of motion vectors: start and vector of one, start and vector of the other; x points
# right and y down.
_PATTERNS = {
    "outward, equal": ((-1, 0), (-2, 0), (1, 0), (2, 0)),
    "outward, unequal": ((-1, 0), (-1, 0), (1, 0), (2.5, 0)),
    "outward, 20° apart": ((-1, 0), (-2, 0.35), (1, 0), (2, 0.35)),
    "outward, beside": ((-1, -1), (-2, 0), (1, 1), (2, 0)),
    "inward": ((-3, 0), (2, 0), (3, 0), (-2, 0)),
    "translation": ((-1, -0.6), (2, 0), (-1, 0.6), (2, 0)),
    "rotation": ((-1.2, 0), (0, 2), (1.2, 0), (0, -2)),
    "across": ((-1, 0), (-2, 0), (0, 1), (0, 2)),
}
_HEIGHT, _SLOWEST = 240, 0.5  # working height in px, least speed of an edge in px/frame
_LOOMING = {
    "opplod2023/looming-disk-centre": {},
    "opplod2023/looming-disk-off-centre": {},
    "opplod2023/approaching-block": {},
    "klapoetke2017/loom-l-over-v": {"disk.growth.l_over_v_ms": [40, 100]},
    "controls/looming-on-static-texture": {},
}
_OTHERS = {
    "controls/translating-disk-speed": {"disk.motion.speed_deg_s": [20, 40]},
    "controls/translating-disk-direction": {"scene.rotation_deg": [45]},
    "controls/receding-disk": {"disk.growth.l_over_v_ms": [40, 100]},
    "controls/rotating-bar": {},
    "controls/texture-rotation": {},
    "controls/texture-pan": {"ground.motion.direction_deg": [0, 45]},
}


def definition() -> Built:
    """Compare the paper's construction of the degree of opponency with the closed form."""
    largest, literal = _differences()
    both_sides = float(rmo((-1.0, 0.0), (1.0, 0.0)))
    one_side = float(rmo((-1.0, 0.0), (1.0, 0.0), sides=1))
    counted = ClaimVerdict.HOLDS if one_side >= 0.99 else ClaimVerdict.IN_PART
    closed_form = Finding(
        f"Over {_PAIRS} random pairs, they differ by at most {largest:.1g}.",
        ClaimVerdict.at_most(largest, 1e-3, 0.05),
        {"largest_difference": largest},
    )
    mirrored = Finding(
        f"The integral as printed gives {100 * one_side:.0f} %; with both sides of the centre it "
        f"gives {100 * both_sides:.0f} %.",
        counted if both_sides >= 0.99 else ClaimVerdict.DOES_NOT,
        {"one_side": one_side, "both_sides": both_sides},
    )
    claims = (
        Claim.of("rmo-closed-form", {NO_DETECTOR: closed_form}),
        Claim.of("rmo-mirrored", {NO_DETECTOR: mirrored}),
    )
    rows = (
        {
            "pattern": name,
            "rom_pairs": metrics.rom_pairs,
            "rmo": metrics.rmo_max if metrics.rom_pairs else None,
        }
        for name, metrics in ((pattern, _pattern(pattern)) for pattern in _PATTERNS)
    )
    return Built.of("rmo-definition", claims, _draw_definition(), rows, literal=literal)


@dataclass(frozen=True)
class _Construction:
    """The common line, the points of the paper's steps for one pair of vectors, and the ratio."""

    line: Point
    meeting: Point
    middle: Point
    projections: tuple[Point, Point, Point, Point]
    ratio: float


def _construct(s1: Point, v1: Point, s2: Point, v2: Point, sides: int = 2) -> _Construction:
    """Carry out the paper's four steps and its integral for one pair of vectors.

    The vectors `v1` and `v2` start at `s1` and `s2`. They are opposite, but not exactly
    antiparallel. The integral counts 1 or 2 `sides` of the centre.
    """
    # (1) extend both vectors until they meet
    steps = np.linalg.solve(np.column_stack([v1, -v2]), s2 - s1)
    meeting = s1 + steps[0] * v1
    # (2) the common line goes through this point and halves the angle between v1 and -v2
    line = v1 / np.hypot(*v1) - v2 / np.hypot(*v2)
    line /= np.hypot(*line)
    # (4) the centre of the line is the projection of the midpoint of the starts
    middle = meeting + line * float((s1 + s2) / 2 @ line - meeting @ line)
    # (3) project both vectors on the line; positions count from the centre
    ends = [float((point - middle) @ line) for point in (s1, s1 + v1, s2, s2 + v2)]
    x = np.linspace(-1.01, 1.01, _SAMPLES) * max(map(abs, ends))
    in_first = (x >= min(ends[:2])) & (x <= max(ends[:2]))
    in_second = (-x >= min(ends[2:])) & (-x <= max(ends[2:]))
    symmetric = float(np.sum(in_first & in_second) * (x[1] - x[0]))
    total = abs(ends[1] - ends[0]) + abs(ends[3] - ends[2])
    a, b, c, d = (middle + line * end for end in ends)
    return _Construction(line, meeting, middle, (a, b, c, d), sides * symmetric / total)


def _differences() -> tuple[float, float]:
    """Return the largest differences from the closed form, for two sides and for one side."""
    random = np.random.default_rng(_SEED)
    worst = {1: 0.0, 2: 0.0}
    for _ in range(_PAIRS):
        angle, between = random.uniform(0, 2 * np.pi), np.deg2rad(random.uniform(1, 29))
        turned = angle + np.pi + between
        v1 = random.uniform(0.5, 3) * np.array([np.cos(angle), np.sin(angle)])
        v2 = random.uniform(0.5, 3) * np.array([np.cos(turned), np.sin(turned)])
        s1, s2 = random.uniform(-5, 5, (2, 2))
        for sides, difference in worst.items():
            numeric = _construct(s1, v1, s2, v2, sides).ratio
            worst[sides] = max(difference, abs(numeric - float(rmo(v1, v2, sides))))
    return worst[2], worst[1]


def _draw_definition() -> Figure:
    with styled_figure(WIDE, 3.6) as figure:
        left, right = figure.subfigures(1, 2, width_ratios=[1.1, 1.2], squeeze=False)[0]
        _draw_construction(left.subplots())
        panels = right.subplots(2, 4)
        for panel, (name, values) in zip(panels.flat, _PATTERNS.items(), strict=True):
            _draw_pattern(panel, name, np.array(values, float))
    return figure


def _draw_construction(axes: Axes) -> None:
    s1, v1 = np.array([-1.4, 0.6]), np.array([-1.9, 1.9])
    s2, v2 = np.array([1.2, -0.7]), np.array([3.0, -1.4])
    steps = _construct(s1, v1, s2, v2)
    for reach in (-3.6, 4.2):
        _segment(axes, steps.middle, steps.middle + reach * steps.line, color=FAINT, lw=0.8)
    for number, (start, vector) in enumerate(((s1, v1), (s2, v2)), 1):
        colour = CYCLE[number - 1]
        _segment(axes, start, steps.meeting, color=colour, lw=0.7, linestyle=":")
        _arrow(axes, start, vector, colour)
        axes.annotate(f"$v_{number}$", _xy(start + 0.6 * vector), (0, 5), color=colour,
                      textcoords="offset points")  # fmt: skip
        first, last = steps.projections[2 * number - 2 : 2 * number]
        for point, end in ((start, first), (start + vector, last)):
            _segment(axes, point, end, color=colour, lw=0.5, linestyle="--")
        _segment(axes, first, last, color=colour, lw=3, alpha=0.45)
        for index, end in enumerate((first, last), 1):
            axes.annotate(f"$P_{{{number}{index}}}$", _xy(end), (-4, -10), fontsize=6.5,
                          textcoords="offset points", color=colour)  # fmt: skip
    _segment(axes, s1, s2, color=INK, lw=0.5)
    named = (((s1 + s2) / 2, "M", -9), (steps.middle, "$M_e$", 5), (steps.meeting, "$P_i$", 5))
    for point, name, up in named:
        axes.plot(*point, "o", color=INK, markersize=2.5)
        axes.annotate(name, _xy(point), (0, up), textcoords="offset points")
    line_end = _xy(steps.middle + 4.0 * steps.line)
    axes.annotate("$l_e$", line_end, (-2, 6), textcoords="offset points")
    axes.set_title(f"construction: RMO = {steps.ratio:.2f}")
    axes.set(aspect="equal", xticks=[], yticks=[])
    axes.invert_yaxis()
    axes.axis("off")


def _pattern(name: str) -> RmoMetrics:
    s1, v1, s2, v2 = np.array(_PATTERNS[name], float)
    return rmo_metrics(np.array([s1, s2]), np.array([v1, v2]))


def _draw_pattern(axes: Axes, name: str, values: NDArray[np.float64]) -> None:
    s1, v1, s2, v2 = values
    metrics = _pattern(name)
    for start, vector, colour in ((s1, v1, CYCLE[0]), (s2, v2, CYCLE[1])):
        _arrow(axes, start, vector, colour)
        axes.plot(*start, "o", color=colour, markersize=2)
    value = f"RMO {metrics.rmo_max:.2f}" if metrics.rom_pairs else "\u2715 no ROM pair"
    axes.set_title(f"{name}\n{value}", fontsize=6.5)
    axes.set(xlim=(-4, 4), ylim=(3, -3), aspect="equal", xticks=[], yticks=[])
    for spine in axes.spines.values():
        spine.set(visible=True, color=FAINT, linewidth=0.5)


def _segment(axes: Axes, start: Point, end: Point, **look: object) -> None:
    axes.plot([start[0], end[0]], [start[1], end[1]], **look)  # type: ignore[arg-type]


def _arrow(axes: Axes, start: Point, vector: Point, colour: str) -> None:
    arrow = {"arrowstyle": "-|>", "color": colour, "shrinkA": 0, "shrinkB": 0, "lw": 1.3}
    axes.annotate("", xy=_xy(start + vector), xytext=_xy(start), arrowprops=arrow)


def _xy(point: Point) -> tuple[float, float]:
    return float(point[0]), float(point[1])


def stimuli() -> Built:
    """Compare the RMO index of looming and other stimuli."""
    by_frame = {"looming": _indices(_LOOMING), "other": _indices(_OTHERS)}
    looming, others = (
        {name: np.array(list(indices.values())) for name, indices in shown.items()}
        for shown in by_frame.values()
    )
    least = min(float(index.min()) for index in looming.values())
    worst = max(others, key=lambda name: float(others[name].max()))
    most = float(others[worst].max())
    typical, other = (np.median(np.concatenate(list(kind.values()))) for kind in (looming, others))
    overlap = ClaimVerdict.IN_PART if typical > other else ClaimVerdict.DOES_NOT
    finding = Finding(
        f"The index is at least {least:.2f} in looming frames and at most {most:.2f} in "
        f"others ({worst.partition('/')[2]}); the medians are {typical:.2f} and {other:.2f}.",
        ClaimVerdict.HOLDS if least > most else overlap,
        {
            "least_of_looming": least,
            "largest_of_others": most,
            "median_of_looming": float(typical),
            "median_of_others": float(other),
        },
    )
    return Built.of(
        "rmo-stimuli",
        [Claim.of("rmo-looming", {NO_DETECTOR: finding})],
        _draw_stimuli(looming, others),
        (
            {"kind": kind, "stimulus": name, "frame": frame, "rmo_index": index}
            for kind, shown in by_frame.items()
            for name, indices in shown.items()
            for frame, index in indices.items()
        ),
        settings={NO_DETECTOR: f"{_HEIGHT} px"},
    )


def _indices(changes: dict[str, dict[str, list[int]]]) -> dict[str, dict[int, float]]:
    """Return the RMO index by stimulus and frame; stimuli that move too slowly are left out."""
    indices = {
        protocol.name: _index(protocol)
        for name, changed in changes.items()
        for protocol in load_all(name, {**NO_PAUSE, **changed})
    }
    return {name: index for name, index in indices.items() if index}


def _index(protocol: Protocol) -> dict[int, float]:
    """Return the RMO index by frame, of frames in which an edge is fast enough or objects turn."""
    flow, scale = DenseFlow(), _HEIGHT / protocol.display.height
    turning = any(shown.motion and shown.motion.rotation_deg_s for shown in protocol.objects)
    values = {}
    for frame in StimulusVideo(protocol, _HEIGHT):
        motion = flow.step(frame.luma, frame.time_s)
        moving = [truth for truth in frame_truth(protocol, frame.index).objects if truth.visible]
        speed = max((abs(truth.edge_speed_px_frame) for truth in moving), default=0.0) * scale
        if motion is not None and (speed > _SLOWEST or turning):
            values[frame.index] = rmo_of(motion, RmoParams()).rmo_index
    return values


def _draw_stimuli(looming: dict[str, Index], others: dict[str, Index]) -> Figure:
    rows = [*looming.items(), *others.items()]
    with styled_figure(WIDE, 0.6 + 0.2 * len(rows)) as figure:
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
