"""Measure how the size of a video and repeats of its pictures change responses.

    python -m benchmarks.footage sizes VIDEO ... [--frames N] [--starts N]
    python -m benchmarks.footage repeats VIDEO ... [--frames N] [--starts N]
    python -m benchmarks.footage shares VIDEO ... [--frames N]

The program encodes each video in several ways (H.264) and analyses every file as ``oppload run``
does; the VIDEO `generated` is a textured disk that approaches over a texture.
`sizes` compares files of 360, 720, 1080 and 2160 rows with the file of 720 rows. `repeats` compares
files with repeats with a file that shows every picture once at its own rate. The files with repeats
show every picture twice at twice the rate, or every second picture at 12 pictures/s in 30 frames/s.
In the column *told* the detectors analyse the same file, but are told which frames are repeats and
when each picture was taken. So a deviation of *told* from 1 is due to the recognition of repeats;
the rest of the deviation in the column *peak* is due to the encoder. With `--starts 8` each video
is measured without its first 0, 1 ... 7 pictures; each ratio is then a geometric mean, with the
smallest and the largest. `shares` counts, in the same files, the repeats that are missed and the
new pictures that are taken for repeats, for several values of ``repeats.share``.
"""

from __future__ import annotations

import argparse
from fractions import Fraction
from functools import cache
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, NamedTuple

import av
import cv2
import numpy as np

from oppload_cli.frame_times import ticks
from oppload_cli.frames.repeats import NEAR, Repeat, RepeatParams, Repeats
from oppload_cli.models.registry import least_response_of
from oppload_cli.pipeline.analysis import analyse
from oppload_cli.video.source import open_video
from oppload_cli.video.writers import ON_ANY_PROCESSOR

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from numpy.typing import NDArray

    Planes = Iterable[NDArray[np.uint8]]

GENERATED, GENERATED_ROWS = Path("generated"), 240
HEIGHTS = (360, 720, 1080, 2160)
AGAINST = 720
SIZES_CRF = 18
CRFS = (23, 28, 35)
DETECTORS = ("opplod", "opplod_reference", "dlgmd")
LOSSLESS = None
SHARES = (0.25, 0.35, 0.45)
# SWS_BICUBIC or SWS_AREA, with SWS_ACCURATE_RND and SWS_BITEXACT
BICUBIC_EXACTLY, AREA_EXACTLY = 0x4 | 0xC0000, 0x20 | 0xC0000


class Pair(NamedTuple):
    """Two files that are compared, `here` with `there`."""

    how: str  # how `here` was encoded
    here: Path
    there: Path
    # The number of the picture of each frame of `here`; empty if there are no repeats.
    pictures: tuple[int, ...] = ()
    per_s: Fraction = Fraction(30)  # pictures per second


class _KnownRepeats(Repeats):
    """Repeats of a file for which the picture of each frame is known."""

    def __init__(self, pictures: Sequence[int], per_s: Fraction) -> None:
        super().__init__(RepeatParams())
        self._numbers, self._per_s = iter(pictures), float(per_s)
        self._latest = -1

    def step(self, luma: NDArray[np.float32], time: int) -> Repeat:
        """Take the next frame."""
        del luma
        picture, latest = next(self._numbers), self._latest
        self._latest = picture
        if picture == latest:
            self.near += 1
            return Repeat(NEAR, passed_over=True, held=True)
        return Repeat(shift=ticks(picture / self._per_s) - time)


class Measured(NamedTuple):
    """The peak and the alarms of a detector on a video."""

    peak: float  # largest response
    floor: float  # a quarter of the alarm's floor: differences below it mean nothing
    alarms_s: list[float]  # starts of the alarms


def coded(
    path: Path, planes: Planes, rate: Fraction, crf: int | None, height: int | None = None
) -> Path:
    """Write grey pictures of one shape as an H.264 video of `rate` frames/s, and return its path.

    With `crf`, the constant rate factor, None, every value of luma is kept. `height` is the number
    of rows, even, to which pictures are enlarged (bicubic) or reduced (by area).
    """
    options = {"preset": "veryfast", "crf": str(crf)} if crf else {"preset": "ultrafast", "qp": "0"}
    options |= ON_ANY_PROCESSOR
    with av.open(str(path), "w") as container:
        stream: Any = container.add_stream("libx264", rate=rate, options=options)
        stream.codec_context.thread_count = 1  # another number gives other bytes
        for index, plane in enumerate(planes):
            rows, columns = plane.shape
            down = height or rows // 2 * 2
            across = round(columns * down / rows / 2) * 2
            if not index:
                stream.height, stream.width, stream.pix_fmt = down, across, "yuv420p"
            picture = av.VideoFrame.from_ndarray(plane, format="gray").reformat(
                across,
                down,
                "yuv420p",
                interpolation=AREA_EXACTLY if down < rows else BICUBIC_EXACTLY,
                threads=1,
            )
            container.mux(stream.encode(picture))
        container.mux(stream.encode())
    return path


def measured(
    path: Path, detectors: Sequence[str] = DETECTORS, told: Pair | None = None
) -> tuple[dict[str, Measured], Repeats]:
    """Return the peak and alarms of each detector on a video, and its repeats.

    `told` tells which picture each frame shows; without it the repeats are recognised.
    """
    repeats = _KnownRepeats(told.pictures, told.per_s) if told else Repeats(RepeatParams())
    with open_video(path) as video:
        records = list(analyse(video, list(detectors), rmo=None, repeats=repeats))
    found = {}
    for name in detectors:
        said = [record[name] for record in records]
        on = [False, *(one.alarm for one in said)]
        begun = [
            record.time_s
            for record, was in zip(records, on, strict=False)
            if record[name].alarm and not was
        ]
        peak = max((one.response for one in said if one.response), default=0.0)
        found[name] = Measured(peak, least_response_of(name) / 4, begun)
    return found, repeats


def generated(height: int, frames: int, noise: float = 0.0) -> Iterator[NDArray[np.uint8]]:
    """Yield a textured disk that approaches over a texture; contact is after the last picture.

    `noise` is the standard deviation of the noise of luminance.
    """
    random = np.random.default_rng(7)
    width, scale = height * 4 // 3, height / 240
    ground, skin = (
        np.asarray(cv2.resize(grain, (width, height), interpolation=cv2.INTER_CUBIC), np.float32)
        for grain in random.random((2, 48, 96), np.float32)
    )
    y, x = np.mgrid[:height, :width].astype(np.float32)
    for t in range(frames):
        radius = 400 * scale / (frames - t)
        distance = np.hypot(x - 0.55 * width, y - 0.45 * height)
        inside = np.clip((radius - distance) / scale + 0.5, 0, 1)
        behind = 0.45 + 0.4 * ground
        shown = behind + inside * (0.1 + 0.15 * skin - behind)
        grain = random.standard_normal(shown.shape, np.float32) * np.float32(noise)
        yield np.clip(np.rint(255 * (shown + grain)), 0, 255).astype(np.uint8)


def planes(path: Path, count: int, start: int = 0) -> Iterator[NDArray[np.uint8]]:
    """Yield the first `count` pictures of a video in grey, without the first `start` of them."""
    if path == GENERATED:
        yield from islice(generated(GENERATED_ROWS, 60, 0.004), start, count)
        return
    with av.open(str(path)) as container:
        for picture in islice(container.decode(video=0), start, count):
            yield np.asarray(picture.to_ndarray(format="gray"), np.uint8)


def _rate_of(path: Path) -> Fraction:
    """Return the frames per second that a video declares."""
    if path == GENERATED:
        return Fraction(30)
    with av.open(str(path)) as container:
        return Fraction(container.streams.video[0].average_rate or 30)


def compared(here: Measured, there: Measured) -> tuple[float, float]:
    """Return the ratio of the peaks, and the largest difference of the alarms' starts in seconds.

    The difference is NaN without alarms, and infinite if the numbers of alarms differ.
    """
    ratio = max(here.peak, here.floor) / max(there.peak, here.floor)
    if len(here.alarms_s) != len(there.alarms_s):
        return ratio, float("inf")
    differences = np.subtract(here.alarms_s, there.alarms_s)
    largest = differences[np.abs(differences).argmax()] if len(differences) else np.nan
    return ratio, float(largest)


def sizes(path: Path, count: int, folder: Path, start: int = 0) -> Iterator[Pair]:
    """Yield pairs of files of the same pictures, of which the second has `AGAINST` rows."""
    for crf in (LOSSLESS, SIZES_CRF):
        files = {}
        for height in HEIGHTS:
            new = folder / f"{height}-{crf}.mp4"
            files[height] = coded(new, planes(path, count, start), _rate_of(path), crf, height)
        for height in HEIGHTS:
            how = f"CRF {crf}" if crf else "lossless"
            yield Pair(f"{height} rows, {how}", files[height], files[AGAINST])


def repeated(shown: Sequence[NDArray[np.uint8]], rate: Fraction, folder: Path) -> Iterator[Pair]:
    """Yield pairs of files: the first shows pictures more than once, the second once."""
    twice = tuple(index // 2 for index in range(2 * len(shown)))
    slow = shown[::2]
    uneven = tuple(index * 12 // 30 for index in range(len(slow) * 30 // 12))
    for crf in (LOSSLESS, *CRFS):
        how = f"CRF {crf}" if crf else "exactly"
        plain = coded(folder / f"plain-{crf}.mp4", shown, rate, crf)
        path = coded(folder / f"twice-{crf}.mp4", (shown[at] for at in twice), 2 * rate, crf)
        yield Pair(f"twice, {how}", path, plain, twice, rate)
        plain = coded(folder / f"plain-12-{crf}.mp4", slow, Fraction(12), crf)
        path = coded(folder / f"in-{crf}.mp4", (slow[at] for at in uneven), Fraction(30), crf)
        yield Pair(f"12 in 30, {how}", path, plain, uneven, Fraction(12))


def counted_repeats(path: Path, pictures: Sequence[int], share: float) -> NDArray[np.int_]:
    """Return the numbers of repeats, of missed ones, and of new pictures taken for repeats."""
    repeats, numbers = Repeats(RepeatParams(share=share)), np.zeros(3, int)
    with open_video(path) as video:
        for frame, number, before in zip(video, pictures, (-1, *pictures), strict=False):
            left_out = repeats.step(frame.luma, frame.time).passed_over
            is_repeat = number == before
            numbers += is_repeat, is_repeat and not left_out, left_out and not is_repeat
    return numbers


def print_shares(videos: Sequence[Path], count: int) -> None:
    """Print a row for each encoding: numbers over all videos, by share."""
    numbers: dict[str, NDArray[np.int_]] = {}
    for path in videos:
        with TemporaryDirectory() as name:
            shown = list(planes(path, count))
            for pair in repeated(shown, _rate_of(path), Path(name)):
                files = {pair.how: (pair.here, pair.pictures)}
                if pair.how.startswith("twice"):
                    files[f"no repeats{pair.how.removeprefix('twice')}"] = (
                        pair.there,
                        tuple(range(len(shown))),
                    )
                for how, (file, pictures) in files.items():
                    found = np.array([counted_repeats(file, pictures, share) for share in SHARES])
                    numbers[how] = numbers.get(how, 0) + found
    shares = ", ".join(map(str, SHARES))
    print(f"| coding | repeats | missed at a share of {shares} | new pictures taken for repeats |")
    print("|---|---|---|---|")
    for how, found in numbers.items():
        repeats, missed, taken = (", ".join(map(str, column)) for column in found.T)
        print(f"| {how} | {repeats.split(',')[0]} | {missed} | {taken} |")


def _compared_rows(
    what: str, path: Path, count: int, start: int
) -> Iterator[tuple[str, str, list[float]]]:
    """Yield coding, detector and figures: peak, told, alarms in seconds, pictures per second."""
    with TemporaryDirectory() as name:
        measured_once = cache(lambda path: measured(path)[0])
        if what == "sizes":
            pairs = sizes(path, count, Path(name), start)
        else:
            pairs = repeated(list(planes(path, count, start)), _rate_of(path), Path(name))
        for pair in pairs:
            found, repeats = measured(pair.here)
            told = measured(pair.here, told=pair)[0] if pair.pictures else {}
            pictures = repeats.pictures_per_s
            for detector, here in found.items():
                peak, alarms_s = compared(here, measured_once(pair.there)[detector])
                of_told = compared(here, told[detector])[0] if told else np.nan
                yield pair.how, detector, [peak, of_told, alarms_s, pictures or np.nan]


def _peaks(ratios: NDArray[np.float64]) -> str:
    """Return the geometric mean of ratios; of several also the smallest and the largest."""
    mean = f"{np.exp(np.log(ratios).mean()):.2f}"
    return mean if len(ratios) == 1 else f"{mean} ({ratios.min():.2f} to {ratios.max():.2f})"


def main() -> None:
    """Print a row for each video, encoding and detector."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=("sizes", "repeats", "shares"), help="see above")
    parser.add_argument("videos", nargs="+", type=Path, help="files, or `generated`")
    parser.add_argument("--frames", type=int, default=10**6, help="pictures of each video (all)")
    parser.add_argument(
        "--starts", type=int, default=1, help="first pictures at which each video starts (1)"
    )
    arguments = parser.parse_args()
    if arguments.what == "shares":
        print_shares(arguments.videos, arguments.frames)
        return
    print("| video | coding | detector | peak | told | alarms (s) | pictures/s |")
    print("|---|---|---|---|---|---|---|")
    for path in arguments.videos:
        rows: dict[tuple[str, str], list[list[float]]] = {}
        for start in range(arguments.starts):
            compared_rows = _compared_rows(arguments.what, path, arguments.frames, start)
            for how, detector, figures in compared_rows:
                rows.setdefault((how, detector), []).append(figures)
        for (how, detector), of_starts in rows.items():
            peaks, told, alarms_s, pictures = np.array(of_starts).T
            alarms = ", ".join(f"{late_s:+.3f}" for late_s in alarms_s)
            print(
                f"| {path.stem} | {how} | {detector} | {_peaks(peaks)} | {_peaks(told)} | "
                f"{alarms} | {np.median(pictures):.3g} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
