"""Measure speed, in turns with references; write JSON and Markdown into benchmarks/results.

    python -m benchmarks.bench [--only PART ...] [--rounds N] [--cores N] [--video FILE ...]

Only the part `options` takes videos of your own. benchmarks/README.md describes the method.
"""  # fmt: skip

from __future__ import annotations

import argparse
import itertools
import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from dataclasses import asdict, dataclass
from fractions import Fraction
from functools import partial
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Any

import av
import cv2
import numpy as np

from benchmarks import decoding, references
from oppload_cli.environment import environment
from oppload_cli.models.bank import DetectorBank
from oppload_cli.models.dlgmd import DlgmdParams, group, threshold
from oppload_cli.models.layers import Layers
from oppload_cli.models.opplod_reference import OpplodReference, enhanced
from oppload_cli.models.registry import parameters_of
from oppload_cli.motion.flow import DenseFlow, rmo_of
from oppload_cli.motion.rmo import RmoParams
from oppload_cli.video.source import open_video
from oppload_cli.video.writers import ON_ANY_PROCESSOR

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from numpy.typing import NDArray

    Luma = NDArray[np.float32]

RESULTS = Path(__file__).parent / "results"
COMMAND = str(Path(sys.executable).with_name("oppload"))  # the command that users call
LENGTHS = (600, 1800)  # frames of a run: the start-up is a smaller part of a longer run
SAVING = {
    "defaults": "",
    "--no-rmo": "--no-rmo",
    "--model opplod": "--model opplod",
    "both": "--no-rmo --model opplod",
    "--model opplod_reference,dlgmd": "--model opplod_reference,dlgmd",
    "--height 120": "--height 120",
}
STREAMS = {
    "Y4M": ("rawvideo", "yuv4mpegpipe"),
    "MJPEG in Matroska": ("mjpeg", "matroska"),
    "H.264 in a transport stream": ("libx264", "mpegts"),
    "H.264 without a container": ("libx264", "h264"),
}


# ---- Videos and frames, which follow from a seed ---------------------------------------------


def _scene(width: int, height: int, frames: int) -> Iterator[NDArray[np.uint8]]:
    """Yield colour pictures: a drifting texture, and a disk that looms again and again."""
    rng = np.random.default_rng(1)
    coarse = rng.integers(0, 256, (height // 8, (width + 2 * frames) // 8 + 2, 3), np.uint8)
    ground = cv2.resize(coarse, (width + 2 * frames + 16, height), interpolation=cv2.INTER_CUBIC)
    for t in range(frames):
        image = np.array(ground[:, 2 * t : 2 * t + width], np.uint8)
        radius = int(height * 0.02 / max(0.02, 1 - (t % 90) / 90))
        cv2.circle(image, (width // 2, height // 2), min(radius, height), (20, 20, 20), -1)
        yield image


def h264(width: int, height: int, frames: int) -> Path:
    """Return an H.264 file of the scene; make it if it does not exist."""
    path = RESULTS / f"scene-{width}x{height}-{frames}.mp4"
    if path.exists():
        return path
    RESULTS.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(".part.mp4")
    with av.open(str(part), "w") as container:
        options = {"preset": "veryfast", "crf": "23", **ON_ANY_PROCESSOR}
        stream: Any = container.add_stream("libx264", rate=Fraction(30), options=options)
        stream.codec_context.thread_count = 1  # another number gives other bytes
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        for image in _scene(width, height, frames):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="bgr24")))
        container.mux(stream.encode())
    part.rename(path)
    return path


def _luminance(width: int, height: int, frames: int) -> list[Luma]:
    """Return the luminance of the scene, frame by frame."""
    return [
        cv2.cvtColor(image, cv2.COLOR_BGR2GRAY).astype(np.float32) / np.float32(255)
        for image in _scene(width, height, frames)
    ]


# ---- Measurements ----------------------------------------------------------------------------


@dataclass(frozen=True)
class _Measurement:
    """One row of the table: a ratio to a reference, or an absolute value."""

    title: str  # names the measured thing and its reference
    must: str  # bound for the median
    aim: str  # bound that a later version should keep
    median: float
    smallest: float
    largest: float
    unit: str
    seconds: float  # median of the absolute times, for orientation


def _measurement(
    title: str, must: str, aim: str, values: Sequence[float], unit: str, *, seconds: float = 0.0
) -> _Measurement:
    median = statistics.median(values)
    return _Measurement(title, must, aim, median, min(values), max(values), unit, seconds)


def _times(rounds: int, *functions: Callable[[], object]) -> list[list[float]]:
    """Call functions in turns; return the times of each in s, without those of a first round."""
    times: list[list[float]] = [[] for _ in functions]
    for count in range(rounds + 1):
        for function, own in zip(functions, times, strict=True):
            begun = time.perf_counter()
            function()
            if count:
                own.append(time.perf_counter() - begun)
    return times


def _ratio(  # noqa: PLR0917 - a row of the table
    title: str,
    must: str,
    aim: str,
    ours: Callable[[], object],
    other: Callable[[], object],
    rounds: int,
    *,
    faster: bool = False,
    per_call: float = 1.0,
) -> _Measurement:
    """Measure the ratio of our time to the other's; with `faster`, of the other's time to ours.

    One call of `ours` processes `per_call` times as many frames as one call of `other`.
    """
    our_times, other_times = _times(rounds, ours, other)
    ratios = [a / (per_call * b) for a, b in zip(our_times, other_times, strict=True)]
    unit, seconds = "ratio", statistics.median(our_times)
    if faster:
        ratios, unit = [1 / ratio for ratio in ratios], "times as fast"
    return _measurement(title, must, aim, ratios, unit, seconds=seconds)


def _bank(shape: tuple[int, int], opplod: str = "opplod_reference") -> DetectorBank:
    """Return both models of the paper, OppLoD in one of its versions."""
    return DetectorBank(shape, [parameters_of(name) for name in (opplod, "dlgmd")])


def _models(frames: Sequence[Luma], opplod: str = "opplod_reference") -> Callable[[], None]:
    """Return a function that passes frames through both models."""
    bank = _bank(frames[0].shape, opplod)

    def once() -> None:
        for luma in frames:
            bank.step(luma)

    return once


def _rmo() -> Callable[[Luma], None]:
    """Return a function that measures flow and RMO of the next frame at 30 frames/s."""
    flow, number, params = DenseFlow(), itertools.count(), RmoParams()

    def step(luma: Luma) -> None:
        found = flow.step(luma, next(number) / 30)
        if found is not None:
            rmo_of(found, params)

    return step


def _run_command(path: Path) -> list[str]:
    """Return the command `oppload run` on a file or a folder; its results replace earlier ones."""
    return [
        *(COMMAND, "run", str(path), "-o", str(RESULTS / "out"), "-q"),
        *("--model", "opplod_reference,dlgmd", "--if-exists", "overwrite"),
    ]


def _runs(rounds: int) -> Iterator[_Measurement]:
    """Measure complete runs against bare decoding and against PySceneDetect."""
    for width, height, must, aim in ((1920, 1080, "1.6", "1.15"), (1280, 720, "2.2", "1.3")):
        for frames in LENGTHS:
            path = h264(width, height, frames)
            ours = partial(references.run, _run_command(path))
            yield _ratio(
                f"oppload run, {height}p H.264, {frames} frames, time divided by bare decoding",
                f"<= {must}", aim,
                ours, partial(references.run, references.decode_command(path)), rounds,
            )  # fmt: skip
            theirs = references.scenedetect_command(path)
            if theirs is not None:
                yield _ratio(
                    f"oppload run, {height}p, {frames} frames, against scenedetect detect-content",
                    ">= 1", "1.5",
                    ours, partial(references.run, theirs), rounds, faster=True,
                )  # fmt: skip


def _models_alone(rounds: int) -> Iterator[_Measurement]:
    """Measure the models without decoding."""
    small = _luminance(427, 240, 60)
    [times] = _times(rounds, _models(small))  # one thread computes frames of this size
    yield _measurement(
        "models alone, 427 x 240, one core: frames/s", ">= 400", "1000",
        [len(small) / seconds for seconds in times], "frames/s", seconds=statistics.median(times),
    )  # fmt: skip
    large = _luminance(1280, 720, 12)
    ours = _models(large)
    yield _ratio(
        "models alone, 1280 x 720, against DIS ultrafast and divergence", ">= 1", "2",
        ours, partial(references.dis, large), rounds, faster=True,
    )  # fmt: skip
    yield _ratio(
        "models alone, 1280 x 720, against Farneback and divergence", ">= 15", "40",
        ours, partial(references.farneback, large), rounds, faster=True,
    )  # fmt: skip
    paper = _luminance(800, 600, 6)
    for opplod, must, aim in (("opplod_reference", ">= 20", "60"), ("opplod_paper", ">= 8", "20")):
        yield _ratio(
            f"{opplod}, 800 x 600, against the literal reference", must, aim,
            _models(paper, opplod),
            partial(references.literal, paper[:4], paper=opplod == "opplod_paper"),
            rounds, faster=True, per_call=len(paper),
        )  # fmt: skip


def _stages(rounds: int) -> Iterator[_Measurement]:
    """Measure the time of each stage per frame of 427 x 240, in ms."""
    frames = _luminance(427, 240, 60)
    shape, dlgmd = (240, 427), DlgmdParams()
    layers = Layers(shape)
    opplod, grouped = OpplodReference(shape, layers=layers), np.zeros(shape, np.float32)
    dpc = layers.dpc(opplod.params, opplod.params.both_axes).layer
    flow = _rmo()

    def grouping(_: Luma) -> None:
        t = threshold(dlgmd, dpc.photoreceptors.means[2])
        group(dpc.sums.presynaptic, dlgmd.group_size, t, dlgmd.grouped_limit, grouped)

    parts: list[tuple[str, Callable[[Luma], object]]] = [
        ("P, DPC and MDE", dpc.step),
        ("OMJ and enhancing", lambda _: enhanced(opplod._opponency(dpc), 1.0, 0.0)),
        ("D-LGMD grouping", grouping),
        ("flow and RMO", flow),
        ("table row", lambda luma: ",".join(f"{value:.9g}" for value in luma[0, :20].tolist())),
    ]
    for luma in frames[:4]:
        dpc.step(luma)
    for name, part in parts:

        def once(part: Callable[[Luma], object] = part) -> None:
            for luma in frames:
                part(luma)

        [times] = _times(rounds, once)
        costs = [1e3 * seconds / len(frames) for seconds in times]
        yield _measurement(
            f"stage: {name}", "", "", costs, "ms/frame", seconds=statistics.median(times)
        )
    path = h264(1280, 720, LENGTHS[0])

    def read() -> None:
        with open_video(path) as video:
            for _ in video:
                pass

    yield _ratio(
        "stage: decode and resize, 720p, time divided by bare decoding", "", "",
        read, lambda: decoding.decode(path), rounds,
    )  # fmt: skip


def _options(rounds: int, videos: Sequence[Path] = ()) -> Iterator[_Measurement]:
    """Measure the processor time of complete runs, and the share of it that options save."""
    for path in videos or [h264(1280, 720, LENGTHS[0])]:
        costs: dict[str, list[float]] = {name: [] for name in SAVING}
        begun = time.perf_counter()
        for _ in range(rounds):
            for name, words in SAVING.items():
                with tempfile.TemporaryDirectory() as folder:
                    command = [COMMAND, "run", str(path), "-o", folder, "-q", *words.split()]
                    costs[name].append(references.processor_s(command))
        usual = costs.pop("defaults")
        seconds = time.perf_counter() - begun
        each_ms = [1e3 * cost / decoding.decode(path) for cost in usual]
        yield _measurement(f"{path.name}: a frame", "", "", each_ms, "ms", seconds=seconds)
        for name, own in costs.items():
            saved = [100 * (1 - b / a) for a, b in zip(usual, own, strict=True)]
            title = f"{path.name}: processor time saved, {name}"
            yield _measurement(title, "", "", saved, "%", seconds=statistics.median(own))


def _jobs(rounds: int) -> Iterator[_Measurement]:
    """Measure many short clips in two processes against one."""
    with tempfile.TemporaryDirectory() as folder:
        for number in range(200):
            shutil.copy(h264(320, 240, 30), Path(folder) / f"{number}.mp4")
        command = [*_run_command(Path(folder)), "--jobs"]
        yield _ratio(
            "200 clips of 30 frames, --jobs 2 against --jobs 1", "", "",
            partial(references.run, [*command, "2"]), partial(references.run, [*command, "1"]),
            rounds, faster=True,
        )  # fmt: skip


def _start(rounds: int) -> Iterator[_Measurement]:
    """Measure the start-up of the command."""
    helped, bare = _times(
        4 * rounds,
        lambda: references.run([COMMAND, "--help"]),
        lambda: references.run([sys.executable, "-c", "pass"]),
    )
    extra = [1e3 * (a - b) for a, b in zip(helped, bare, strict=True)]
    title = "oppload --help minus a bare interpreter's start"
    yield _measurement(title, "<= 60", "40", extra, "ms", seconds=statistics.median(helped))


def _memory(_rounds: int) -> Iterator[_Measurement]:
    """Measure the peak memory of complete runs."""
    for frames in (150, LENGTHS[0]):
        peak = _peak_mb(_run_command(h264(1920, 1080, frames)))
        yield _measurement(f"peak memory, 1080p, {frames} frames", "<= 250", "150", [peak], "MB")


def _peak_mb(command: Sequence[str]) -> float:
    """Return the sum of the peaks of a process and of the processes that it starts (Linux only).

    The sum is an upper bound, because shared memory counts once for each process.
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


def _scaling(rounds: int) -> Iterator[_Measurement]:
    """Fit the cost as a power of the number of pixels, and of the number of frames."""
    sizes = [(128, 72), (256, 144), (512, 288), (1280, 720)]
    costs = []
    for width, height in sizes:
        [times] = _times(rounds, _models(_luminance(width, height, 12)))
        costs.append(min(times))
    pixels = [width * height for width, height in sizes]
    yield _exponent("cost of the models against pixels", pixels, costs)
    frames = _luminance(128, 72, 1)
    counts = [10, 100, 1000]
    totals = []
    for count in counts:
        once, passes = _models(frames * count), counts[-1] // count
        # Fewer frames get more passes, so that all measurements last as long and have equal noise.
        [times] = _times(rounds, lambda: [once() for _ in range(passes)])  # noqa: B023
        totals.append(min(times) / passes)
    yield _exponent("cost of the models against frames", counts, totals)


def _exponent(title: str, sizes: Sequence[float], costs: Sequence[float]) -> _Measurement:
    """Fit cost = c size^k, and return k."""
    k = float(np.polyfit(np.log(sizes), np.log(costs), 1)[0])
    return _measurement(f"{title}: exponent", "<= 1.05", "1.0", [k], "exponent", seconds=costs[-1])


def _live(_rounds: int) -> Iterator[_Measurement]:
    """Measure the time from a frame to its response at 720p and 30 frames/s, 99th percentile."""
    images = [(luma * 255).astype(np.uint8) for luma in _luminance(1280, 720, 60)]
    bank = _bank((240, 427))
    flow = _rmo()
    latencies = []
    for index in range(150):
        begun = time.perf_counter()
        luma = cv2.resize(images[index % 60], (427, 240), interpolation=cv2.INTER_AREA)
        grey = luma.astype(np.float32) / np.float32(255)
        bank.step(grey)
        flow(grey)
        latencies.append(1e3 * (time.perf_counter() - begun))
        time.sleep(max(0.0, 1 / 30 - (time.perf_counter() - begun)))
    late = latencies[10:]
    yield _Measurement(
        "live: frame in to response out, 720p at 30 frames/s, 99th percentile", "<= 33", "5",
        float(np.percentile(late, 99)), min(late), max(late), "ms", 0.0,
    )  # fmt: skip


def _latency(_rounds: int) -> Iterator[_Measurement]:
    """Measure the time from writing a frame into a pipe to reading its row, at 30 frames/s."""
    frames = [
        av.VideoFrame.from_ndarray(image, format="bgr24").reformat(format="yuv420p")
        for image in _scene(1280, 720, 150)
    ]
    for name, (codec, container) in STREAMS.items():
        written: list[float] = []
        read: list[float] = []
        command = [COMMAND, "run", "/dev/stdin", "-o", "-", "-q"]
        with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as run:
            pipe: Any = run.stdin
            reader = Thread(target=_note_lines, args=(run.stdout, read))
            reader.start()
            with pipe, av.open(pipe, "w", format=container) as out:
                options = {"preset": "veryfast", "tune": "zerolatency"}
                stream: Any = out.add_stream(codec, rate=30, options=options)
                stream.width, stream.height = 1280, 720
                stream.pix_fmt = "yuvj420p" if codec == "mjpeg" else "yuv420p"
                packets = [stream.encode(frame.reformat(format=stream.pix_fmt)) for frame in frames]
                begun = time.perf_counter()
                for number, packet in enumerate(packets):
                    time.sleep(max(0.0, begun + number / 30 - time.perf_counter()))
                    written.append(time.perf_counter())
                    out.mux(packet)
                    pipe.flush()
                out.mux(stream.encode())
            reader.join()
        # The first line holds the names of the columns; the first frames wait for the start.
        late = [1e3 * (b - a) for a, b in zip(written, read[1:], strict=True)][60:]
        yield _measurement(f"latency: {name}", "", "", late, "ms")


def _note_lines(lines: Iterator[bytes], read: list[float]) -> None:
    """Append the time at which each line can be read."""
    read.extend(time.perf_counter() for _ in lines)


PARTS: dict[str, Callable[[int], Iterator[_Measurement]]] = {
    "runs": _runs,
    "models": _models_alone,
    "stages": _stages,
    "start": _start,
    "memory": _memory,
    "scaling": _scaling,
    "live": _live,
    "options": _options,
    "jobs": _jobs,
    "latency": _latency,
}


def _page(measured: Sequence[_Measurement], machine: dict[str, Any]) -> str:
    """Return the results as Markdown."""
    lines = [
        "# Benchmark",
        f"{machine['platform']}, {machine['cores']} cores, Python {machine['python']}.",
        "",
        "| measurement | must | aim | median | smallest | largest | unit |",
        "|---|---|---|---|---|---|---|",
    ]
    lines += [
        f"| {one.title} | {one.must} | {one.aim} | {one.median:.3g} | {one.smallest:.3g} "
        f"| {one.largest:.3g} | {one.unit} |"
        for one in measured
    ]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Run the chosen parts, all by default."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=5, help="turns that are measured (5)")
    parser.add_argument("--only", choices=PARTS, action="append", help="the part to run")
    parser.add_argument("--cores", type=int, help="use only this many cores")
    parser.add_argument(
        "--video", type=Path, action="append", default=[], help="a video for the part options"
    )
    options = parser.parse_args()
    parts = PARTS | {"options": partial(_options, videos=options.video)}
    if options.cores:
        os.sched_setaffinity(0, set(sorted(os.sched_getaffinity(0))[: options.cores]))
        cv2.setNumThreads(options.cores)
    measured = []
    for name in options.only or PARTS:
        for one in parts[name](options.rounds):
            print(f"{one.title}: {one.median:.3g} {one.unit}", flush=True)
            measured.append(one)
    machine = environment()
    RESULTS.mkdir(exist_ok=True)
    content = {"machine": machine, "measurements": [asdict(one) for one in measured]}
    (RESULTS / "bench.json").write_text(json.dumps(content, indent=2) + "\n")
    (RESULTS / "bench.md").write_text(_page(measured, machine))
    print(f"\n{RESULTS / 'bench.md'}")


if __name__ == "__main__":
    main()
