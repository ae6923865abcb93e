"""Fit ``opplod_lplc2`` to published peaks, with cross-validation over stimulus families.

    python -m tools.fit_lplc2 [PEAKS.csv] [--free inward,lateral] [--state fit.npz]
    python -m tools.fit_lplc2 --peaks-only --cross-validate
    python -m tools.fit_lplc2 --ablate

The program computes the pooled motion of each stimulus once. A differential evolution then searches
the named parameters for small differences from the peaks, and for phenomena (statements of several
papers) within their ranges. docs/development/lplc2-fit.md describes the fit and its result.
"""  # fmt: skip

from __future__ import annotations

import argparse
import csv
import math
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from scipy.optimize import differential_evolution

from oppload_cli.errors import OpploadError, ParameterError, ResultError
from oppload_cli.models.layers import Layers
from oppload_cli.models.opplod_lplc2 import (
    AXES,
    DIRECTIONS,
    OpplodLplc2,
    OpplodLplc2Params,
    arm_response,
    arm_weights,
    field_weights,
)
from oppload_cli.models.timebase import Clock
from oppload_cli.pipeline.sources import StimulusVideo
from oppload_cli.reproduction.lplc2 import (
    BATTERY,
    LOOM,
    Row,
    axis_of,
    phenomena,
)
from oppload_cli.stimulus.catalogue import load_all
from oppload_cli.tuning.present import low_passed

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from oppload_cli.stimulus.protocol import Protocol

    Floats = NDArray[np.float64]

REFERENCE = Path(__file__).parent.parent / "oppload_cli/reference/lplc2_klapoetke2017.csv"
# Ranges of the search; those marked by True are searched on a logarithmic scale.
RANGES: dict[str, tuple[float, float, bool]] = {
    "arm_cone": (40, 90, False),
    "suppression_cone": (15, 90, False),
    "suppression_field": (0.8, 2.2, False),
    "inward": (0.1, 50, True),
    "lateral": (0.1, 50, True),
    "surround": (0.003, 10, True),
    "suppression_s": (0.02, 0.2, True),
    "half_saturation": (1e-5, 1, True),
    "saturation": (0.3, 3, False),
    "threshold": (0, 1.5, False),
    "arm_power": (0.5, 5, False),
    "calcium_s": (0.05, 1, True),
}
# Places at 15 degrees from the centre. There, neurons respond to the loom with at least half of
# their response at the centre.
OFF_CENTRE = ((15.0, 0.0), (10.6, 10.6))
# The value of a parameter that switches its part off.
ABLATIONS: dict[str, dict[str, object]] = {
    "inward suppression": {"inward": 0.0},
    "lateral suppression": {"lateral": 0.0},
    "normalisation by the field": {"surround": 0.0},
    "slow suppression": {"suppression_s": 0.0},
    "saturation and division": {"half_saturation": 1e4, "threshold": 0.0},
    "calcium low-pass": {"calcium_s": 0.0},
    "no response to the first motion after rest": {"history": 0.0},
}
INSIDE = 1.03  # the search narrows the ranges of the phenomena by this factor at both ends
MISS = 2.0  # weight of a phenomenon outside its range, relative to the weight of a peak
AS_GOOD = 1.1  # solutions up to this many times the least mean square error count as equally good


@dataclass(frozen=True)
class Target:
    """One published peak: its stimulus in the catalogue, its family, and its value."""

    stimulus: str
    family: str
    peak: float


def read_reference(path: Path) -> list[Target]:
    """Read published peaks.

    Parameters
    ----------
    path : Path
        A CSV file with the columns ``stimulus``, ``axis_deg``, ``width_deg`` and
        ``peak_relative_to_loom``. Stimuli have the names of their entries in the catalogue, without
        ``klapoetke2017/``, or those in the package's own file.

    Raises
    ------
    ResultError
        If a stimulus is unknown or has two rows, a peak is no finite number or below 0, or the loom
        is missing.
    """
    try:
        with path.open(encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
    except (OSError, UnicodeError) as error:
        raise ResultError(f"{path}: cannot be read ({error}); give a CSV file of peaks") from None
    targets: list[Target] = []
    for number, row in enumerate(rows, 2):
        target = _target(f"{path}: line {number}", row)
        if any(target.stimulus == other.stimulus for other in targets):
            raise ResultError(
                f"{path}: line {number}: stimulus '{target.stimulus}' has two rows; keep one"
            )
        targets.append(target)
    if not any(target.family == LOOM for target in targets):
        raise ResultError(f"{path}: has no row of 'loom'; add one, since peaks are relative to it")
    return targets


def _target(where: str, row: Mapping[str, str | None]) -> Target:
    name, axis = row.get("stimulus") or "", row.get("axis_deg") or ""
    for word in ("right", "down"):  # the axis says this too
        name = name.removesuffix(f"_{word}")
    width = row.get("width_deg") or ""
    for family in BATTERY:
        same_width = not width or family.width_deg == _number(width)
        if name in {family.name, family.published} and same_width:
            break
    else:
        raise ResultError(f"{where}: no stimulus '{name}' with width '{width}' in the battery")
    members = [member.name for member in load_all(f"klapoetke2017/{family.name}")]
    wanted = [
        member
        for member in members
        if len(members) == 1 or (axis and member.endswith(f"-{_number(axis):g}"))
    ]
    if len(wanted) != 1:
        raise ResultError(f"{where}: stimulus '{name}' has no axis '{axis}'")
    peak = _number(row.get("peak_relative_to_loom") or "")
    if not 0 <= peak < math.inf:
        raise ResultError(f"{where}: the peak must be a number of at least 0")
    return Target(wanted[0], family.name, peak)


def _number(text: str) -> float:
    """Return the number of a cell; NaN if its text is no number."""
    try:
        return float(text)
    except ValueError:
        return math.nan


def stands_for(name: str) -> str:
    """Return the stimulus with an axis of 0 to 45 degrees that causes the same response.

    The four arms are cardinal. So quarter turns and mirror images of a stimulus change nothing.
    """
    axis = axis_of(name)
    if axis is None:
        return name
    return f"{name.rpartition('-')[0]}-{min(axis % 90, -axis % 90):g}"


class Battery:
    """The pooled motion of every stimulus, which the arms of the middle unit weigh.

    Parameters
    ----------
    stimuli : iterable of str
        Names in the catalogue; the loom is added.
    params : OpplodLplc2Params
        The battery uses their cells and field throughout.
    off_centre : iterable of (float, float)
        Centres of further looms, in degrees from the centre of the middle unit.
    """

    def __init__(
        self,
        stimuli: Iterable[str],
        params: OpplodLplc2Params,
        off_centre: Iterable[tuple[float, float]] = (),
    ) -> None:
        self.params = params
        self.loom = f"klapoetke2017/{LOOM}"
        self.stimuli = list(dict.fromkeys((self.loom, *stimuli)))
        shown = {stands_for(name): load_all(name) for name in reversed(self.stimuli)}
        for place in off_centre:
            shown[_at(place)] = load_all(self.loom, {"disk.centre_deg": list(place)})
        motion = [self._motion(*protocols) for protocols in shown.values()]
        self.columns = {name: column for column, name in enumerate(shown)}
        self.off_centre = [_at(place) for place in off_centre]
        self.frames = [len(maps) for maps in motion]
        self.times = np.arange(max(self.frames)) / 30
        self.maps = np.concatenate(motion)

    def _motion(self, protocol: Protocol) -> NDArray[np.float32]:
        """Return the amount of motion and its four parts in each cell, one row per frame."""
        video = StimulusVideo(protocol, 240)
        shape = video.working.height, video.working.width
        layers = Layers(shape, Clock())
        dpc = layers.dpc(self.params.scaled(min(shape)), AXES)
        arms = OpplodLplc2(shape, self.params)
        maps = []
        for frame in video:
            layers.clock.time_s = frame.time_s
            maps.append(np.zeros((5, *arms.units.responses.shape), np.float32))
            if dpc.step(frame.luma):
                maps[-1][0], maps[-1][1:] = arms.pooled(dpc.layer)
        return np.asarray(maps, np.float32).reshape(len(maps), -1)

    def peaks(self, values: Mapping[str, float]) -> dict[str, float]:
        """Return the peaks, divided by that of the loom, with some parameters changed.

        Peaks have the names of the stimuli; those of looms off the centre are ``loom at X, Y``.
        """
        params = self.params.replaced(**values).resolved(240)
        inputs = np.zeros((len(self.times), len(self.frames), 2 * len(DIRECTIONS)))
        by_frame = self.maps @ self._weights(params)
        for column, part in enumerate(np.split(by_frame, np.cumsum(self.frames)[:-1])):
            inputs[: len(part), column] = part
        suppression = low_passed(inputs[..., 4:], self.times, params.suppression_s)
        total = arm_response(
            inputs[..., :4].astype(np.float32),
            suppression.astype(np.float32),
            params.half_saturation,
            params.saturation,
        ).sum(axis=-1)
        above = np.maximum(total - params.threshold, 0) ** params.arm_power
        found = low_passed(above, self.times, params.calcium_s).max(axis=0)
        loom = found[self.columns[stands_for(self.loom)]] or 1e-12
        peaks = {name: found[self.columns[stands_for(name)]] / loom for name in self.stimuli}
        return peaks | {place: found[self.columns[place]] / loom for place in self.off_centre}

    def _weights(self, params: OpplodLplc2Params) -> NDArray[np.float32]:
        """Return the weight of each value of `maps` for the middle unit.

        The columns are the excitations of the four arms, then their suppressions.
        """
        reach = params.field_px / 2 / params.cell_px
        further = reach * params.suppression_field
        side = math.isqrt(self.maps.shape[1] // 5)

        def framed(kernel: NDArray[np.float32]) -> NDArray[np.float32]:
            over = (len(kernel) - side) // 2
            inner = slice(max(0, over), max(0, over) + side)
            return np.pad(kernel, max(0, -over))[inner, inner].ravel()

        weights = np.zeros((5, side * side, 8), np.float32)
        weights[0, :, 4:] = params.surround * framed(field_weights(reach))[:, np.newaxis]
        for arm, phi in enumerate(DIRECTIONS):
            weights[arm + 1, :, arm] = framed(arm_weights(reach, phi, params.arm_cone))
            suppressed = framed(arm_weights(further, phi, params.suppression_cone))
            for turn, strength in ((1, params.lateral), (2, params.inward), (3, params.lateral)):
                weights[(arm + turn) % 4 + 1, :, arm + 4] = strength * suppressed
        return weights.reshape(-1, 8)


def _at(place: tuple[float, float]) -> str:
    return f"loom at {place[0]:g}, {place[1]:g}"


MEMBERS = {
    member.name: family for family in BATTERY for member in load_all(f"klapoetke2017/{family.name}")
}


def misses(peaks: Mapping[str, float], without: str = "") -> list[float]:
    """Return each phenomenon's distance from its range, divided by the end of the range.

    Phenomena that need the family `without`, or stimuli without a peak, are left out.
    """
    rows = [
        Row(
            family.name, axis_of(name), family.width_deg, "",
            math.nan if family.name == without else peaks.get(name, math.nan), None,
        )
        for name, family in MEMBERS.items()
    ]  # fmt: skip
    found = list(phenomena(rows).values())
    found += [(peaks.get(_at(place), math.nan), 0.5, 1.0) for place in OFF_CENTRE]
    return [
        max(low * INSIDE / (value + 1e-12) - 1, value * INSIDE / high - 1, 0.0)
        for value, low, high in found
        if not math.isnan(value)
    ]


def _check_count(free: Sequence[str], targets: Sequence[Target]) -> None:
    """Raise a ParameterError if there are more parameters than rows other than the loom's."""
    rows = sum(target.family != LOOM for target in targets)
    if len(free) > rows:
        raise ParameterError(
            f"--free names {len(free)} parameters for {rows} rows; free fewer, or add rows"
        )


def fit(
    battery: Battery,
    targets: Sequence[Target],
    free: Sequence[str],
    *,
    seed: int,
    generations: int,
    state: Path | None = None,
    without: str = "",
) -> tuple[Floats, Floats]:
    """Search the free parameters; a ParameterError if there are more of them than rows.

    A phenomenon 1 % outside its range counts like a peak with an error of `MISS` times 0.01; no
    phenomenon counts more than an error of 1. Phenomena that need the family `without` do not
    count.

    Returns
    -------
    population : ndarray, shape (n, parameters)
        Parameters, the best first; logarithms where `RANGES` says so.
    errors : ndarray, shape (n,)
        Their mean square errors.
    """
    _check_count(free, targets)
    rows = [target for target in targets if target.family != LOOM]

    def error(point: Floats) -> float:
        peaks = battery.peaks(_values_of(free, point))
        errors = [peaks[row.stimulus] - row.peak for row in rows]
        errors += [min(MISS * miss, 1.0) for miss in misses(peaks, without)]
        return float(np.square(errors).sum() / len(rows))

    bounds = [np.log(RANGES[name][:2]) if RANGES[name][2] else RANGES[name][:2] for name in free]
    start: Floats | str = "latinhypercube"
    if state is not None and state.exists():
        start = np.load(state)["population"]

    def keep(intermediate_result: object) -> None:
        if state is not None:
            with state.open("wb") as file:  # NumPy would add a suffix to a name without one
                np.savez(file, population=intermediate_result.population)  # type: ignore[attr-defined]

    found = differential_evolution(
        error, bounds, rng=seed, popsize=6, maxiter=generations, tol=1e-8, polish=False,
        init=start, callback=keep,
    )  # fmt: skip
    order = np.argsort(found.population_energies)
    return found.population[order], found.population_energies[order]


def _values_of(free: Sequence[str], point: Floats) -> dict[str, float]:
    """Return the parameters at one point of the search."""
    return {
        name: float(np.exp(value) if RANGES[name][2] else value)
        for name, value in zip(free, point, strict=True)
    }


def _likeness(peaks: Mapping[str, float], rows: Sequence[Target]) -> tuple[float, float]:
    """Return Pearson's r of the peaks of model and neurons, and their rms difference."""
    model = np.array([peaks[row.stimulus] for row in rows])
    neurons = np.array([row.peak for row in rows])
    r = float(np.corrcoef(model, neurons)[0, 1]) if np.ptp(model) and len(rows) > 1 else np.nan
    return r, float(np.sqrt(np.mean((model - neurons) ** 2)))


def _cross_validated(
    battery: Battery,
    targets: Sequence[Target],
    free: Sequence[str],
    *,
    seed: int,
    generations: int,
    state: Path | None = None,
) -> tuple[float, float]:
    """Return r and rms, with each family of stimuli predicted by a fit to the other families.

    Each family has its own file of the search's state, beside that of the fit.
    """
    rows = [target for target in targets if target.family != LOOM]
    predicted: dict[str, float] = {}
    for family in dict.fromkeys(row.family for row in rows):
        others = [target for target in targets if target.family != family]
        own = state and state.with_name(f"{state.stem}-{family}.npz")
        population, _ = fit(
            battery, others, free,
            seed=seed, generations=generations, state=own, without=family,
        )  # fmt: skip
        peaks = battery.peaks(_values_of(free, population[0]))
        held_out = [row for row in rows if row.family == family]
        predicted.update({row.stimulus: peaks[row.stimulus] for row in held_out})
        pairs = [f"{predicted[row.stimulus]:.3f} ({row.peak:g})" for row in held_out]
        print(f"without {family}: {', '.join(pairs)}", flush=True)
    return _likeness(predicted, rows)


def _ablated(
    battery: Battery, targets: Sequence[Target]
) -> Iterator[tuple[str, tuple[float, float]]]:
    """Yield r and rms with each part switched off, and nothing else changed."""
    rows = [target for target in targets if target.family != LOOM]
    for part, values in ABLATIONS.items():
        if values.keys() <= RANGES.keys():  # the pooled motion does not depend on these parameters
            peaks = battery.peaks(cast("Mapping[str, float]", values))
        else:
            changed = battery.params.replaced(**values)
            peaks = Battery([row.stimulus for row in rows], changed).peaks({})
        yield part, _likeness(peaks, rows)


def main(arguments: Sequence[str] | None = None) -> int:
    """Fit, print the parameters with their spread, and cross-validate if asked."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "reference", type=Path, nargs="?", default=REFERENCE, help="published peaks"
    )
    parser.add_argument(
        "--free", default=",".join(RANGES), metavar="NAMES", help="parameters to search (all)"
    )
    parser.add_argument("--seed", type=int, default=1, help="seed of the search (1)")
    parser.add_argument("--generations", type=int, default=60, help="most generations (60)")
    parser.add_argument(
        "--cross-validate", action="store_true", help="predict each family by a fit to the others"
    )
    parser.add_argument(
        "--state", type=Path, metavar="FILE", help="keep the search here, and continue it from here"
    )
    parser.add_argument("--peaks-only", action="store_true", help="leave the phenomena out")
    parser.add_argument("--ablate", action="store_true", help="switch parts off; no fit")
    chosen = parser.parse_args(arguments)
    free = chosen.free.split(",")
    try:
        unknown = [name for name in free if name not in RANGES]
        if unknown:
            raise ParameterError(f"--free: no parameter '{unknown[0]}'; one of {', '.join(RANGES)}")
        targets = read_reference(chosen.reference)
        _check_count(free, targets)
        params = OpplodLplc2Params()
        stimuli = [target.stimulus for target in targets]
        battery = (
            Battery(stimuli, params)
            if chosen.peaks_only or chosen.ablate
            else Battery([*stimuli, *MEMBERS], params, OFF_CENTRE)
        )
        rows = [target for target in targets if target.family != LOOM]
        result = _likeness(battery.peaks({}), rows)
        print("opplod_lplc2: r {:.3f}, rms {:.3f}".format(*result), flush=True)
        if chosen.ablate:
            for part, result in _ablated(battery, targets):
                print("without {}: r {:.3f}, rms {:.3f}".format(part, *result), flush=True)
            return 0
        search: dict[str, Any] = {
            "seed": chosen.seed,
            "generations": chosen.generations,
            "state": chosen.state,
        }
        population, errors = fit(battery, targets, free, **search)
        found = battery.peaks(_values_of(free, population[0]))
        print("fit: r {:.3f}, rms {:.3f}".format(*_likeness(found, rows)))
        good = population[errors <= AS_GOOD * errors[0]]
        print(f"{len(good)} solutions within {AS_GOOD:g} times the least mean square error:")
        solutions = [_values_of(free, point) for point in good]
        for name in free:
            values = [solution[name] for solution in solutions]
            print(f"  {name} {values[0]:.4g} ({min(values):.4g} to {max(values):.4g})")
        if chosen.cross_validate:
            result = _cross_validated(battery, targets, free, **search)
            print("cross-validated over families: r {:.3f}, rms {:.3f}".format(*result))
    except OpploadError as error:
        print(f"fit_lplc2: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
