"""Seeded damage, and a child process that reads many damaged files and says what came of it."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path
from random import Random
from typing import Any

from tests.robustness.inputs import KINDS, Kind, make

# What is damaged: every codec and every container at least once.
VICTIMS = (
    *("h264-mp4", "h264-mkv", "h264-ts", "h264-avi", "h264-444", "h264-ten-bits"),
    *("hevc-mp4", "hevc-ten-bits", "vp8-webm", "vp9-webm", "av1-mkv", "av1-mp4"),
    *("mpeg4-avi", "mpeg2-ts", "mjpeg-mov", "ffv1-mkv", "prores-mov", "gif"),
)
WAYS = ("cut", "flip", "zero", "head", "swap")


@dataclass
class Outcome:
    """The result of one damaged file, which held `intact_frames` before."""

    name: str
    way: str
    number: int
    intact_frames: int
    frames: int
    complete: bool
    message: str
    same: bool
    steady: bool  # the same with one decoder thread and with three
    reference: int


def damaged(data: bytes, way: str, random: Random) -> bytes:
    """Return a copy of a file, damaged in one way."""
    result, size = bytearray(data), len(data)
    if way == "cut":
        del result[random.randrange(size) :]
    elif way == "flip":
        for _ in range(random.choice((1, 3, 10, 40))):
            result[random.randrange(size)] ^= 1 << random.randrange(8)
    elif way == "zero":
        start, length = random.randrange(size), random.choice((16, 200, 2000))
        result[start : start + length] = bytes(len(result[start : start + length]))
    elif way == "head":
        for _ in range(3):
            result[random.randrange(min(size, 600))] = random.randrange(256)
    else:
        start, length = random.randrange(size), random.choice((50, 500))
        other = random.randrange(size)
        result[start : start + length] = data[other : other + length]
    return bytes(result)


def intact(folder: Path, name: str) -> bytes:
    """Encode a file worth damaging; an MP4 has its index in front."""
    kind = KINDS[name]
    longer = Kind(**{**vars(kind), "frames": 24, "width": 160, "height": 96})
    options = {"movflags": "faststart"} if kind.suffix in {"mp4", "mov"} else {}
    path = make(folder / f"{name}.{kind.suffix}", longer, options)
    return path.read_bytes()


def counted_by_ffmpeg(path: Path, ffmpeg: str) -> int:
    """Return how many frames the ffmpeg program recovers."""
    done = subprocess.run(
        [
            ffmpeg,
            "-nostdin",
            "-v",
            "error",
            "-progress",
            "-",
            "-i",
            f"file:{path}",
            "-map",
            "0:v:0",
            "-fps_mode",
            "passthrough",
            "-f",
            "null",
            "-",
        ],
        capture_output=True,
        check=False,
        timeout=60,
    )
    counts = [int(line[6:]) for line in done.stdout.split(b"\n") if line.startswith(b"frame=")]
    return counts[-1] if counts else 0


def counted_by_pyav(path: Path) -> int:
    """Return how many frames PyAV's own plain loop recovers."""
    import av

    count = 0
    try:
        with av.open(f"file:{path}", metadata_errors="replace") as container:
            stream = container.streams.video[0]
            stream.thread_type = "SLICE"
            for packet in container.demux(stream):
                try:
                    count += len(packet.decode())
                except (av.error.FFmpegError, ValueError):
                    continue
    except (av.error.FFmpegError, OSError, ValueError, IndexError, AttributeError):
        return count
    return count


def read(path: Path, threads: int = 0) -> tuple[int, bool, str, str]:
    """Read a file as the program does: frames, whether complete, a message, a digest."""
    import hashlib

    from oppload_cli.errors import OpploadError
    from oppload_cli.video.source import open_video

    digest, count = hashlib.sha256(), 0
    try:
        with open_video(path, height=32, threads=threads) as video:
            for frame in video:
                count += 1
                digest.update(frame.luma.tobytes())
            return (
                count,
                video.decode.complete,
                "; ".join(video.decode.messages),
                digest.hexdigest(),
            )
    except OpploadError as error:
        return 0, False, str(error), ""


def main(seed: int, count: int, ffmpeg: str) -> None:
    """Damage `count` files, read each, and print a line of JSON for each."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        clips: dict[str, tuple[bytes, int, str]] = {}
        for victim in VICTIMS[: max(1, min(len(VICTIMS), count))]:
            data = intact(folder, victim)
            frames, _, _, digest = read(folder / f"{victim}.{KINDS[victim].suffix}")
            clips[victim] = data, frames, digest
        for number in range(count):
            say(asdict(one(folder, clips, seed, number, ffmpeg)))


def say(line: dict[str, Any]) -> None:
    """Print a line of JSON at once."""
    sys.stdout.write(json.dumps(line) + "\n")
    sys.stdout.flush()


def one(
    folder: Path, clips: dict[str, tuple[bytes, int, str]], seed: int, number: int, ffmpeg: str
) -> Outcome:
    """Damage one file, and read it; without ffmpeg, PyAV's plain loop is the reference."""
    victim, way = VICTIMS[number % len(VICTIMS)], WAYS[number // len(VICTIMS) % len(WAYS)]
    data, frames, digest = clips[victim]
    path = folder / f"x{number}.{KINDS[victim].suffix}"
    path.write_bytes(damaged(data, way, Random(f"{seed} {number}")))  # noqa: S311
    say({"begins": number, "name": victim, "way": way})  # so that a crash has a name
    found, complete, message, seen = read(path, 3)
    alone = read(path, 1)
    reference = counted_by_ffmpeg(path, ffmpeg) if ffmpeg else counted_by_pyav(path)
    path.unlink()
    same, steady = seen == digest, alone == (found, complete, message, seen)
    return Outcome(victim, way, number, frames, found, complete, message, same, steady, reference)


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), sys.argv[3])
