"""``oppload models``."""

from __future__ import annotations

import json
import time
from typing import TYPE_CHECKING, Any

import click
import cv2
import numpy as np

from oppload_cli.cli import options
from oppload_cli.errors import ParameterError, suggestion
from oppload_cli.models.registry import detector_named, detectors
from oppload_cli.models.timebase import FRAME
from oppload_cli.pipeline.settings import parameter_sets
from oppload_cli.schema import AUTO

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from click.shell_completion import CompletionItem
    from numpy.typing import NDArray

    from oppload_cli.models.detector import Detector
    from oppload_cli.schema import Parameters

# To measure costs: measured frames, frames before these, and rounds.
_MEASURED_FRAMES, _FIRST_FRAMES, _ROUNDS = 24, 8, 3
# Attributes of a detector that `--json` prints.
_FACTS = (
    "label", "meaning", "by_default", "year", "reference", "answers_to", "made_for", "cost_ms",
    "places", "height", "interval",
)  # fmt: skip


def _complete(_: click.Context, __: click.Parameter, text: str) -> list[CompletionItem]:
    return options.completions(text, dict.fromkeys(parameter_sets(), ""))


@click.command()
@click.argument("names", nargs=-1, metavar="[NAME]...", shell_complete=_complete)
@click.option("--measure", is_flag=True, help="Measure the cost of a frame on this machine.")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def models(names: tuple[str, ...], measure: bool, as_json: bool) -> None:
    """List the detectors, a line for each.

    NAME is a detector, or a group of settings (alarm, places, rmo, repeats, time). The
    command then describes NAME with every parameter and its default. --measure prints the
    processor time that each detector takes for a frame of 427 x 240 on one core.
    """
    if measure:
        if as_json:
            raise ParameterError("--measure prints no JSON; leave out --json")
        for detector in [detector_named(name) for name in names] or list(detectors().values()):
            click.echo(f"{detector.name:<20}{_measured_cost(detector):>8.2f} ms per frame")
        return
    known = list(parameter_sets())
    for name in names:
        if name not in known:
            raise ParameterError(f"no detector or settings '{name}'{suggestion(name, known)}")
    if as_json:
        click.echo(json.dumps(_described(names), indent=2))
    elif names:
        for name in names:
            _describe(name)
    else:
        _list()


def _list() -> None:
    click.secho(
        "detectors  (ms per frame of 427 x 240 on one core; stimuli that cause a response)",
        bold=True,
    )
    for name, detector in detectors().items():
        cost = f"{detector.cost_ms:g}" if detector.cost_ms else ""
        click.echo(f"  {name:<20}{cost:>5}  {detector.answers_to or detector.meaning}")
    groups = ", ".join(name for name in parameter_sets() if name not in detectors())
    click.echo(
        f"\n'oppload models NAME' describes a detector with its parameters, and the settings of\n"
        f"{groups}."
    )


def _describe(name: str) -> None:
    sets = parameter_sets()
    meaning, kind = sets[name]
    click.secho(f"{name}  ({meaning})", bold=True)
    facts = _facts(detectors()[name]) if name in detectors() else ()
    for line in (*facts, *_lines(kind)):
        click.echo(f"  {line}")
    click.echo()


def _measured_cost(detector: type[Detector]) -> float:
    """Return the processor time of a detector's step, in ms: the least median of three rounds.

    The input is faint texture that moves, 16:9 at the height of the detector. It runs on one core.
    """
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        size = detector.height, round(detector.height * 16 / 9)
        texture = cv2.GaussianBlur(np.random.default_rng(1).random(size), (0, 0), 2)
        texture = 0.4 + 0.2 * (texture - texture.min()) / np.ptp(texture)
        least = min(_median_cost(detector, texture) for _ in range(_ROUNDS))
    finally:
        cv2.setNumThreads(threads)
    return least * 1e3


def _median_cost(detector: type[Detector], texture: NDArray[np.float64]) -> float:
    model, spent = detector(texture.shape, frame_rate=30), []
    for t in range(_FIRST_FRAMES + _MEASURED_FRAMES):
        frame = np.roll(texture, (t, 2 * t), (0, 1)).astype(np.float32)
        started = time.process_time()
        model.step(frame)
        spent.append(time.process_time() - started)
    return float(np.median(spent[_FIRST_FRAMES:]))


def _facts(detector: type[Detector]) -> Iterator[str]:
    if detector.reference:
        year_is_named = not detector.year or str(detector.year) in detector.reference
        yield f"source: {detector.reference}{'' if year_is_named else f', {detector.year}'}"
    if detector.answers_to:
        yield f"responds to: {detector.answers_to}"
    if detector.made_for:
        yield f"made for: {detector.made_for}"
    counts = "; counts frames, not seconds" if detector.interval == FRAME else ""
    yield f"working height: {detector.height} px{counts}"
    rule = detector.alarm
    times = f", and {rule.factor:g} times the median of the background" if rule.factor else ""
    lasting = f", for {rule.enough_s:g} s of {rule.window_s:g} s" if rule.enough_s else ""
    none = rule.floor is None
    yield f"no alarm: {rule.why_none}" if none else f"alarm: above {rule.floor:g}{times}{lasting}"
    if detector.places:
        yield "places: a box for each looming object"
    if detector.cost_ms:
        yield f"cost: about {detector.cost_ms:g} ms per frame of its working size on one core"


def _lines(params: type[Parameters]) -> Iterator[str]:
    defaults = params().as_dict()
    rows = [
        (
            parameter.name,
            AUTO if defaults[parameter.name] is None else str(defaults[parameter.name]),
            parameter.unit,
            parameter.meaning + (f" ({parameter.allowed})" if parameter.allowed else ""),
        )
        for parameter in params.declared()
    ]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    for name, default, unit, meaning in rows:
        yield f"{name:<{widths[0]}}  {default:>{widths[1]}} {unit:<{widths[2]}}  {meaning}"


def _entries(params: type[Parameters]) -> Iterator[dict[str, Any]]:
    defaults = params().as_dict()
    facts = "name", "default", "meaning", "unit", "low", "above", "high"
    for parameter in params.declared():
        described = {fact: getattr(parameter, fact) for fact in facts}
        yield described | {"default": defaults[parameter.name], "choices": list(parameter.choices)}


def _described(names: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Return the facts about some detectors and settings; without names, about all."""
    sets = parameter_sets()
    everything: dict[str, dict[str, Any]] = {
        "models": {
            name: {
                **{fact: getattr(detector, fact) for fact in _FACTS},
                "alarm": detector.alarm._asdict(),
            }
            for name, detector in detectors().items()
        },
        "parameters": {name: list(_entries(params)) for name, (_, params) in sets.items()},
    }
    return {
        title: {name: facts for name, facts in table.items() if name in names or not names}
        for title, table in everything.items()
    }
