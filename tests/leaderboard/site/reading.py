"""What tests read from pages, and what the records say that pages should show."""

import re
from dataclasses import replace
from urllib.parse import parse_qs, quote

from benchmark.machine.storage import content_key
from benchmark.metrics.effect import find_touched_scenes
from benchmark.records.run import RunRecord
from tests.leaderboard.site.big_workspace import DATA_NAME
from tests.leaderboard.site.browser import Browser
from tests.leaderboard.site.conftest import Site

NUMBER = re.compile(r"-?\d+(?:\.\d+)?")
UNDEFINED = "–"


def key_of(scene: str, split: str) -> str:
    """Key of a scene's page."""
    return content_key(DATA_NAME, split, scene)[:16]


def scene_route(site: Site, scene: str, query: str = "") -> str:
    """Address of a scene's page."""
    split = "adv" if scene in site.made.adversarial else "val"
    return f"#/scene/{key_of(scene, split)}{query}"


def record_of(site: Site, planner: str, split: str) -> RunRecord:
    """Record of a planner on a split."""
    return next(record for record in site.records if record.run.planner.name == planner and record.run.split == split)


def with_baseline(site: Site) -> list[RunRecord]:
    """The records, the first planner a baseline by another name."""
    records = []
    for record in site.records:
        name = "stop" if record.planner == site.made.planners[0] else record.planner
        planner = record.run.planner.model_copy(update={"name": name})
        records.append(replace(record, run=record.run.model_copy(update={"planner": planner})))
    return records


def failing(site: Site, planner: str, split: str = "adv", protocol: str = "exact") -> set[str]:
    """Scenes that a planner fails."""
    verdicts = find_touched_scenes(record_of(site, planner, split), protocol)
    return {scene for scene, fails in verdicts.items() if fails}


def colliding_frames(
    site: Site, planner: str, scene: str, protocol: str = "exact", whom: tuple[bool | None, ...] = (True, False, None)
) -> list[int]:
    """Frames of the samples whose plan collides and counts, and touches an adversary first, another, or nobody says."""
    sheet = next(stored.sheet for (_, _, name), stored in site.sheets.scenes.items() if name == scene)
    frame_of = dict(zip(sheet.sample_tokens, sheet.keyframes, strict=True))
    return [
        frame_of[row.sample_token]
        for row in record_of(site, planner, sheet.split).rows
        if row.scene == scene
        and row.status == "ok"
        and row.outcomes[protocol].counted
        and any(row.outcomes[protocol].collision or ())
        and row.outcomes[protocol].touches_adversary in whom
    ]


def most_collisions(site: Site) -> tuple[str, str]:
    """The planner and the plainly named adversarial scene with most colliding samples."""
    plain = [scene for scene in site.made.adversarial if scene.startswith("scene-")]
    pairs = [(planner, scene) for planner in site.made.planners for scene in plain]
    return max(pairs, key=lambda pair: len(colliding_frames(site, *pair)))


def shown_scenes(browser: Browser) -> list[str]:
    """Keys of the cards on the page, once all of them are there."""
    browser.until(
        "document.querySelectorAll('[data-testid=scene-card]').length"
        " === Number(document.querySelector('[data-testid=scene-count]').textContent.match(/\\d+/)[0])"
    )
    return [str(card.get_attribute("data-key")) for card in browser.all("scene-card")]


def query_of(browser: Browser) -> dict[str, list[str]]:
    """Parameters in the page's address."""
    return parse_qs(browser.route.partition("?")[2])


def model_query(*names: str) -> str:
    """Part of an address that names planners."""
    return "&".join(f"model={quote(name, safe='')}" for name in names)


def birdseye(browser: Browser, place: int = 0) -> str:
    """Pixels of a view from above, as text."""
    browser.frames()
    return str(
        browser.js(
            "return document.querySelectorAll('[data-testid=player-birdseye]')[arguments[0]].toDataURL();", place
        )
    )


def open_player(browser: Browser, route: str) -> None:
    """Load a page with a player and wait until it can be steered."""
    browser.open(route)
    browser.one("player-scrub")
    browser.frames()
