"""Measure speed in turns with references; write JSON and Markdown."""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import cv2
import numpy as np

from benchmarks import decoding, media, references
from oppload_cli.environment import environment
from oppload_cli.models.dlgmd import DlgmdParams, group, threshold
from oppload_cli.models.layers import Dpc
from oppload_cli.models.opposing_motion import PooledJudgement
from oppload_cli.models.registry import DetectorBank, default_names, parameters_of
from oppload_cli.motion.flow import DenseFlow
from oppload_cli.video.source import open_video

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from numpy.typing import NDArray

    from oppload_cli.models.opplod_parameters import OpplodParams

    Luma = NDArray[np.float32]

RESULTS = Path(__file__).parent / "results"
COMMAND = str(Path(sys.executable).with_name("oppload"))  # the command that users call
LENGTHS = (600, 1800)  # frames of a run: the start-up counts for less in a longer one


@dataclass(frozen=True)
class Measurement:
    """One row of the table: a ratio to a reference, or an absolute value.

    Attributes
    ----------
    title : str
        The thing that was measured, and its reference.
    must, aim : str
        The bound that the median has to keep, and the one to come to.
    median, smallest, largest : float
        Value over the rounds, in `unit`.
    seconds : float
        Median of the absolute times, for orientation.
    """

    title: str
    must: str
    aim: str
    median: float
    smallest: float
    largest: float
    unit: str
    seconds: float


def by_turns(
    a: Callable[[], object], b: Callable[[], object], rounds: int
) -> tuple[list[float], list[float]]:
    """Return the times of a and b in s, called in turns after one round that does not count."""
    times: tuple[list[float], list[float]] = ([], [])
    for count in range(rounds + 1):
        for each, taken in zip((a, b), times, strict=True):
            start = time.perf_counter()
            each()
            if count:
                taken.append(time.perf_counter() - start)
    return times


def ratio(  # noqa: PLR0917 - a row of the table
    title: str,
    must: str,
    aim: str,
    ours: Callable[[], object],
    other: Callable[[], object],
    rounds: int,
    *,
    faster: bool = False,
    per_call: float = 1.0,
) -> Measurement:
    """Return the ratio of our time to the other's; with `faster`, the other's time to ours.

    One call of `ours` processes `per_call` times as many frames as one call of `other`.
    """
    mine, theirs = by_turns(ours, other, rounds)
    ratios = [
        per_call * b / a if faster else a / (per_call * b)
        for a, b in zip(mine, theirs, strict=True)
    ]
    return Measurement(
        title, must, aim, statistics.median(ratios), min(ratios), max(ratios),
        "times as fast" if faster else "ratio", statistics.median(mine),
    )  # fmt: skip


def both(shape: tuple[int, int], preset: str = "reference") -> DetectorBank:
    """Return both models of the paper."""
    return DetectorBank(shape, [parameters_of(name, preset) for name in default_names()])


def models(frames: Sequence[Luma], preset: str = "reference") -> Callable[[], None]:
    """Return a function that passes frames through both models."""
    bank = both(frames[0].shape, preset)

    def once() -> None:
        for luma in frames:
            bank.step(luma)

    return once


def run_command(path: Path, *options: str) -> list[str]:
    """Return the command `oppload run` on a file."""
    folder = tempfile.mkdtemp(prefix="oppload-bench-")
    return [
        *(COMMAND, "run", str(path), "-o", folder, "-q"),
        *("--preset", "reference", "--if-exists", "overwrite", *options),
    ]


def runs(rounds: int) -> Iterator[Measurement]:
    """Measure complete runs against bare decoding and against PySceneDetect."""
    for width, height, must, aim in ((1920, 1080, "1.6", "1.15"), (1280, 720, "2.2", "1.3")):
        for frames in LENGTHS:
            path = media.h264(RESULTS, width, height, frames)
            ours = run_command(path)
            yield ratio(
                f"oppload run, {height}p H.264, {frames} frames, over bare decoding",
                f"<= {must}", aim,
                partial(references.run, ours),
                partial(references.run, references.decode_command(path)),
                rounds,
            )  # fmt: skip
            theirs = references.scenedetect_command(path)
            if theirs is not None:
                yield ratio(
                    f"oppload run, {height}p, {frames} frames, against scenedetect detect-content",
                    ">= 1", "1.5",
                    partial(references.run, ours),
                    partial(references.run, theirs),
                    rounds, faster=True,
                )  # fmt: skip


def models_alone(rounds: int) -> Iterator[Measurement]:
    """Measure the models without decoding."""
    small = media.luminance(427, 240, 60)
    ours = models(small)  # frames of this size are left to one thread
    mine, _ = by_turns(ours, lambda: None, rounds)
    rates = [len(small) / each for each in mine]
    yield Measurement(
        "models alone, 427 x 240, one core: frames/s", ">= 400", "1000",
        statistics.median(rates), min(rates), max(rates), "frames/s", statistics.median(mine),
    )  # fmt: skip
    large = media.luminance(1280, 720, 12)
    ours_large = models(large)
    yield ratio(
        "models alone, 1280 x 720, against DIS ultrafast and divergence", ">= 1", "2",
        ours_large, partial(references.dis, large), rounds, faster=True,
    )  # fmt: skip
    yield ratio(
        "models alone, 1280 x 720, against Farneback and divergence", ">= 15", "40",
        ours_large, partial(references.farneback, large), rounds, faster=True,
    )  # fmt: skip
    paper = media.luminance(800, 600, 6)
    for preset, must, aim in (("reference", ">= 20", "60"), ("paper", ">= 8", "20")):
        is_paper = preset == "paper"
        yield ratio(
            f"preset {preset}, 800 x 600, against the literal reference", must, aim,
            models(paper, preset),
            partial(references.literal, paper[:4], paper=is_paper),
            rounds, faster=True, per_call=len(paper),
        )  # fmt: skip


def stages(rounds: int) -> Iterator[Measurement]:
    """Measure the time of each stage per frame of 427 x 240, in ms."""
    frames = media.luminance(427, 240, 60)
    opplod = cast("OpplodParams", parameters_of("opplod", "reference")).resolved(240)
    shape, dlgmd = (240, 427), DlgmdParams()
    dpc = Dpc(shape, opplod, opplod.both_axes)
    judgement, grouped, flow = (
        PooledJudgement(shape, opplod),
        np.zeros(shape, np.float32),
        DenseFlow(),
    )

    def grouping(_: Luma) -> None:
        t = threshold(dlgmd, dpc.photoreceptors.means[2])
        group(dpc.sums.presynaptic, dlgmd.group_size, t, dlgmd.grouped_limit, grouped)

    parts: list[tuple[str, Callable[[Luma], object]]] = [
        ("P, DPC and MDE", dpc.step),
        ("OMJ and enhancing", lambda _: judgement.judge(dpc)),
        ("D-LGMD grouping", grouping),
        ("flow and RMO", flow.step),
        ("table row", lambda luma: ",".join(f"{value:.9g}" for value in luma[0, :20].tolist())),
    ]
    for luma in frames[:4]:
        dpc.step(luma)
    for name, part in parts:

        def once(part: Callable[[Luma], object] = part) -> None:
            for luma in frames:
                part(luma)

        mine, _ = by_turns(once, lambda: None, rounds)
        each = [1e3 * value / len(frames) for value in mine]
        yield Measurement(
            f"stage: {name}", "", "", statistics.median(each), min(each), max(each), "ms/frame",
            statistics.median(mine),
        )  # fmt: skip
    path = media.h264(RESULTS, 1280, 720, LENGTHS[0])

    def read() -> None:
        with open_video(path) as video:
            for _ in video:
                pass

    yield ratio(
        "stage: decode and resize, 720p, over bare decoding", "", "",
        read, lambda: decoding.decode(path), rounds,
    )  # fmt: skip


def start(rounds: int) -> Iterator[Measurement]:
    """Measure the start-up of the command."""
    helped, bare = by_turns(
        lambda: references.run([COMMAND, "--help"]),
        lambda: references.run([sys.executable, "-c", "pass"]),
        4 * rounds,
    )
    extra = [1e3 * (a - b) for a, b in zip(helped, bare, strict=True)]
    yield Measurement(
        "oppload --help over a bare interpreter's start", "<= 60", "40",
        statistics.median(extra), min(extra), max(extra), "ms", statistics.median(helped),
    )  # fmt: skip


def memory(_rounds: int) -> Iterator[Measurement]:
    """Measure the peak memory of complete runs."""
    for frames in (150, LENGTHS[0]):
        peak = _peak_mb(run_command(media.h264(RESULTS, 1920, 1080, frames)))
        yield Measurement(
            f"peak memory, 1080p, {frames} frames", "<= 250", "150", peak, peak, peak, "MB", 0.0
        )


def _peak_mb(command: Sequence[str]) -> float:
    """Return the peaks of a process and of those that it starts, added up (Linux only).

    Memory that they share counts more than once, so that the sum is an upper bound.
    """
    peaks: dict[str, int] = {}
    with subprocess.Popen(command) as run:
        while run.poll() is None:
            with suppress(FileNotFoundError, ProcessLookupError):
                started = Path(f"/proc/{run.pid}/task/{run.pid}/children").read_text().split()
                for process in (str(run.pid), *started):
                    status = Path(f"/proc/{process}/status").read_text()
                    for line in status.splitlines():
                        if line.startswith("VmHWM:"):
                            peaks[process] = int(line.split()[1])
            time.sleep(0.005)
    return sum(peaks.values()) / 1024


def scaling(rounds: int) -> Iterator[Measurement]:
    """Fit the cost as a power of the number of pixels, and of the number of frames."""
    sizes = [(128, 72), (256, 144), (512, 288), (1280, 720)]
    costs = []
    for width, height in sizes:
        frames = media.luminance(width, height, 12)
        times, _ = by_turns(models(frames), lambda: None, rounds)
        costs.append(min(times))
    pixels = [width * height for width, height in sizes]
    yield exponent("cost of the models against pixels", pixels, costs)
    frames = media.luminance(128, 72, 1)
    counts = [10, 100, 1000]
    totals = []
    for count in counts:
        once, passes = models(frames * count), counts[-1] // count
        # More passes over fewer frames: a shorter measurement would meet less of the noise.
        times, _ = by_turns(lambda: [once() for _ in range(passes)], lambda: None, rounds)  # noqa: B023
        totals.append(min(times) / passes)
    yield exponent("cost of the models against frames", counts, totals)


def exponent(title: str, sizes: Sequence[float], costs: Sequence[float]) -> Measurement:
    """Fit cost = c size^k, and return k."""
    k = float(np.polyfit(np.log(sizes), np.log(costs), 1)[0])
    return Measurement(f"{title}: exponent", "<= 1.05", "1.0", k, k, k, "exponent", costs[-1])


def live(_rounds: int) -> Iterator[Measurement]:
    """Measure the time from a frame to its response at 720p and 30 frames/s, 99th percentile."""
    images = [(luma * 255).astype(np.uint8) for luma in media.luminance(1280, 720, 60)]
    bank = both((240, 427))
    flow = DenseFlow()
    latencies = []
    for index in range(150):
        begun = time.perf_counter()
        luma = cv2.resize(images[index % 60], (427, 240), interpolation=cv2.INTER_AREA)
        grey = luma.astype(np.float32) / np.float32(255)
        bank.step(grey)
        flow.step(grey)
        latencies.append(1e3 * (time.perf_counter() - begun))
        time.sleep(max(0.0, 1 / 30 - (time.perf_counter() - begun)))
    late = latencies[10:]
    yield Measurement(
        "live: frame in to response out, 720p at 30 frames/s, 99th percentile", "<= 33", "5",
        float(np.percentile(late, 99)), min(late), max(late), "ms", 0.0,
    )  # fmt: skip


PARTS: dict[str, Callable[[int], Iterator[Measurement]]] = {
    "runs": runs,
    "models": models_alone,
    "stages": stages,
    "start": start,
    "memory": memory,
    "scaling": scaling,
    "live": live,
}


def table(measured: Sequence[Measurement], machine: dict[str, Any]) -> str:
    """Return the Markdown page."""
    lines = [
        "# Benchmark",
        f"{machine['platform']}, {machine['cores']} cores, Python {machine['python']}.",
        "",
        "| measurement | must | aim | median | smallest | largest | unit |",
        "|---|---|---|---|---|---|---|",
    ]
    lines += [
        f"| {each.title} | {each.must} | {each.aim} | {each.median:.3g} | {each.smallest:.3g} "
        f"| {each.largest:.3g} | {each.unit} |"
        for each in measured
    ]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Run the chosen parts, all by default."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--only", choices=PARTS, action="append")
    parser.add_argument("--cores", type=int, help="use only this many cores")
    options = parser.parse_args()
    if options.cores:
        os.sched_setaffinity(0, set(sorted(os.sched_getaffinity(0))[: options.cores]))
        cv2.setNumThreads(options.cores)
    measured = []
    for name in options.only or PARTS:
        for each in PARTS[name](options.rounds):
            print(f"{each.title}: {each.median:.3g} {each.unit}", flush=True)
            measured.append(each)
    machine = environment()
    RESULTS.mkdir(exist_ok=True)
    content = {"machine": machine, "measurements": [asdict(each) for each in measured]}
    (RESULTS / "bench.json").write_text(json.dumps(content, indent=2) + "\n")
    (RESULTS / "bench.md").write_text(table(measured, machine))
    print(f"\n{RESULTS / 'bench.md'}")


if __name__ == "__main__":
    main()
