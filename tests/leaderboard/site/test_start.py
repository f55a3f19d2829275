"""The first page in a real browser: the table that matters, a scene that plays, and all other results."""

import re
from pathlib import Path

from selenium.webdriver.common.by import By

from benchmark.metrics.effect import AT_3_S, compute_effect
from benchmark.records.scene_pages import NO_SCENE_PAGES
from leaderboard.frame.results import read_results
from tests.leaderboard.site.browser import Browser
from tests.leaderboard.site.conftest import Site, write_site
from tests.leaderboard.site.reading import with_baseline


def begun(browser: Browser) -> None:
    """Wait until the scene is drawn."""
    browser.until("document.querySelector('[data-testid=showing]')?.dataset.frame !== undefined")


def test_a_scene_plays_by_itself_and_stops_when_told(browser: Browser) -> None:
    browser.open("#/")
    begun(browser)
    assert len(re.findall(r"[.?](?:\s|$)", browser.driver.find_element(By.CSS_SELECTOR, "main .lead").text)) == 2
    first_seen = browser.js(
        "return [...document.querySelectorAll('main table, .showing')].map((each) => each.className);"
    )
    assert first_seen[:2] == ["", "showing"]
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


def test_the_first_table_has_the_effect_of_the_records_and_baselines_stay_apart_however_it_is_sorted(
    browser: Browser, site: Site, tmp_path: Path
) -> None:
    records = with_baseline(site)
    browser.open("#/", start=write_site(read_results(records, sheets=site.sheets), tmp_path))
    table = browser.driver.find_element(By.CSS_SELECTOR, "main table")
    heads = browser.js("return [...arguments[0].tHead.rows[1].cells].map((cell) => cell.textContent);", table)
    column = heads.index("difference")
    read = "return [...arguments[0].tBodies[0].rows].map((row) => [...row.cells].map((cell) => cell.textContent));"
    rows = browser.js(read, table)
    (label,) = [place for place, row in enumerate(rows) if len(row) == 1]
    assert [row[0] for row in rows[label + 1 :]] == ["stop"]
    for row in rows[:label] + rows[label + 1 :]:
        of_splits = {record.run.split: record for record in records if record.planner == row[0].removesuffix(" †")}
        effect = compute_effect(of_splits["adv"], of_splits["val"])
        assert effect is not None and effect.touched is not None and effect.paired is not None
        assert row[heads.index("adversary 3s")] == f"{100 * effect.touched[AT_3_S]:.1f}"
        assert abs(float(row[column].replace("−", "-")) - 100 * (effect.paired.difference.value or 0.0)) < 0.051
    head = browser.js("return arguments[0].tHead.rows[1].cells[arguments[1]];", table, column)
    assert head.get_attribute("aria-sort") == "ascending"
    browser.click(head.find_element(By.TAG_NAME, "button"))
    turned = browser.js(read, table)
    assert turned[label] == rows[label] and turned[:label] == rows[:label][::-1]


def test_one_page_has_all_results_and_its_links_lead_to_their_headings(browser: Browser) -> None:
    browser.open("#/")
    begun(browser)
    groups = [link.text for link in browser.driver.find_elements(By.CSS_SELECTOR, ".contents a")]
    assert {"effect of the adversary", "collision rates", "causes", "slices"} <= set(groups)
    browser.click(browser.driver.find_element(By.LINK_TEXT, "causes"))
    browser.until("window.CHALLENGER_READY === true")
    heading = browser.js("return [...document.querySelectorAll('h2')].find((each) => each.textContent === 'Causes');")
    assert 0 <= browser.js("return arguments[0].getBoundingClientRect().top;", heading) < 200
    assert browser.route == "#/results?group=causes"


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
