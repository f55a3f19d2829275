"""The scene player and the comparison of two planners in a real browser."""

import re
import shutil
from pathlib import Path
from urllib.parse import quote

import pytest
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys

from tests.leaderboard.site.browser import Browser
from tests.leaderboard.site.conftest import Site
from tests.leaderboard.site.reading import (
    birdseye,
    colliding_frames,
    key_of,
    model_query,
    most_collisions,
    open_player,
    query_of,
    scene_route,
)


def scrub_to(browser: Browser, frame: int) -> None:
    browser.choose("player-scrub", str(frame))
    browser.until("document.querySelector('[data-testid=player-scrub]').value === String(arguments[0])", frame)
    browser.frames()


def shown_seconds(browser: Browser) -> float:
    found = re.search(r"\d+(?:\.\d+)?", browser.one("player-time").text)
    assert found
    return float(found.group())


def chosen(browser: Browser) -> set[str]:
    return {str(box.get_property("value")) for box in browser.all("player-model") if box.is_selected()}


def focus_on_the_page(browser: Browser) -> None:
    browser.js("document.activeElement.blur();")


def test_scrubbing_changes_time_view_and_pictures(browser: Browser, site: Site) -> None:
    planner, scene = most_collisions(site)
    open_player(browser, scene_route(site, scene, "?" + model_query(planner)))
    sheet = next(stored.sheet for (_, _, name), stored in site.sheets.scenes.items() if name == scene)
    scrub = browser.one("player-scrub")
    assert (scrub.get_attribute("min"), scrub.get_attribute("step")) == ("0", "1")
    assert int(str(scrub.get_attribute("max"))) == len(sheet.timestamps_us) - 1
    cameras = browser.one("player-cameras")
    views, pictures, times = [], [], []
    for frame in (0, 30, 66):
        scrub_to(browser, frame)
        browser.frames(6)
        views.append(birdseye(browser))
        pictures.append(cameras.screenshot_as_png)
        times.append(shown_seconds(browser))
    assert times == pytest.approx([0.0, 2.5, 5.5], abs=0.06)
    assert len(set(views)) == len(set(pictures)) == 3
    # The time goes into the address and comes back.
    browser.until("Math.abs(new URLSearchParams(location.hash.split('?')[1]).get('t') - 5.5) < 0.05")
    open_player(browser, browser.route)
    assert browser.value("player-scrub") == "66"


def test_keys_steer(browser: Browser, site: Site) -> None:
    _, scene = most_collisions(site)
    open_player(browser, scene_route(site, scene, "?t=2"))
    focus_on_the_page(browser)
    last = int(str(browser.one("player-scrub").get_attribute("max")))
    for keys, frame in (
        ((Keys.ARROW_RIGHT,), 25),
        ((Keys.ARROW_LEFT, Keys.ARROW_LEFT), 23),
        ((Keys.END,), last),
        ((Keys.ARROW_RIGHT,), last),
        ((Keys.HOME,), 0),
        ((Keys.ARROW_LEFT,), 0),
    ):
        browser.press(*keys)
        browser.until("document.querySelector('[data-testid=player-scrub]').value === String(arguments[0])", frame)
    browser.press(Keys.ARROW_RIGHT, Keys.ARROW_RIGHT, holding=Keys.SHIFT)
    browser.until("document.querySelector('[data-testid=player-scrub]').value === '12'")


def test_space_plays_and_stops(browser: Browser, site: Site) -> None:
    _, scene = most_collisions(site)
    open_player(browser, scene_route(site, scene, "?t=0"))
    focus_on_the_page(browser)
    before = birdseye(browser)
    browser.press(" ")
    browser.until("Number(document.querySelector('[data-testid=player-scrub]').value) >= 3")
    assert birdseye(browser) != before
    browser.press(" ")
    browser.frames(3)
    stopped = browser.value("player-scrub")
    browser.frames(20)
    assert browser.value("player-scrub") == stopped
    browser.one("player-play").click()
    browser.until("document.querySelector('[data-testid=player-scrub]').value !== arguments[0]", stopped)


@pytest.mark.parametrize("protocol", ["exact", "uniad"])
def test_collisions_are_marked_where_the_record_says(browser: Browser, site: Site, protocol: str) -> None:
    planner, scene = most_collisions(site)
    planners = [planner, next(name for name in site.made.planners if name != planner)]
    open_player(browser, scene_route(site, scene, f"?{model_query(*planners)}&protocol={protocol}"))
    expected = sorted(frame for name in planners for frame in colliding_frames(site, name, scene, protocol))
    marks = browser.all("player-collision")
    assert sorted(int(str(mark.get_attribute("data-frame"))) for mark in marks) == expected
    assert expected
    for code, sign, whom in (("X", "✕", True), ("a", "◇", False), ("w", "–", None)):
        kind = [mark for mark in marks if mark.get_attribute("data-mark") == code]
        assert all(mark.text == sign for mark in kind)
        shown = [mark.get_attribute("data-frame") for mark in kind]
        found = [colliding_frames(site, name, scene, protocol, (whom,)) for name in planners]
        assert sorted(int(str(each)) for each in shown) == sorted(frame for frames in found for frame in frames)
    browser.click(marks[-1])
    browser.until(
        "document.querySelector('[data-testid=player-scrub]').value === arguments[0]",
        marks[-1].get_attribute("data-frame"),
    )
    assert "hits" in browser.one("player-verdicts").text


def test_lines_of_planners_that_are_not_shown_are_grey_and_not_empty(browser: Browser, site: Site) -> None:
    planner, scene = most_collisions(site)
    other = next(name for name in site.made.planners if name != planner)
    open_player(browser, scene_route(site, scene, "?" + model_query(other)))
    off = browser.driver.find_elements(By.CSS_SELECTOR, f'.cp-off [data-model="{planner}"]')
    assert len(off) == len(colliding_frames(site, planner, scene))
    quiet = browser.js("return getComputedStyle(arguments[0]).color;", off[0])
    assert f"at {float(str(off[0].get_attribute('data-frame'))) / 12:.1f} s" in str(off[0].get_attribute("title"))
    browser.click(next(box for box in browser.all("player-model") if box.get_property("value") == planner))
    on = browser.all("player-collision")
    assert browser.js("return getComputedStyle(arguments[0]).color;", on[0]) != quiet


def test_times_are_those_of_the_scene(browser: Browser, site: Site) -> None:
    planner, scene = most_collisions(site)
    open_player(browser, scene_route(site, scene, "?" + model_query(planner)))
    mark = browser.all("player-collision")[0]
    made = float(str(mark.get_attribute("data-frame"))) / 12
    contact = made + float(str(mark.get_attribute("data-contact")))
    assert re.search(rf"made at {made:.1f} s .* at {contact:.1f} s", str(mark.get_attribute("title")))
    browser.click(mark)
    browser.until("document.querySelector('.cp-verdicts tbody td:nth-of-type(4)')?.textContent === arguments[0]",
                  f"{contact:.1f} s")  # fmt: skip


def test_nothing_plays_before_its_pictures_are_there(browser: Browser, site: Site) -> None:
    open_player(browser, scene_route(site, most_collisions(site)[1], "?t=0"))
    late = "{ get: () => window.there, configurable: true }"
    browser.js(f"window.there = false; Object.defineProperty(HTMLImageElement.prototype, 'complete', {late});")
    browser.one("player-play").click()
    browser.frames(20)
    assert browser.value("player-scrub") == "0" and browser.one("player-play").text == "Loading …"
    browser.js("window.there = true;")
    browser.until("Number(document.querySelector('[data-testid=player-scrub]').value) >= 3")


def test_planners_are_chosen_and_remembered(browser: Browser, site: Site) -> None:
    planner, scene = most_collisions(site)
    open_player(browser, scene_route(site, scene, f"?{model_query(planner)}&t=1"))
    assert {str(box.get_property("value")) for box in browser.all("player-model")} == set(site.made.planners)
    assert chosen(browser) == {planner}
    alone = birdseye(browser)
    for box in browser.all("player-model"):
        if not box.is_selected():
            browser.click(box)
    assert chosen(browser) == set(site.made.planners)
    assert birdseye(browser) != alone
    browser.until("location.hash.split('model=').length - 1 === arguments[0]", len(site.made.planners))
    assert set(query_of(browser)["model"]) == set(site.made.planners)
    open_player(browser, browser.route)
    assert chosen(browser) == set(site.made.planners)


def test_a_deep_link_restores_everything(browser: Browser, site: Site) -> None:
    planner, scene = most_collisions(site)
    route = scene_route(site, scene, f"?t=2.5&{model_query(planner)}&protocol=vad&camera=CAM_BACK")
    open_player(browser, route)
    assert browser.value("player-scrub") == "30"
    assert chosen(browser) == {planner}
    assert browser.value("player-protocol") == "vad"
    assert browser.value("player-camera") == "CAM_BACK"
    first = browser.one("player-cameras").screenshot_as_png
    browser.choose("player-camera", "CAM_FRONT")
    browser.frames(6)
    assert browser.one("player-cameras").screenshot_as_png != first
    assert query_of(browser)["camera"] == ["CAM_FRONT"]


def test_two_planners_side_by_side(browser: Browser, site: Site) -> None:
    planner, scene = most_collisions(site)
    other, third = [name for name in site.made.planners if name != planner][:2]
    query = f"?a={quote(planner, safe='')}&b={quote(other, safe='')}&t=2"
    open_player(browser, f"#/compare/{key_of(scene, 'adv')}{query}")
    assert (browser.value("compare-a"), browser.value("compare-b")) == (planner, other)
    assert len(browser.all("player-birdseye")) == 2
    assert birdseye(browser, 0) != birdseye(browser, 1)
    left, right = birdseye(browser, 0), birdseye(browser, 1)
    scrub_to(browser, 40)
    assert birdseye(browser, 0) != left
    assert birdseye(browser, 1) != right
    left, right = birdseye(browser, 0), birdseye(browser, 1)
    browser.choose("compare-b", third)
    assert (birdseye(browser, 0) == left, birdseye(browser, 1) == right) == (True, False)
    browser.until("new URLSearchParams(location.hash.split('?')[1]).get('b') === arguments[0]", third)
    open_player(browser, browser.route)
    assert (browser.value("compare-a"), browser.value("compare-b")) == (planner, third)
    text = browser.one("player").text
    assert planner in text
    assert third in text


def test_a_scene_without_a_sheet_has_its_plans(browser: Browser, site: Site) -> None:
    planner = site.made.planners[1]
    open_player(browser, scene_route(site, site.made.without_sheet, "?" + model_query(planner)))
    assert "challenger-bench sheets" in browser.driver.find_element(By.TAG_NAME, "main").text
    shown = birdseye(browser)
    browser.click(next(box for box in browser.all("player-model") if box.get_property("value") == planner))
    assert birdseye(browser) != shown


def test_a_missing_script_is_said(browser: Browser, site: Site, tmp_path: Path) -> None:
    broken = shutil.copytree(site.index.parent, tmp_path / "site")
    _, scene = most_collisions(site)
    (broken / "data" / "scenes" / f"{key_of(scene, 'adv')}.js").unlink()
    browser.open(scene_route(site, scene), start=(broken / "index.html").as_uri())
    assert browser.one("error").text.endswith(".")
    assert any("ERR_FILE_NOT_FOUND" in message for message in browser.note_logs())
    browser.forget_logs()


def fails(site: Site, planner: str, scene: str) -> bool:
    return bool(colliding_frames(site, planner, scene, whom=(True,)))


def test_the_player_begins_two_seconds_before_the_first_contact_with_planners_that_differ(
    browser: Browser, site: Site
) -> None:
    plain = [scene for scene in site.made.adversarial if scene.startswith("scene-")]
    told = [scene for scene in plain if len({fails(site, planner, scene) for planner in site.made.planners}) == 2]
    assert told
    open_player(browser, scene_route(site, told[0]))
    shown = chosen(browser)
    assert {fails(site, planner, told[0]) for planner in shown} == {True, False}
    contacts = [
        float(str(mark.get_attribute("data-frame"))) / 12 + float(str(mark.get_attribute("data-contact")))
        for mark in browser.all("player-collision")
        if mark.get_attribute("data-mark") == "X"
    ]
    assert shown_seconds(browser) == pytest.approx(max(min(contacts) - 2.0, 0.0), abs=0.06)
    assert "?" not in browser.route
    texts = [each.text for each in browser.driver.find_elements(By.CSS_SELECTOR, ".cp-when")]
    assert texts[:3] == ["0 s", "1", "2"]
    places = browser.js("return [...document.querySelectorAll('.cp-when')].map((each) => parseFloat(each.style.left));")
    assert places == sorted(places) and places[0] == 0


def test_letters_on_every_page_can_be_read(browser: Browser, site: Site) -> None:
    """Eleven pixels at least, in text of pages as in figures, whose boxes scroll before they shrink."""
    _, scene = most_collisions(site)
    for route in ("#/", "#/transfer", scene_route(site, scene)):
        browser.open(route)
        smallest = browser.js(
            """
            const written = (node) => [...node.childNodes].some((each) =>
              each.nodeType === Node.TEXT_NODE && each.textContent.trim());
            const texts = [...document.querySelectorAll("body *:not(script, noscript)")].filter(written);
            return Math.min(...texts.map((node) => parseFloat(getComputedStyle(node).fontSize)));
            """
        )
        assert smallest >= 11
        shrunk = browser.js(
            """
            return [...document.querySelectorAll(".figure img")].filter((image) => image.getAttribute("width")
              && image.getBoundingClientRect().width < 0.96 * Number(image.getAttribute("width"))).length;
            """
        )
        assert shrunk == 0
