"""The pages in a real browser: from file://, with mouse and keyboard, without a network."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from oppload_cli.models.registry import detector_named, known_names
from oppload_cli.report import writing
from oppload_cli.report.writing import write_report
from tests.report.make import ALARMS, FIRST, LAST, TIMES_MS, number_of, write_numbered_result

if TYPE_CHECKING:
    from pathlib import Path

    from tests.browser import Browser

PRESENTED = "document.getElementById('stage').dataset.presented"
ROW = "document.getElementById('stage').dataset.row"
# The pixels of a row in the middle of the picture that the video shows.
PIXELS = """
const video = document.getElementById("video");
const canvas = document.createElement("canvas");
canvas.width = video.videoWidth; canvas.height = video.videoHeight;
const context = canvas.getContext("2d");
context.drawImage(video, 0, 0);
const row = context.getImageData(0, canvas.height >> 1, canvas.width, 1).data;
return Array.from(row).filter((_, place) => place % 4 === 0);
"""
HOSTILE = "</script><img src=x onerror=document.title='owned'>\u2028&amp;\u202e.avi"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("pages")


@pytest.fixture(scope="module")
def page(folder: Path) -> Path:
    return write_report([write_numbered_result(folder)], folder).first


def opened(browser: Browser, page: Path, fragment: str = "", **how: bool | int) -> None:
    browser.open(page, fragment, **how)  # type: ignore[arg-type]
    browser.wait("document.getElementById('stage').dataset.playable === '1'")


def is_at(browser: Browser, frame: int) -> None:
    """Curves, values and video are at this frame."""
    row = str(frame - FIRST)
    browser.wait(f"{PRESENTED} === '{row}' && {ROW} === '{row}'")


def shows(browser: Browser, frame: int) -> None:
    """The page is at this frame, and the picture is its own.

    The browser may tell the page that it has arrived before the picture is painted, so the
    picture is waited for; a picture of another frame stays, and fails.
    """
    is_at(browser, frame)
    browser.wait_for(
        lambda: number_of(browser.run(PIXELS)) == frame, f"the picture of frame {frame} never came"
    )


@pytest.mark.long
def test_every_step_shows_exactly_its_frame(browser: Browser, page: Path) -> None:
    from selenium.webdriver import Keys

    opened(browser, page)
    for frame in range(FIRST, LAST + 1):
        shows(browser, frame)
        browser.press(Keys.ARROW_RIGHT)
    for frame in range(LAST, FIRST - 1, -1):
        shows(browser, frame)
        browser.press(Keys.ARROW_LEFT)
    browser.press(Keys.END)
    shows(browser, LAST)
    assert browser.complaints() == []
    assert browser.requested() <= {"file", "blob", "data"}


@pytest.mark.long
def test_keys_and_buttons(browser: Browser, page: Path) -> None:
    from selenium.webdriver import Keys

    opened(browser, page)
    for key, frame in (("n", 8), ("n", 14), ("p", 8), (Keys.HOME, FIRST)):
        browser.press(key)
        shows(browser, frame)
    browser.press(Keys.SHIFT, Keys.ARROW_RIGHT, Keys.NULL)
    shows(browser, FIRST + 10)
    browser.click("#back")
    shows(browser, FIRST + 9)
    browser.click(".alarms tbody tr:nth-child(2) button")
    shows(browser, ALARMS[1][0])
    assert browser.run("return document.querySelector('tr[aria-current]').dataset.first") == "10"
    browser.click("#slider", 0.01)
    shows(browser, FIRST)


@pytest.mark.long
def test_boxes_and_values_of_the_frame(browser: Browser, page: Path) -> None:
    opened(browser, page, "#f9")
    shows(browser, 9)
    assert browser.run("return document.getElementById('values').innerText").split("\n") == [
        " OppLoD\t10 \xd7 threshold, alarm",
        " D-LGMD\t0.09 \xd7 threshold",
    ]
    drawn = """
    const canvas = document.getElementById("boxes");
    const pixel = canvas.getContext("2d").getImageData(canvas.width / 4, canvas.height / 2, 1, 1);
    return Array.from(pixel.data)"""
    assert browser.run(drawn) == [0xD5, 0x5E, 0x00, 255]  # the left edge, in OppLoD's colour
    browser.press("p")
    shows(browser, 8)
    browser.press("p")
    browser.click("#back")
    shows(browser, 7)
    assert browser.run(drawn) == [0, 0, 0, 0]


@pytest.mark.long
def test_the_label_of_a_box_of_a_light_colour_can_be_read(
    browser: Browser, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(detector_named("opplod"), "colour", "#FFEE55")
    opened(browser, write_report([write_numbered_result(tmp_path)], tmp_path).first, "#f9")
    shows(browser, 9)
    written = """
    const canvas = document.getElementById("boxes");
    const all = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
    let found = 0;  // pixels of dark letters
    for (let i = 0; i < all.length; i += 4)
      found += all[i] === 0x22 && all[i + 1] === 0x22 && all[i + 2] === 0x22;
    return found;
    """
    assert browser.run(written) > 30


@pytest.mark.long
def test_a_response_below_the_threshold_does_not_become_1(browser: Browser, page: Path) -> None:
    near = page.with_name("near.html")
    near.write_text(page.read_text().replace("0.09,0.1,", "0.999,0.1,"))
    opened(browser, near, "#f9")
    values = browser.run("return document.getElementById('values').innerText")
    assert values.endswith(" D-LGMD\t0.99 \xd7 threshold")


def playhead(browser: Browser) -> float:
    """The place of the line of the current frame, as a share of the first panel's width."""
    place = "document.querySelector('.playhead').getBoundingClientRect()"
    over = "document.querySelector('.u-over').getBoundingClientRect()"
    return float(browser.run(f"return ({place}.left + 1 - {over}.left) / {over}.width"))


@pytest.mark.long
def test_a_click_in_a_curve_goes_there(browser: Browser, page: Path) -> None:
    opened(browser, page)
    start, end = TIMES_MS[FIRST], TIMES_MS[LAST]
    for frame in (6, 13, 16):
        browser.click(".chart:nth-of-type(2) .u-over", (TIMES_MS[frame] - start) / (end - start))
        shows(browser, frame)
        assert playhead(browser) == pytest.approx(
            (TIMES_MS[frame] - start) / (end - start), abs=0.005
        )


@pytest.mark.long
def test_a_drag_shows_a_part_of_the_time(browser: Browser, page: Path) -> None:
    opened(browser, page)
    start, end = TIMES_MS[FIRST], TIMES_MS[LAST]
    over = ".chart:nth-of-type(2) .u-over"
    share = (TIMES_MS[13] - start) / (end - start)
    browser.click(over, share)
    browser.drag(over, share - 0.1, share + 0.3)
    shows(browser, 13)
    assert playhead(browser) == pytest.approx(0.25, abs=0.01)
    opened(browser, page)
    browser.drag(over, 0.4, 0.9)
    assert browser.run("return document.querySelector('.playhead').hidden")


@pytest.mark.long
def test_a_click_on_a_name_hides_its_curve(browser: Browser, page: Path) -> None:
    coloured = """
    const canvas = document.querySelector(".chart canvas");
    const all = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
    let found = 0;  // pixels in the colour of OppLoD
    for (let i = 0; i < all.length; i += 4)
      found += all[i] === 0xd5 && all[i + 1] === 0x5e && all[i + 2] === 0x00;
    return found;
    """
    opened(browser, page)
    drawn = browser.run(coloured)
    pressed = "document.querySelector('button.names').getAttribute('aria-pressed')"
    browser.click("button.names")
    browser.wait(f"{pressed} === 'false'")
    browser.wait_for(lambda: browser.run(coloured) == 0, "the curve never went")
    browser.click("button.names")
    browser.wait_for(lambda: browser.run(coloured) == drawn, "the curve never came back")
    assert drawn > 100


@pytest.mark.long
def test_bars_of_alarms_begin_at_the_top(browser: Browser, tmp_path: Path) -> None:
    table = write_numbered_result(tmp_path)
    head, *rows = table.read_text().splitlines()
    head = head.replace("opplod_alarm", "x").replace("dlgmd_alarm", "opplod_alarm")
    table.write_text("\n".join([head.replace(",x,", ",dlgmd_alarm,"), *rows]) + "\n")
    opened(browser, write_report([table], tmp_path).first)
    bar = """
    const canvas = document.querySelector(".chart canvas");
    const pixels = canvas.getContext("2d").getImageData(0, 8, canvas.width, 1).data;
    let found = 0;  // pixels in the colour of D-LGMD, the second detector
    for (let i = 0; i < pixels.length; i += 4)
      found += pixels[i] === 0x00 && pixels[i + 1] === 0x72 && pixels[i + 2] === 0xb2;
    return found;
    """
    browser.wait_for(lambda: browser.run(bar), "no bar is drawn")
    assert browser.run(bar) > 100


@pytest.mark.long
def test_it_plays_to_the_end_in_step(browser: Browser, page: Path) -> None:
    player = "document.getElementById('video')"
    opened(browser, page)
    browser.press(" ")
    shows(browser, LAST)
    browser.wait(f"{player}.paused")  # its last frame is on the screen before it stops
    browser.run("document.getElementById('speed').value = '0.1'")
    browser.press(" ")  # once more, from the beginning
    browser.wait(f"Number({ROW}) > 0 && Number({ROW}) < {LAST - FIRST}")
    browser.press(" ")
    browser.wait(f"{player}.paused && !{player}.seeking && {ROW} === {PRESENTED}")
    shows(browser, FIRST + int(browser.run(f"return {ROW}")))
    assert browser.complaints() == []


@pytest.mark.parametrize("wide", [360, 1200])
def test_dark_and_narrow(browser: Browser, page: Path, wide: int) -> None:
    opened(browser, page, dark=True, wide=wide)
    ground = browser.run("return getComputedStyle(document.body).backgroundColor")
    assert ground == "rgb(22, 24, 28)"
    assert browser.run("return document.documentElement.scrollWidth") <= wide
    assert browser.complaints() == []


@pytest.mark.long
def test_every_detector_is_visible_in_the_dark(browser: Browser, page: Path) -> None:
    opened(browser, page, dark=True)
    colour = """
        const key = document.querySelector(".names .key");
        key.setAttribute("style", key.getAttribute("style").replaceAll(arguments[1], arguments[0]));
        const found = getComputedStyle(key).backgroundColor;
        const most = found.startsWith("rgb") ? 255 : 1;
        return found.match(/[0-9.]+/g).map((each) => Number(each) / most);
    """

    def luminance(shares: list[float]) -> float:
        red, green, blue = (((share + 0.055) / 1.055) ** 2.4 for share in shares)
        return float(0.2126 * red + 0.7152 * green + 0.0722 * blue)

    ground = luminance([22 / 255, 24 / 255, 28 / 255])
    before = detector_named("opplod").colour
    for name in known_names():
        shown = browser.run(colour, detector_named(name).colour, before)
        before = detector_named(name).colour
        assert (luminance(shown) + 0.05) / (ground + 0.05) > 3, name  # as WCAG asks of graphics


@pytest.mark.long
def test_a_print_holds_all_alarms(browser: Browser, page: Path) -> None:
    opened(browser, page)
    # A longer list scrolls on the screen.
    height = "return getComputedStyle(document.querySelector('.alarms')).maxHeight"
    for media, most in (("print", "none"), ("screen", "352px")):
        browser.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": media})
        assert browser.run(height) == most


@pytest.mark.long
def test_a_print_keeps_its_colours_on_white(browser: Browser, page: Path) -> None:
    style = "getComputedStyle(document.querySelector(arguments[0]))"
    opened(browser, page, dark=True)
    dark = [{"name": "prefers-color-scheme", "value": "dark"}]
    media = {"media": "print", "features": dark}
    browser.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", media)
    # A printer leaves out other grounds, so that curves and their names had no colour in common.
    for shown in (".names .key", ".values .key", ".playhead"):
        assert browser.run(f"return {style}.printColorAdjust", shown) == "exact"
    assert browser.run(f"return {style}.color", "body") == "rgb(34, 34, 34)"
    browser.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "screen"})


def test_the_list_of_alarms_fits_on_a_phone(browser: Browser, page: Path) -> None:
    opened(browser, page, wide=360)
    browser.run("document.querySelector('.alarms td:last-child').lastChild.data = ' EMD-LPLC2-GF'")
    widths = "const list = document.querySelector('.alarms'); return "
    assert browser.run(f"{widths} list.scrollWidth - list.clientWidth") == 0


@pytest.mark.long
def test_a_large_video_is_a_file_beside_the_page(
    browser: Browser, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(writing, "MOST_EMBEDDED", 0)
    page = write_report([write_numbered_result(tmp_path, "a #1? 50%")], tmp_path).first
    opened(browser, page, "#f14")
    is_at(browser, 14)  # its pixels may not be read: each file is an origin of its own
    assert browser.complaints() == []
    page.with_name("a #1? 50%.report.mp4").unlink()
    browser.open(page, "#f14")
    browser.wait("!document.getElementById('message').hidden")
    said = browser.run("return document.getElementById('message').textContent")
    assert "a #1? 50%.report.mp4" in said
    browser.press("p")
    is_at(browser, 8)


@pytest.fixture(scope="module")
def index(folder: Path) -> Path:
    many = folder / "many"
    many.mkdir()
    tables = [write_numbered_result(many, stem) for stem in ("b", "a", "c")]
    lines = tables[0].read_text().splitlines()
    # no alarm in b, and a shorter c
    tables[0].write_text(
        "\n".join(line.replace(",0.5,0.05,1,", ",0.002,0.05,0,") for line in lines) + "\n"
    )
    tables[2].write_text("\n".join(lines[:8]) + "\n")
    return write_report(tables, folder / "report", videos=many).first


def names(browser: Browser) -> list[str]:
    cells = "[...document.querySelectorAll('tbody tr:not([hidden]) .name')]"
    found: list[str] = browser.run(f"return {cells}.map((each) => each.textContent)")
    return found


@pytest.mark.long
def test_the_index_sorts_and_leads_to_the_pages(browser: Browser, index: Path) -> None:
    from selenium.webdriver import Keys

    browser.open(index)
    assert browser.driver.title == "2 of 3 videos had an alarm - oppload"
    assert names(browser) == ["a.mkv", "c.mkv", "b.mkv"]
    browser.click("[data-key=title]")
    assert names(browser) == ["a.mkv", "b.mkv", "c.mkv"]
    browser.press(Keys.ENTER)
    assert names(browser) == ["c.mkv", "b.mkv", "a.mkv"]
    assert browser.run("return document.activeElement.closest('th').ariaSort") == "descending"
    browser.press(Keys.TAB, " ")  # the next column
    assert names(browser) == ["a.mkv", "c.mkv", "b.mkv"]
    browser.click("#filter")
    browser.press("B.")
    assert names(browser) == ["b.mkv"]
    assert browser.complaints() == []
    assert browser.requested() <= {"file", "data"}
    browser.press(Keys.BACKSPACE, Keys.BACKSPACE)
    browser.click("tbody tr .chips a:nth-child(2)")
    browser.wait("document.getElementById('stage').dataset.playable === '1'")
    shows(browser, ALARMS[1][0])
    browser.driver.back()


@pytest.mark.long
@pytest.mark.parametrize("wide", [360, 800, 1200])
def test_the_index_shows_pictures_at_any_width(browser: Browser, index: Path, wide: int) -> None:
    browser.open(index, wide=wide)
    assert browser.pictures() == 3
    assert browser.run("return document.querySelector('.spark').clientWidth") > 150
    assert browser.run("return document.documentElement.scrollWidth") <= wide
    # The picture of an upright video takes no more room than others.
    tall = "const tall = document.images[0]; tall.src = arguments[0]; "
    upright = "data:image/svg+xml,<svg xmlns='http://www.w3.org/2000/svg' width='9' height='90'/>"
    browser.run(tall, upright)
    browser.wait("document.images[0].naturalHeight === 90")
    assert browser.run("return document.images[0].height") <= 160


@pytest.mark.long
def test_hostile_names_are_text(browser: Browser, tmp_path: Path) -> None:
    from tests.report.make import sidecar_of, write_sidecar

    tables: list[Path] = []
    for stem in ("<img src=x onerror=alert(1)>&amp;\"'", "plain"):
        table = write_numbered_result(tmp_path, stem, video="clip.mkv")
        content = sidecar_of(tmp_path / "clip.mkv")
        content["input"]["name"] = f"{tmp_path}/{len(tables)}/{HOSTILE}"
        content["models"] = [HOSTILE]
        content["command"][2] = HOSTILE
        content["decode"] = {"complete": False, "messages": [HOSTILE]}
        write_sidecar(table, content)
        tables.append(table)
    report = write_report(tables, tmp_path / "out", videos=tmp_path / "clip.mkv")
    for page in (*report.pages, report.first):
        browser.open(page)
        assert browser.run("return document.images.length") == (0 if page != report.first else 2)
        text = browser.run("return document.body.textContent")
        assert "script><img src=x onerror=document.title='owned'>\\u2028&amp;\\u202e.avi" in text
        assert browser.driver.title != "owned"
        assert browser.complaints() == []
    browser.open(report.first)
    browser.click("tbody .name a")
    browser.wait("document.getElementById('stage').dataset.playable === '1'")
