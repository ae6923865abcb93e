"""Missing ends, wrong checksums, and errors that decoders only log."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from random import Random
from typing import TYPE_CHECKING

import pytest

from oppload_cli.errors import SourceError
from oppload_cli.video.integrity import BROKEN, CUT, WRONG, fault_of
from oppload_cli.video.source import open_video
from tests.robustness.inputs import AV1, KINDS, QUIET_265, X264, Kind, make

if TYPE_CHECKING:
    from pathlib import Path

FRAGMENTS = {"movflags": "frag_keyframe+empty_moov"}
LIVE = {"h264-mkv", "vp9-webm"}  # written to a pipe: no length, no index
CUTS = {
    **{name: KINDS[name] for name in ("ffv1-mkv", "h264-mkv", "vp9-webm", "h264-ts", "gif")},
    "fragments": Kind("mp4", "libx264", options=X264),
    "y4m": Kind("y4m", "wrapped_avframe"),
    "nut": Kind("nut", "ffv1"),
    "mjpeg": Kind("mjpeg", "mjpeg", "yuvj420p"),
    "ogg": Kind("ogv", "libvpx"),
    "obu": Kind("obu", "libsvtav1", options=AV1),
    "ivf": Kind("ivf", "libvpx"),
    "mxf": Kind("mxf", "mpeg2video", rate=Fraction(25)),
    "asf": Kind("wmv", "wmv2"),
    "flv": Kind("flv", "libx264", options=X264),
    "apng": Kind("apng", "apng", "rgb24"),
    "m2ts": Kind("m2ts", "libx264", options=X264),
}
# Of 12 cuts: those between two tags, frames or pictures.
MOST_UNNOTICED = {"flv": 2, "apng": 2, "h264-ts": 2}


@pytest.mark.parametrize("name", CUTS)
def test_a_cut_file_is_incomplete_and_a_complete_one_is_not(tmp_path: Path, name: str) -> None:
    kind = replace(CUTS[name], width=160, height=96, frames=24)
    options = FRAGMENTS if name == "fragments" else {}
    path = make(tmp_path / f"a.{kind.suffix}", kind, options, to_pipe=name in LIVE)
    data, unnoticed, random = path.read_bytes(), 0, Random(5)  # noqa: S311
    with open_video(path, height=16) as video:
        assert len(list(video)) == 24
        assert video.decode.messages == []
    for _ in range(12):
        path.write_bytes(data[: random.randrange(len(data) // 20, len(data))])
        try:
            with open_video(path, height=16) as video:
                unnoticed += len(list(video)) < 24 and video.decode.complete
        except SourceError:
            continue
    assert unnoticed <= MOST_UNNOTICED.get(name, 0)


def test_a_file_that_is_cut_within_its_first_frame_says_so(tmp_path: Path) -> None:
    path = make(tmp_path / "a.mkv", replace(KINDS["h264-mkv"], width=640, height=480))
    data = path.read_bytes()
    path.write_bytes(data[: data.index(b"\x1f\x43\xb6\x75") + 100])
    with pytest.raises(SourceError, match=r"no frame could be decoded .*the file ends too early"):
        open_video(path)


def test_bits_that_change_in_a_matroska_file_are_noticed_by_its_checksums(tmp_path: Path) -> None:
    path = make(tmp_path / "a.mkv", replace(KINDS["hevc-mkv"], width=160, height=96, frames=24))
    data, random = path.read_bytes(), Random(1)  # noqa: S311
    assert fault_of(str(path), "matroska,webm") is None
    start = data.index(b"\x1f\x43\xb6\x75") + 20  # in the first cluster
    for _ in range(10):
        place = random.randrange(start, start + 500)
        path.write_bytes(data[:place] + bytes([data[place] ^ 4]) + data[place + 1 :])
        assert fault_of(str(path), "matroska,webm") == WRONG
        with open_video(path, height=16) as video:
            list(video)
            assert not video.decode.complete


def test_elements_without_a_known_length_are_walked_through(tmp_path: Path) -> None:
    """Browsers record so: the segment and each cluster end where the next one begins."""
    path = make(tmp_path / "a.webm", KINDS["vp9-webm"], to_pipe=True)
    data = path.read_bytes()
    place = data.index(b"\x1f\x43\xb6\x75") + 4
    length = 9 - data[place].bit_length()
    unknown = bytes([1 << 8 - length | ((1 << 8 - length) - 1)]) + b"\xff" * (length - 1)
    data = data[:place] + unknown + data[place + length :]
    path.write_bytes(data)
    assert fault_of(str(path), "matroska,webm") is None
    path.write_bytes(data[:-5])
    assert fault_of(str(path), "matroska,webm") == CUT
    path.write_bytes(data + bytes(300))
    assert fault_of(str(path), "matroska,webm") is None


def test_the_last_page_of_an_ogg_file_says_so(tmp_path: Path) -> None:
    checksums = {0: "ecb7c3c6", 2: "cfec2502", 4: "1d1cce4b"}

    def page(flags: int) -> bytes:
        checksum = bytes.fromhex(checksums[flags])
        return b"OggS\0" + bytes([flags]) + bytes(16) + checksum + b"\x01\x03abc"

    path = tmp_path / "a.ogv"
    for content, fault in (
        (page(2) + page(0) + page(4), None),
        (page(2) + page(0), CUT),
        (page(2) + page(4)[:-1], CUT),
        (page(2) + page(4)[:9], CUT),
        (page(2) + page(4)[:-1] + b"d", WRONG),
        (page(2) + page(4) + b"x" * 27, BROKEN),
    ):
        path.write_bytes(content)
        assert fault_of(str(path), "ogg") == fault


def test_each_tag_of_flv_is_followed_by_its_size(tmp_path: Path) -> None:
    def tag(stated: int, content: bytes = b"abc") -> bytes:
        return b"\x09" + len(content).to_bytes(3) + bytes(7) + content + stated.to_bytes(4)

    path, head = tmp_path / "a.flv", b"FLV\1\1\0\0\0\x09\0\0\0\0"
    for content, fault in (
        (tag(14) + tag(14), None),
        (tag(13) + tag(3), None),  # programs that leave out a byte, or the head
        (tag(14) + tag(28) + tag(42), None),  # the size of all tags so far
        (tag(15) + tag(14), BROKEN),
        (tag(14)[:-1] + b"\0" + tag(14), BROKEN),
        (tag(14) + tag(14)[:-1], CUT),
        (tag(14) + tag(14)[:8], CUT),
    ):
        path.write_bytes(head + content)
        assert fault_of(str(path), "flv") == fault


def test_a_nut_file_ends_with_its_index(tmp_path: Path) -> None:
    """FFmpeg gives out the part of a frame that is left, and does not mark it as cut."""
    path = make(tmp_path / "a.nut", Kind("nut", "huffyuv", "yuv422p"))
    data = path.read_bytes()
    for size, fault in ((len(data), None), (len(data) - 1, CUT), (len(data) // 2, CUT), (5, CUT)):
        path.write_bytes(data[:size])
        assert fault_of(str(path), "nut") == fault


def test_frames_that_an_mxf_file_has_lost_are_missed(tmp_path: Path) -> None:
    path = make(tmp_path / "a.mxf", Kind("mxf", "mpeg2video", rate=Fraction(25)))
    data = bytearray(path.read_bytes())
    picture = bytes.fromhex("060e2b34010201010d01030115010500")  # the key of a coded picture
    places = [at for at in range(len(data)) if data.startswith(picture, at)]
    assert len(places) == 12
    data[places[5] : places[8]] = bytes(places[8] - places[5])
    path.write_bytes(data)
    with open_video(path, height=16) as video:
        count = len(list(video))
        assert video.facts.frames_declared == 12
        assert video.decode.missing == 12 - count > 0


def test_a_box_of_64_bits_is_as_long_as_it_says(tmp_path: Path) -> None:
    path, name = tmp_path / "a.mp4", "mov,mp4,m4a,3gp,3g2,mj2"
    box = b"\0\0\0\x01mdat" + (40).to_bytes(8) + bytes(24)
    for content, fault in ((box, None), (box + box, None), (box + box[:-1], CUT)):
        path.write_bytes(content)
        assert fault_of(str(path), name) == fault


def test_the_data_of_a_fragment_follow_its_index(tmp_path: Path) -> None:
    path, index, data = tmp_path / "a.mp4", b"\0\0\0\x08moof", b"\0\0\0\x09mdat?"
    for content, fault in ((index + data, None), (index + data + index, CUT)):
        path.write_bytes(content)
        assert fault_of(str(path), "mov,mp4,m4a,3gp,3g2,mj2") == fault


def test_units_of_av1_end_with_a_picture(tmp_path: Path) -> None:
    path, delimiter, picture = tmp_path / "a.obu", b"\x12\0", b"\x32\x03abc"
    for content, fault in (
        (delimiter + picture, None),
        (delimiter + picture + delimiter, CUT),
        (delimiter + picture[:-1], CUT),
    ):
        path.write_bytes(content)
        assert fault_of(str(path), "obu") == fault


def test_a_file_of_countless_parts_is_not_read_for_ever(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = make(tmp_path / "a.webm", KINDS["vp9-webm"], to_pipe=True)
    path.write_bytes(path.read_bytes() + b"\xec\x80" * 2000 + b"\xec")
    assert fault_of(str(path), "matroska,webm") == CUT
    monkeypatch.setattr("oppload_cli.video.integrity.MOST_PARTS", 1000)
    assert fault_of(str(path), "matroska,webm") is None


TS = 188


def ts(tmp_path: Path) -> tuple[Path, list[bytes], int]:
    """A transport stream, its packets, and the identifier of its video."""
    few_key_frames = {"sc_threshold": "1000000000"}
    kind = Kind("ts", "mpeg2video", width=160, height=96, frames=24, options=few_key_frames)
    path = make(tmp_path / "a.ts", kind)
    data = path.read_bytes()
    return path, [data[start : start + TS] for start in range(0, len(data), TS)], 0x100


def fault_of_packets(path: Path, packets: list[bytes], stream: int) -> str | None:
    path.write_bytes(b"".join(packets))
    return fault_of(str(path), "mpegts", stream=stream)


def test_packets_of_a_transport_stream(tmp_path: Path) -> None:
    path, packets, stream = ts(tmp_path)
    video = [
        number for number, each in enumerate(packets) if (each[1] & 0x1F) << 8 | each[2] == stream
    ]
    assert fault_of_packets(path, packets, stream) is None
    noticed = [
        fault_of_packets(path, [*packets[:lost], *packets[lost + 1 :]], stream) == BROKEN
        for lost in video[1:-1]
    ]
    # Before a key frame packets may be missing: a broadcast may be joined of parts there.
    assert sum(noticed) >= len(noticed) - 2
    some, others = video[len(video) // 2], [*packets]
    assert fault_of_packets(path, [*packets[: some + 1], *packets[some:]], stream) is None  # twice
    assert fault_of_packets(path, [*packets, b"G"], stream) == CUT
    # Two recordings, one after the other: the second begins with a key frame.
    assert fault_of_packets(path, [*packets, *packets], stream) is None
    others[some] = bytes([packets[some][0], packets[some][1] | 0x80, *packets[some][2:]])
    assert fault_of_packets(path, others, stream) == BROKEN
    # A receiver of a broadcast may begin in the middle of a packet.
    path.write_bytes(b"".join(packets)[100:])
    assert fault_of(str(path), "mpegts", stream=stream) is None


HASHED = f"{QUIET_265}:keyint=6:hash=1"
SUMS = {
    "ffv1-avi": (Kind("avi", "ffv1", width=160, height=96, options={"slicecrc": "1"}), 1),
    "ffv1-nut": (Kind("nut", "ffv1", width=160, height=96, options={"slicecrc": "1"}), 3),
    "gif": (Kind("gif", "gif", "gray", 160, 96, rate=Fraction(25)), 3),
    "png-mov": (Kind("mov", "png", "rgb24", 160, 96), 1),
    "hevc-hash": (Kind("mp4", "libx265", options={"x265-params": HASHED}), 3),
}


@pytest.mark.parametrize("name", SUMS)
def test_concealed_errors_are_counted_with_any_number_of_threads(tmp_path: Path, name: str) -> None:
    kind, threads = SUMS[name]
    path = make(tmp_path / f"a.{kind.suffix}", replace(kind, frames=24))
    data, random = path.read_bytes(), Random(2)  # noqa: S311

    def seen(count: int) -> tuple[bytes, bool]:
        try:
            with open_video(path, height=16, threads=count) as video:
                pixels = b"".join(frame.luma.tobytes() for frame in video)
                return pixels, video.decode.complete
        except SourceError:
            return b"", False

    intact, complete = seen(threads)
    assert complete
    silent = changed = 0
    for _ in range(10):
        damaged = bytearray(data)
        for _ in range(6):
            place = random.randrange(len(data) // 4, len(data) * 3 // 4)
            damaged[place] ^= 1 << random.randrange(8)
        path.write_bytes(damaged)
        first = seen(1)
        assert seen(3) == first
        changed += first[0] != intact
        silent += first[0] != intact and first[1]
    assert changed > 2
    assert silent <= (2 if name == "gif" else 0)  # other indices of colours are valid ones


def test_errors_that_a_decoder_logs_for_intact_files_are_no_damage(tmp_path: Path) -> None:
    """Cameras write data beside a JPEG picture that FFmpeg does not know."""
    path = make(tmp_path / "a.mjpeg", Kind("mjpeg", "mjpeg", "yuvj420p"))
    data = path.read_bytes()
    strange = b"\xff\xe1\x00\x0aExif\x00\x00zz"
    path.write_bytes(data.replace(b"\xff\xd8", b"\xff\xd8" + strange))
    with open_video(path, height=16) as video:
        assert len(list(video)) == 12
        assert video.decode.messages == []
