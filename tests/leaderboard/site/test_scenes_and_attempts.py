"""The scene browser and the list of attempts in a real browser."""

from collections import Counter
from dataclasses import replace
from pathlib import Path
from urllib.parse import quote

from selenium.webdriver.common.by import By

from benchmark.records.row_schema import SampleRow
from benchmark.records.run import RunRecord
from benchmark.records.scene_assessment import AssessmentSummary
from leaderboard.frame.results import read_results
from tests.leaderboard.site.big_workspace import EMOJI, HOSTILE_REASON, IMAGE_TAG, RIGHT_TO_LEFT, SCRIPT_TAG
from tests.leaderboard.site.browser import Browser
from tests.leaderboard.site.conftest import Site, write_site
from tests.leaderboard.site.reading import failing, key_of, query_of, record_of, shown_scenes


def keys(site: Site, scenes: set[str] | list[str] | tuple[str, ...]) -> set[str]:
    return {key_of(scene, "adv" if scene in site.made.adversarial else "val") for scene in scenes}


def test_all_scenes_are_there_with_their_pictures(browser: Browser, site: Site) -> None:
    browser.open("#/scenes")
    shown = shown_scenes(browser)
    assert len(shown) == len(set(shown)) == len(site.made.scenes)
    assert set(shown) == keys(site, site.made.scenes)
    for card in browser.all("scene-card"):
        browser.js("arguments[0].scrollIntoView();", card)
        pictures = card.find_elements(By.TAG_NAME, "img")
        without = card.get_attribute("data-key") == key_of(site.made.without_sheet, "val")
        assert len(pictures) == (0 if without else 1)
        if pictures:
            browser.until("arguments[0].complete && arguments[0].naturalWidth > 0", pictures[0])


def test_split_and_manoeuvre_filters(browser: Browser, site: Site) -> None:
    browser.open("#/scenes")
    browser.choose("filter-split", "val")
    assert set(shown_scenes(browser)) == keys(site, site.made.recorded)
    browser.choose("filter-split", "adv")
    assert set(shown_scenes(browser)) == keys(site, site.made.adversarial)
    facts = record_of(site, site.made.planners[0], "adv").run.scene_facts
    for manoeuvre in sorted({str(each.manoeuvre) for each in facts.values()}):
        browser.choose("filter-manoeuvre", manoeuvre)
        expected = [scene for scene, each in facts.items() if each.manoeuvre == manoeuvre]
        assert set(shown_scenes(browser)) == keys(site, expected)
        assert query_of(browser)["manoeuvre"] == [manoeuvre]


def test_filter_by_who_fails(browser: Browser, site: Site) -> None:
    browser.open("#/scenes?split=adv")
    seen = []
    for planner in site.made.planners:
        browser.choose("filter-fails", planner)
        shown = set(shown_scenes(browser))
        assert shown == keys(site, failing(site, planner))
        seen.append(len(shown))
    assert len(set(seen)) > 1, "all planners fail the same number of scenes, so this shows nothing"


def into_others(record: RunRecord) -> RunRecord:
    """The same record, every contact under ``exact`` with somebody else than the adversary."""
    rows: list[SampleRow] = []
    for row in record.rows:
        exact = row.outcomes.get("exact")
        if exact is not None and exact.facts["hit_adversary"]:
            other = exact.model_copy(update={"facts": {**exact.facts, "hit_adversary": False}})
            row = row.model_copy(update={"outcomes": {**row.outcomes, "exact": other}})
        rows.append(row)
    return replace(record, rows=tuple(rows))


def test_who_hits_another_than_the_adversary_does_not_fail_and_has_a_mark_of_its_own(
    browser: Browser, site: Site, tmp_path: Path
) -> None:
    planner = site.made.planners[1]
    records = [into_others(record) if record.planner == planner else record for record in site.records]
    start = write_site(read_results(records, sheets=site.sheets), tmp_path)
    browser.open(f"#/scenes?split=adv&fails={planner}", start=start)
    assert not shown_scenes(browser)
    browser.choose("filter-fails", "")
    browser.choose("filter-passes", planner)
    cards = {str(card.get_attribute("data-key")): card for card in browser.all("scene-card")}
    hit = keys(site, failing(site, planner)) & set(cards)
    assert hit
    for key, card in cards.items():
        mark = card.find_element(By.CSS_SELECTOR, f".marks [title^='{planner}:']")
        assert (mark.text == "◇") == (key in hit)
        assert ("another" in card.text) == (key in hit)
    browser.go(f"#/scene/{min(hit)}")
    assert "◇ hits another" in browser.one("table-verdicts").text


def judgements(site: Site) -> dict[str, AssessmentSummary]:
    """Of the adversarial scenes that somebody judged."""
    facts = record_of(site, site.made.planners[0], "adv").run.scene_facts
    return {scene: each.judgement for scene, each in facts.items() if each.judgement is not None}


def test_filter_by_who_survives_and_by_faults(browser: Browser, site: Site) -> None:
    said = judgements(site)
    safe = [scene for scene, each in said.items() if each.survives["cc"]]
    faulty = [scene for scene, each in said.items() if "off_road" in each.faults]
    assert safe and faulty and len(said) < len(site.made.adversarial)
    browser.open("#/scenes")
    browser.choose("filter-survives", "cc")
    assert set(shown_scenes(browser)) == keys(site, safe)
    browser.choose("filter-survives", "")
    browser.choose("filter-hits", "cc")
    assert set(shown_scenes(browser)) == keys(site, set(said) - set(safe))
    assert query_of(browser)["hits"] == ["cc"]
    browser.open("#/scenes?verdict=fault%3A%20off%20road")
    assert set(shown_scenes(browser)) == keys(site, faulty) and browser.value("filter-verdict") == "fault: off road"
    browser.choose("filter-verdict", "unsolvable")
    assert shown_scenes(browser) == []
    browser.open("#/scenes?survives=nobody")
    assert "nobody" in browser.one("error").text


def test_cards_say_who_survives_and_the_most_severe_come_first(browser: Browser, site: Site) -> None:
    said = judgements(site)
    browser.open("#/scenes?sort=tight&survives=recorded")
    order = sorted(said, key=lambda scene: said[scene].least_ttc_s or 0.0)
    assert shown_scenes(browser) == [key_of(scene, "adv") for scene in order]
    words = [card.text for card in browser.all("judged")]
    for scene, text in zip(order, words, strict=True):
        assert ("careful human survives" in text) is said[scene].survives["cc"]
        assert ("off road" in text) is ("off_road" in said[scene].faults)
    browser.open("#/scenes?sort=severe&split=adv")
    shown = browser.js(
        "return [...document.querySelectorAll('[data-testid=scene-card]')].map((card) =>"
        " window.CHALLENGER.scenes.find((scene) => scene.key === card.dataset.key)).map((scene) =>"
        " -(scene.order.severe ?? 1))"
    )
    assert shown == sorted(shown, reverse=True) and shown[0] > shown[-1]


def test_a_scene_page_says_who_survives_it_and_how_severe_it_is(browser: Browser, site: Site) -> None:
    said = judgements(site)
    scene = next(scene for scene in said if not said[scene].survives["cc"])
    browser.open(f"#/scene/{key_of(scene, 'adv')}")
    browser.one("table-severity")
    facts = browser.js("return document.querySelector('dl.facts').innerText;")
    assert "not survived by" in facts and "careful human" in facts and "off road" in facts
    assert "+1.2 s from when somebody could have reacted" in facts


def test_text_filter_finds_names_of_any_script(browser: Browser, site: Site) -> None:
    browser.open("#/scenes")
    for text, scene in (("🚗", EMOJI), ("سيارة", RIGHT_TO_LEFT), ("<SCRIPT>", SCRIPT_TAG)):
        browser.choose("filter-text", text)
        assert set(shown_scenes(browser)) == keys(site, [scene])
    browser.choose("filter-text", "no scene is called like this")
    assert shown_scenes(browser) == []
    browser.choose("filter-text", "")
    assert len(shown_scenes(browser)) == len(site.made.scenes)


def test_a_deep_link_restores_the_filters(browser: Browser, site: Site) -> None:
    planner = IMAGE_TAG
    scenes = failing(site, planner)
    assert scenes
    facts = record_of(site, planner, "adv").run.scene_facts
    manoeuvre = str(facts[min(scenes)].manoeuvre)
    browser.open(f"#/scenes?split=adv&manoeuvre={manoeuvre}&fails={quote(planner, safe='')}")
    expected = [scene for scene in scenes if facts[scene].manoeuvre == manoeuvre]
    assert set(shown_scenes(browser)) == keys(site, expected)
    assert browser.value("filter-split") == "adv"
    assert browser.value("filter-manoeuvre") == manoeuvre
    assert browser.value("filter-fails") == planner
    # A card leads to its scene, and back to the filters.
    card = browser.all("scene-card")[0]
    card_key = card.get_attribute("data-key")
    browser.click(card.find_element(By.CSS_SELECTOR, "a.name"))
    browser.one("player-scrub")
    assert browser.route.startswith(f"#/scene/{card_key}")
    browser.driver.back()
    browser.one("scene-count")
    assert browser.value("filter-split") == "adv" and set(shown_scenes(browser)) == keys(site, expected)


def test_attempts_say_what_was_discarded_and_why(browser: Browser, site: Site) -> None:
    attempts = [attempt for sheet in site.sheets.splits.values() for attempt in sheet.attempts]
    reasons = Counter(attempt.discarded for attempt in attempts if attempt.discarded is not None)
    assert HOSTILE_REASON in reasons
    browser.open("#/generation")
    assert len(browser.driver.find_elements(By.CSS_SELECTOR, "[data-testid=table-attempts] tbody tr")) == len(attempts)
    for reason, count in reasons.items():
        browser.choose("filter-reason", reason)
        rows = browser.driver.find_elements(By.CSS_SELECTOR, "[data-testid=table-attempts] tbody tr")
        assert len(rows) == count
        assert all(reason in row.text for row in rows)
        assert query_of(browser)["reason"] == [reason]
    browser.open(f"#/generation?reason={quote(HOSTILE_REASON, safe='')}")
    assert browser.value("filter-reason") == HOSTILE_REASON
    assert browser.js("return document.querySelectorAll('main svg[onload]').length;") == 0
    assert browser.js("return window.noted;") == []
    browser.choose("filter-reason", "kept")
    links = browser.driver.find_elements(By.CSS_SELECTOR, "[data-testid=table-attempts] tbody a")
    assert len(links) == len(site.made.adversarial)
    browser.click(links[0])
    browser.one("player-scrub")
    assert browser.route.startswith("#/scene/")
