"""Measure the costs that the docs state: annotated videos, staged clips, growth, many inputs.

    python -m benchmarks.costs [--only PART] [--rounds N] [--video FILE ...]

The parts are annotated, staged, growth and batch; only growth takes videos of your own. All costs
are processor times; those of commands include their start. Two ways are measured in turns. Each
line has the median, the smallest and the largest value. Ratios are alike on different machines,
times are not.
"""  # fmt: skip

from __future__ import annotations

import argparse
import shutil
import statistics
import tempfile
import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from benchmarks.bench import COMMAND, LENGTHS, h264
from benchmarks.references import processor_s
from oppload_cli.models.registry import detector_named
from oppload_cli.pipeline.analysis import analyse
from oppload_cli.stimulus import frames
from oppload_cli.stimulus.catalogue import load_all
from oppload_cli.video.source import open_video

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from oppload_cli.models.dpc import Map

EVALUATED = ["opplod", "dlgmd", "flow_divergence", "frame_difference"]
KINDS = {
    "camera at rest": ("collision", "crossing", "receding"),
    "camera that moves": ("forward", "shake", "collision-pan"),
}
FEW, MANY = 20, 10_000  # inputs of a small and of a large batch


def _line(title: str, values: Sequence[float], unit: str) -> str:
    median = statistics.median(values)
    return f"{title}: {median:.3g} {unit} ({min(values):.3g} to {max(values):.3g})"


def _run_s(path: Path, *words: str) -> float:
    """Return the processor time in seconds of `oppload run` on a file or a folder."""
    with tempfile.TemporaryDirectory() as folder:
        return processor_s([COMMAND, "run", str(path), "-o", folder, "-q", *words])


def _annotated(rounds: int, _videos: Sequence[Path]) -> Iterator[str]:
    """Compare runs that annotate with runs that do not."""
    for width, height in ((432, 240), (768, 432), (1280, 720)):
        path = h264(width, height, LENGTHS[0])
        pairs = [(_run_s(path, "--annotate"), _run_s(path)) for _ in range(rounds)]
        with tempfile.TemporaryDirectory() as folder:
            processor_s([COMMAND, "run", str(path), "-o", folder, "-q", "--annotate"])
            [annotated] = Path(folder).glob("*.annotated.mp4")
            kilobytes = annotated.stat().st_size / 1e3 / LENGTHS[0]
        title = f"{width} x {height}: a run that annotates"
        yield _line(title, [a / b for a, b in pairs], "times the processor time")
        yield _line("  more per frame", [1e3 * (a - b) / LENGTHS[0] for a, b in pairs], "ms")
        yield _line("  file per frame", [kilobytes], "kB")


def _staged(rounds: int, _videos: Sequence[Path]) -> Iterator[str]:
    """Compare the drawing of staged clips with the detectors that run over them."""
    for title, kinds in KINDS.items():
        drawing, running = [], []
        for protocol in (one for kind in kinds for one in load_all(f"staged/{kind}")[:rounds]):
            begun = time.process_time()
            pictures = np.stack([frame.grey for frame in frames(protocol)])
            drawn = time.process_time()
            for _ in analyse(pictures, EVALUATED, rate=protocol.display.frame_rate, rmo=False):
                pass
            drawing.append(drawn - begun)
            running.append(time.process_time() - drawn)
        yield _line(f"{title}: drawing a clip", drawing, "s")
        yield _line("  the four detectors on it", running, "s")


def _model_s(lumas: Sequence[Map], name: str) -> float:
    """Return the processor time in seconds of a detector alone, with its flow if it needs one."""
    height, width = lumas[0].shape
    model = detector_named(name)((height, width))
    begun = time.process_time()
    for luma in lumas:
        model.step(luma)
    return time.process_time() - begun


def _growth(rounds: int, videos: Sequence[Path]) -> Iterator[str]:
    """Compare `opplod` with `opplod_reference`, on the benchmark's scene or on videos."""
    for path in videos or [h264(1280, 720, LENGTHS[0])]:
        with open_video(path) as video:
            lumas = [frame.luma for frame in video]
        alone, runs = [], []
        for _ in range(rounds):
            alone.append(_model_s(lumas, "opplod") / _model_s(lumas, "opplod_reference"))
            runs.append(_run_s(path) / _run_s(path, "--model", "opplod_reference,dlgmd"))
        yield _line(f"{path.name}: model alone", alone, "times opplod_reference")
        yield _line(f"{path.name}: complete run", runs, "times opplod_reference")


def _batch(rounds: int, _videos: Sequence[Path]) -> Iterator[str]:
    """Measure an input of a batch, planning and collecting."""
    clip = h264(320, 240, 3)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        few, many, results = folder / "few", folder / "many", folder / "results"
        for count, place in ((FEW, few), (MANY, many)):
            place.mkdir()
            for number in range(count):
                (place / f"{number:05d}.mp4").hardlink_to(clip)
        pairs = [(_run_s(few, "--jobs", "1"), _run_s(clip)) for _ in range(rounds)]
        yield _line("a run of one clip of 3 frames", [one for _, one in pairs], "s")
        yield _line("each further clip of a batch", [(a - b) / (FEW - 1) for a, b in pairs], "s")
        planning = [_run_s(many, "--dry-run") for _ in range(rounds)]
        yield _line(f"planning {MANY} inputs", planning, "s")
        processor_s([COMMAND, "run", str(clip), "-o", str(folder / "one"), "-q"])
        results.mkdir()
        [sidecar] = (folder / "one").glob("*.json")
        for number in range(MANY):
            shutil.copy(sidecar, results / f"{number:05d}{sidecar.name.removeprefix(clip.stem)}")
        for suffix in ("csv", "parquet"):
            collect = [COMMAND, "collect", str(results), "-q", "--if-exists", "overwrite", "-o"]
            collecting = [processor_s([*collect, f"{folder}/all.{suffix}"]) for _ in range(rounds)]
            yield _line(f"collecting {MANY} sidecars as {suffix}", collecting, "s")


PARTS = {"annotated": _annotated, "staged": _staged, "growth": _growth, "batch": _batch}


def main() -> None:
    """Measure the chosen parts, all by default, and print a line per cost."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=3, help="turns that are measured (3)")
    parser.add_argument("--only", choices=PARTS, action="append", help="the part to run")
    parser.add_argument(
        "--video", type=Path, action="append", default=[], help="a video for the part growth"
    )
    options = parser.parse_args()
    for name in options.only or PARTS:
        for line in PARTS[name](options.rounds, options.video):
            print(line, flush=True)


if __name__ == "__main__":
    main()
