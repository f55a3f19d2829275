"""A real browser for the tests of the site: Debian's Chromium, driven by Selenium, cut off from the network."""

import contextlib
import json
import os
import shutil
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from selenium import webdriver
from selenium.common.exceptions import TimeoutException
from selenium.webdriver.chrome.options import Options
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.remote.webelement import WebElement
from selenium.webdriver.support.wait import WebDriverWait

PATIENCE_S: Final = 30.0
"""How long anything on a page may take on a busy machine."""
WIDTH_PX, HEIGHT_PX = 1280, 900
ARGUMENTS: Final = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-dev-shm-usage",
    "--disable-background-networking",
    "--disable-client-side-phishing-detection",
    "--disable-component-update",
    "--disable-default-apps",
    "--disable-domain-reliability",
    "--disable-extensions",
    "--disable-features=OptimizationHints,MediaRouter,Translate,AutofillServerCommunication",
    "--disable-sync",
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE localhost, EXCLUDE 127.0.0.1",
    "--metrics-recording-only",
    "--no-default-browser-check",
    "--no-first-run",
    "--no-pings",
    "--no-proxy-server",
    "--force-color-profile=srgb",
    f"--window-size={WIDTH_PX},{HEIGHT_PX}",
)
_NOTE_ALERTS: Final = """
window.noted = [];
for (const name of ["alert", "confirm", "prompt", "print"]) {
  window[name] = (...what) => { window.noted.push([name, ...what.map(String)]); };
}
"""
"""Runs before everything else on every page: whoever gets a script in would call one of these."""


def find_chromium() -> tuple[Path, Path] | None:
    """Chromium and its driver: those that ``CHROMIUM`` and ``CHROMEDRIVER`` name, or on the ``PATH``, or Debian's."""
    browser = _program(os.environ.get("CHROMIUM"), "chromium", "/usr/bin/chromium")
    driver = _program(os.environ.get("CHROMEDRIVER"), "chromedriver", "/usr/bin/chromedriver")
    return (browser, driver) if browser and driver else None


def _program(*names: str | None) -> Path | None:
    found = next((path for path in map(shutil.which, filter(None, names)) if path), None)
    return Path(found) if found else None


@dataclass(slots=True)
class Browser:
    """One browser with one page."""

    driver: webdriver.Chrome
    start: str
    messages: list[str] = field(default_factory=list)
    requests: list[str] = field(default_factory=list)

    def open(self, route: str = "#/", *, start: str | None = None) -> None:
        """Load the site anew at a route."""
        self.note_logs()
        # From an empty page: a change of the hash alone would not load anything.
        self.driver.get("about:blank")
        self.driver.get((start or self.start) + route)
        self.until("window.CHALLENGER_READY === true")

    def go(self, route: str) -> None:
        """Follow a route without loading the site anew."""
        self.js("window.CHALLENGER_READY = false; location.hash = arguments[0];", route)
        self.until("window.CHALLENGER_READY === true")

    def js(self, script: str, *values: Any) -> Any:
        """Run a script in the page and give what it returns."""
        return self.driver.execute_script(script, *values)

    def until(self, condition: str, *values: Any, patience_s: float = PATIENCE_S) -> Any:
        """Wait until an expression is true in the page."""
        try:
            return WebDriverWait(self.driver, patience_s, poll_frequency=0.05).until(
                lambda _: self.js(f"return ({condition});", *values)
            )
        except TimeoutException:
            said = "; ".join(self.note_logs()[-5:]) or "the console is empty"
            raise AssertionError(f"never true: {condition} {values} at {self.route}; {said}") from None

    def all(self, name: str) -> list[WebElement]:
        """Elements with a ``data-testid``."""
        return self.driver.find_elements(By.CSS_SELECTOR, f'[data-testid="{name}"]')

    def one(self, name: str) -> WebElement:
        """The first visible element with a ``data-testid``; waits until there is one."""
        self.until('document.querySelector(`[data-testid="${arguments[0]}"]`) !== null', name)
        found = self.all(name)
        return next((element for element in found if element.is_displayed()), found[0])

    def value(self, name: str) -> str:
        """Value of a control."""
        return str(self.one(name).get_property("value"))

    def choose(self, name: str, value: str) -> None:
        """Set a control as a hand would: the value, then the events."""
        self.js(
            """
            const [control, value] = arguments;
            control.focus();
            control.value = value;
            control.dispatchEvent(new Event("input", {bubbles: true}));
            control.dispatchEvent(new Event("change", {bubbles: true}));
            """,
            self.one(name),
            value,
        )

    def click(self, element: WebElement) -> None:
        """Click an element wherever pictures that load late may move it meanwhile."""
        self.js("arguments[0].focus(); arguments[0].click();", element)

    def press(self, *keys: str, holding: str | None = None) -> None:
        """Press keys one after the other, wherever the focus is."""
        actions = ActionChains(self.driver)
        if holding is None:
            actions.send_keys(*keys).perform()
        else:
            actions.key_down(holding).send_keys(*keys).key_up(holding).perform()

    @property
    def route(self) -> str:
        """The hash of the page's address."""
        return str(self.js("return location.hash;"))

    def frames(self, count: int = 2) -> None:
        """Wait until so many frames were painted."""
        self.driver.execute_async_script(
            """
            const done = arguments[arguments.length - 1];
            let left = arguments[0];
            const step = () => { left -= 1; if (left < 0) { done(); } else { requestAnimationFrame(step); } };
            step();
            """,
            count,
        )

    def resize(self, width_px: int, height_px: int) -> None:
        """Make the page as large as a screen of so many pixels; headless windows would not become narrow enough."""
        self.driver.execute_cdp_cmd(
            "Emulation.setDeviceMetricsOverride",
            {"width": width_px, "height": height_px, "deviceScaleFactor": 1, "mobile": width_px < 600},
        )

    def prefer(self, scheme: str | None) -> None:
        """Say what the system prefers: ``light``, ``dark`` or nothing."""
        features = [] if scheme is None else [{"name": "prefers-color-scheme", "value": scheme}]
        self.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})

    def note_logs(self) -> list[str]:
        """Take what the browser logged since the last time."""
        # Selenium has no types for logs.
        driver: Any = self.driver
        for entry in driver.get_log("browser"):
            if entry["level"] in {"WARNING", "SEVERE"}:
                self.messages.append(str(entry["message"]))
        for entry in driver.get_log("performance"):
            message = json.loads(entry["message"])["message"]
            if message["method"] == "Network.requestWillBeSent":
                self.requests.append(str(message["params"]["request"]["url"]))
        return self.messages

    def forget_logs(self) -> None:
        """Begin with empty logs."""
        self.note_logs()
        self.messages.clear()
        self.requests.clear()


@contextlib.contextmanager
def started(programs: tuple[Path, Path], start: str, *, more: Sequence[str] = ()) -> Iterator[Browser]:
    """A running browser."""
    chromium, chromedriver = programs
    options = Options()
    options.binary_location = str(chromium)
    for argument in (*ARGUMENTS, *more):
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    options.set_capability("unhandledPromptBehavior", "dismiss")
    # The driver is on this machine, whatever proxy the machine has.
    with _environment(NO_PROXY="localhost,127.0.0.1", no_proxy="localhost,127.0.0.1"):
        driver = webdriver.Chrome(options=options, service=Service(str(chromedriver)))
        try:
            driver.set_page_load_timeout(2 * PATIENCE_S)
            driver.set_script_timeout(2 * PATIENCE_S)
            driver.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": _NOTE_ALERTS})
            yield Browser(driver, start)
        finally:
            with warnings.catch_warnings():
                # Selenium drops its connection to the driver without closing it.
                warnings.simplefilter("ignore", ResourceWarning)
                driver.quit()


@contextlib.contextmanager
def _environment(**changed: str) -> Iterator[None]:
    before = {name: os.environ.get(name) for name in changed}
    os.environ.update(changed)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value
