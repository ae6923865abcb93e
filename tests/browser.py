"""One headless browser for all tests of pages."""

from __future__ import annotations

import json
import shutil
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

BROWSERS = ("chromium", "chromium-browser", "google-chrome")


class Browser:
    """A page in a headless Chromium."""

    def __init__(self, driver: Any) -> None:
        self.driver = driver

    def open(
        self, page: Path, fragment: str = "", *, dark: bool = False, wide: int = 1200,
        media: str = "",
    ) -> None:  # fmt: skip
        """Open a page from its file, in a new tab of a width in pixels; media may be "print"."""
        scheme = [{"name": "prefers-color-scheme", "value": "dark" if dark else "light"}]
        self.driver.get("about:blank")
        for kind in ("browser", "performance"):
            self.driver.get_log(kind)
        look = {"media": media, "features": scheme}
        self.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", look)
        size = {"width": wide, "height": 900, "deviceScaleFactor": 1, "mobile": wide < 600}
        self.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        self.driver.get(page.as_uri() + fragment)

    def run(self, script: str, *arguments: object) -> Any:
        """Run JavaScript in the page and return what it returns."""
        return self.driver.execute_script(script, *arguments)

    def wait(self, condition: str) -> None:
        """Wait until an expression of JavaScript is true."""
        self.wait_for(lambda: self.run(f"return {condition}"), f"never true: {condition}")

    def wait_for(self, condition: Callable[[], object], reason: str) -> None:
        """Wait until a call returns something true; fail with the reason after a minute."""
        from selenium.webdriver.support.wait import WebDriverWait

        WebDriverWait(self.driver, 60, poll_frequency=0.02).until(lambda _: condition(), reason)

    def press(self, *keys: str) -> None:
        """Press keys where the focus is; a modifier is held until ``Keys.NULL``."""
        self.driver.switch_to.active_element.send_keys(*keys)

    def click(self, selector: str, share: float = 0.5) -> None:
        """Click an element, at a share of its width."""
        from selenium.webdriver import ActionChains
        from selenium.webdriver.common.by import By

        element = self.driver.find_element(By.CSS_SELECTOR, selector)
        self.run("arguments[0].scrollIntoView({block: 'center'})", element)
        across = round((share - 0.5) * element.size["width"])
        ActionChains(self.driver).move_to_element_with_offset(element, across, 0).click().perform()

    def drag(self, selector: str, start: float, end: float) -> None:
        """Drag over an element, from one share of its width to another."""
        from selenium.webdriver import ActionChains
        from selenium.webdriver.common.by import By

        element = self.driver.find_element(By.CSS_SELECTOR, selector)
        self.run("arguments[0].scrollIntoView({block: 'center'})", element)
        wide = element.size["width"]
        actions = ActionChains(self.driver)
        actions.move_to_element_with_offset(element, round((start - 0.5) * wide), 0)
        actions.click_and_hold().move_by_offset(round((end - start) * wide), 0).release().perform()

    def pictures(self) -> int:
        """Count the pictures that are shown, not the small marks."""
        self.wait("document.readyState === 'complete'")
        return int(
            self.run(
                "return [...document.images].filter("
                "i => i.complete && i.naturalWidth > 100 && i.width > 100).length"
            )
        )

    def complaints(self) -> list[str]:
        """Everything on the console since the page was opened."""
        return [entry["message"] for entry in self.driver.get_log("browser")]

    def requested(self) -> set[str]:
        """The schemes of all addresses that were asked for since the page was opened."""
        events = [
            json.loads(each["message"])["message"] for each in self.driver.get_log("performance")
        ]
        return {
            event["params"]["request"]["url"].partition(":")[0]
            for event in events
            if event["method"] == "Network.requestWillBeSent"
        }


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    program = next(filter(None, map(shutil.which, BROWSERS)), None)
    driver = shutil.which("chromedriver")
    if not program or not driver:
        pytest.skip("NOT TESTED in a browser: Chromium and its chromedriver are missing")
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    options.binary_location = program
    # Neither root nor the users of most containers can have a sandbox; the pages are our own.
    for argument in (
        "--headless=new", "--disable-gpu", "--force-color-profile=srgb", "--no-sandbox",
    ):  # fmt: skip
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    service = webdriver.ChromeService(driver)
    opened = webdriver.Chrome(options=options, service=service)
    yield Browser(opened)
    opened.quit()
