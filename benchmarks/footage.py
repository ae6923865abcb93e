"""Measure what the coding of a video does to responses: its size, and repeats of its pictures.

    python -m benchmarks.footage sizes VIDEO ... [--frames N]
    python -m benchmarks.footage repeats VIDEO ... [--frames N]

Each video is coded anew in several ways (H.264), and every one goes through the analysis of
``oppload run``. `sizes`: at 360, 720, 1080 and 2160 rows, against 720. `repeats`: every picture
twice at twice the rate, exactly and coded anew, and every second picture at 12 per second in 30
frames/s, each against a file that shows every picture once at its own rate.
"""

from __future__ import annotations

import argparse
from fractions import Fraction
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, NamedTuple

import av
import numpy as np

from oppload_cli.detection.parameters import alarm_params
from oppload_cli.models.registry import parameters_of
from oppload_cli.pipeline.analysis import analyse
from oppload_cli.pipeline.repeats import RepeatParams, Repeats
from oppload_cli.video.source import open_video

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from numpy.typing import NDArray

    Planes = Iterable[NDArray[np.uint8]]

HEIGHTS = (360, 720, 1080, 2160)
AGAINST = 720
SIZES_CRF = 18
CRFS = (23, 28, 35)
DETECTORS = (("opplod", "default"), ("opplod", "reference"), ("dlgmd", "default"))
LOSSLESS = None


class Answer(NamedTuple):
    """What a detector answers to a video.

    Attributes
    ----------
    peak : float
        Largest response.
    floor : float
        A quarter of the floor of its alarm; which of two lower peaks is larger means nothing.
    alarms_s : list of float
        When its alarm went on.
    """

    peak: float
    floor: float
    alarms_s: list[float]


def coded(
    path: Path, planes: Planes, rate: Fraction, crf: int | None, height: int | None = None
) -> Path:
    """Write grey pictures as an H.264 video.

    Parameters
    ----------
    path : Path
        Of the new file.
    planes : iterable of ndarray of uint8, shape (rows, columns)
        The pictures, of one shape.
    rate : Fraction
        Frames per second.
    crf : int or None
        Constant rate factor; None keeps every value of luma.
    height : int, optional
        Rows to which the pictures are resized (bicubic; smaller ones by area); even.
    """
    options = {"preset": "veryfast", "crf": str(crf)} if crf else {"preset": "ultrafast", "qp": "0"}
    with av.open(str(path), "w") as container:
        stream: Any = container.add_stream("libx264", rate=rate, options=options)
        for index, plane in enumerate(planes):
            rows, columns = plane.shape
            down = height or rows // 2 * 2
            across = round(columns * down / rows / 2) * 2
            if not index:
                stream.height, stream.width, stream.pix_fmt = down, across, "yuv420p"
            picture = av.VideoFrame.from_ndarray(plane, format="gray").reformat(
                across, down, "yuv420p", interpolation="AREA" if down < rows else "BICUBIC"
            )
            container.mux(stream.encode(picture))
        container.mux(stream.encode())
    return path


def answers(
    path: Path, detectors: Sequence[tuple[str, str]] = DETECTORS
) -> tuple[dict[str, Answer], Repeats]:
    """Return the answers to a video by detector and preset, and what was known of its repeats."""
    found: dict[str, Answer] = {}
    repeats = Repeats(RepeatParams())
    for preset in dict.fromkeys(preset for _, preset in detectors):
        names = [name for name, each in detectors if each == preset]
        repeats = Repeats(RepeatParams())
        with open_video(path) as video:
            records = list(
                analyse(
                    video, [parameters_of(name, preset) for name in names],
                    alarm=alarm_params(preset), places=None, rmo=None, repeats=repeats,
                )
            )  # fmt: skip
        for name in names:
            responses = [each.response for record in records if (each := record.responses[name])]
            on = [False, *(record.alarms[name] for record in records)]
            begun = [r.time_s for r, was in zip(records, on, strict=False) if r.alarms[name] > was]
            floor = alarm_params(preset).floor_of(name) / 4
            found[f"{name}, {preset}"] = Answer(max(responses, default=0.0), floor, begun)
    return found, repeats


def planes(path: Path, count: int) -> Iterator[NDArray[np.uint8]]:
    """Yield the first pictures of a video in grey."""
    with av.open(str(path)) as container:
        for picture in islice(container.decode(video=0), count):
            yield np.asarray(picture.to_ndarray(format="gray"), np.uint8)


def rate_of(path: Path) -> Fraction:
    """Return the frames per second that a video declares."""
    with av.open(str(path)) as container:
        return Fraction(container.streams.video[0].average_rate or 30)


def compared(here: Answer, there: Answer) -> tuple[float, float]:
    """Return the ratio of the peaks, and how far apart the alarms are in seconds.

    NaN where neither has one; infinite where their number differs.
    """
    ratio = max(here.peak, here.floor) / max(there.peak, here.floor)
    if len(here.alarms_s) != len(there.alarms_s):
        return ratio, float("inf")
    apart = np.subtract(here.alarms_s, there.alarms_s)
    return ratio, float(apart[np.abs(apart).argmax()]) if len(apart) else float("nan")


def sizes(path: Path, count: int, folder: Path) -> Iterator[tuple[str, Path, Path]]:
    """Yield what is compared: the same video in other sizes."""
    for crf in (LOSSLESS, SIZES_CRF):
        files = {
            height: coded(
                folder / f"{height}-{crf}.mp4", planes(path, count), rate_of(path), crf, height
            )
            for height in HEIGHTS
        }
        for height in HEIGHTS:
            how = f"CRF {crf}" if crf else "lossless"
            yield f"{height} rows, {how}", files[height], files[AGAINST]


def repeated(
    shown: Sequence[NDArray[np.uint8]], rate: Fraction, folder: Path
) -> Iterator[tuple[str, Path, Path]]:
    """Yield what is compared: pictures that a file shows more than once, and once."""
    twice = [each for each in shown for _ in range(2)]
    slow = shown[::2]
    for crf in (LOSSLESS, *CRFS):
        how = f"CRF {crf}" if crf else "exactly"
        plain = coded(folder / f"plain-{crf}.mp4", shown, rate, crf)
        yield f"twice, {how}", coded(folder / f"twice-{crf}.mp4", twice, 2 * rate, crf), plain
        plain = coded(folder / f"plain-12-{crf}.mp4", slow, Fraction(12), crf)
        uneven = [slow[index * 12 // 30] for index in range(len(slow) * 30 // 12)]
        yield f"12 in 30, {how}", coded(folder / f"in-{crf}.mp4", uneven, Fraction(30), crf), plain


def main() -> None:
    """Print a row per video, way of coding and detector."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("what", choices=("sizes", "repeats"))
    parser.add_argument("videos", nargs="+", type=Path)
    parser.add_argument("--frames", type=int, default=10**6)
    arguments = parser.parse_args()
    print(
        "| video | coding | detector | peak | alarms (s) | pictures/s |\n|---|---|---|---|---|---|"
    )
    for path in arguments.videos:
        with TemporaryDirectory() as name:
            if arguments.what == "sizes":
                pairs = sizes(path, arguments.frames, Path(name))
            else:
                shown = list(planes(path, arguments.frames))
                pairs = repeated(shown, rate_of(path), Path(name))
            known: dict[Path, dict[str, Answer]] = {}
            for how, here, there in pairs:
                if there not in known:
                    known[there] = answers(there)[0]
                found, repeats = answers(here)
                pictures = repeats.pictures_per_s(float(rate_of(here)))
                for detector, answer in found.items():
                    ratio, apart = compared(answer, known[there][detector])
                    print(
                        f"| {path.stem} | {how} | {detector} | {ratio:.2f} | {apart:+.3f} | "
                        f"{pictures or float('nan'):.3g} |",
                        flush=True,
                    )


if __name__ == "__main__":
    main()
