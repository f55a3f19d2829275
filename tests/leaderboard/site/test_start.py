"""The first page in a real browser: what this is, a scene that plays, the table that matters, where to go on."""

import re
from pathlib import Path

from selenium.webdriver.common.by import By

from benchmark.records.scene_pages import NO_SCENE_PAGES
from leaderboard.frame.results import read_results
from tests.leaderboard.site.browser import Browser
from tests.leaderboard.site.conftest import Site, write_site
from tests.leaderboard.site.reading import record_of

TALLEST_PX = 2500


def begun(browser: Browser) -> None:
    """Wait until the scene is drawn."""
    browser.until("document.querySelector('[data-testid=showing]')?.dataset.frame !== undefined")


def test_a_scene_plays_by_itself_and_stops_when_told(browser: Browser) -> None:
    browser.open("#/")
    begun(browser)
    assert browser.js("return document.documentElement.scrollHeight;") < TALLEST_PX
    said = browser.driver.find_element(By.CSS_SELECTOR, "main .lead").text
    assert len(re.findall(r"[.](?:\s|$)", said)) == 3
    assert len(browser.driver.find_elements(By.CSS_SELECTOR, "main table, main figure")) == 2
    # The wheel scrolls the page and not the scene.
    wheel = 'new WheelEvent("wheel", { deltaY: 120, bubbles: true, cancelable: true })'
    assert browser.js(f'return document.querySelector(".showing-above").dispatchEvent({wheel});')
    first = browser.one("showing").get_attribute("data-frame")
    browser.until("document.querySelector('[data-testid=showing]').dataset.frame !== arguments[0]", first)
    browser.click(browser.one("showing-play"))
    browser.frames(3)
    stopped = browser.one("showing").get_attribute("data-frame")
    browser.frames(30)
    assert browser.one("showing").get_attribute("data-frame") == stopped
    browser.click(browser.one("showing-play"))
    browser.until("document.querySelector('[data-testid=showing]').dataset.frame !== arguments[0]", stopped)


def test_nothing_moves_unasked_for_those_who_do_not_want_it(browser: Browser) -> None:
    still = {"features": [{"name": "prefers-reduced-motion", "value": "reduce"}]}
    browser.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", still)
    browser.open("#/")
    begun(browser)
    first = browser.one("showing").get_attribute("data-frame")
    browser.frames(40)
    assert browser.one("showing").get_attribute("data-frame") == first
    browser.click(browser.one("showing-play"))
    browser.until("document.querySelector('[data-testid=showing]').dataset.frame !== arguments[0]", first)


def test_the_table_has_the_averages_of_the_records(browser: Browser, site: Site) -> None:
    browser.open("#/")
    rows = {
        row.find_element(By.TAG_NAME, "th").text: [cell.text for cell in row.find_elements(By.TAG_NAME, "td")]
        for row in browser.driver.find_elements(By.CSS_SELECTOR, "main table tbody tr")
    }
    assert {name.removesuffix(" †") for name in rows} == set(site.made.planners)
    for name, cells in rows.items():
        for split, shown in (("val", cells[0]), ("adv", cells[2])):
            rate = (
                record_of(site, name.removesuffix(" †"), split).summary.protocols["exact"].columns["collision"]["avg"]
            )
            assert float(shown) == round(100 * (rate.value or 0.0), 2)


def test_it_leads_on(browser: Browser, site: Site) -> None:
    browser.open("#/")
    links = browser.driver.find_elements(By.CSS_SELECTOR, "[data-testid=onwards] a")
    targets = [str(link.get_attribute("href")).partition("#")[2] for link in links]
    kinds = [target.split("/")[1].split("?")[0] for target in targets]
    assert kinds == ["tables", "models", "scenes", "attempts", "compare"]
    for target in targets:
        browser.open("#" + target)
        assert browser.all("error") == []


def test_pictures_follow_the_theme(browser: Browser) -> None:
    for route in ("#/", "#/scenes"):
        browser.prefer("dark")
        browser.open(route)
        pictures = "[...document.querySelectorAll('main img')].map((image) => image.getAttribute('src'))"
        dark = browser.js(f"return {pictures};")
        browser.prefer("light")
        browser.until("document.documentElement.dataset.theme === 'light'")
        light = browser.js(f"return {pictures};")
        assert dark and all("dark" in path for path in dark)
        assert not any("dark" in path for path in light)


def test_without_sheets_the_rest_is_there(browser: Browser, site: Site, tmp_path: Path) -> None:
    browser.open("#/", start=write_site(read_results(site.records, sheets=NO_SCENE_PAGES), tmp_path))
    assert browser.all("showing") == []
    assert "challenger-bench sheets" in browser.driver.find_element(By.TAG_NAME, "main").text
    assert browser.driver.find_elements(By.CSS_SELECTOR, "main table tbody tr")
