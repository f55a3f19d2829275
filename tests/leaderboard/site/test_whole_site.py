"""What must hold on every page of the site, in a real browser."""

import functools
import threading
from collections.abc import Iterator
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import quote, urlparse

import pytest
from selenium.webdriver.common.keys import Keys

from tests.leaderboard.site.big_workspace import HOSTILE_DESCRIPTION, HOSTILE_NAMES, IMAGE_TAG
from tests.leaderboard.site.browser import Browser
from tests.leaderboard.site.conftest import Site
from tests.leaderboard.site.reading import key_of, most_collisions, open_player, scene_route

PHONE_WIDTH_PX = 360


def routes(site: Site) -> list[str]:
    """One page of each kind, those with hostile names among them."""
    planner, scene = (quote(part, safe="") for part in (IMAGE_TAG, most_collisions(site)[1]))
    hostile = key_of(HOSTILE_NAMES[0], "adv")
    return [
        "#/",
        "#/transfer",
        "#/protocols",
        "#/planners",
        f"#/model/{planner}",
        "#/scenes",
        f"#/scenes?q={scene}",
        "#/generation",
        f"#/scene/{hostile}?model={planner}",
        scene_route(site, site.made.without_sheet),
        f"#/compare/{hostile}?a={planner}&b={site.made.planners[0]}",
    ]


def settle(browser: Browser, route: str) -> None:
    """Open a page and, where it has a player, wait for it."""
    browser.open(route)
    if route.startswith(("#/scene/", "#/compare/")):
        browser.one("player-scrub")
    browser.frames(4)


def test_hostile_names_are_text_nothing_is_asked_of_anybody_else_and_phones_scroll_in_one_direction(
    browser: Browser, site: Site
) -> None:
    wide = {}
    for route in [*routes(site), *(scene_route(site, name) for name in HOSTILE_NAMES)]:
        browser.resize(PHONE_WIDTH_PX, 740)
        settle(browser, route)
        width = browser.js("return document.documentElement.scrollWidth;")
        if width > PHONE_WIDTH_PX:
            wide[route] = (width, browser.js(
                """
                return [...document.querySelectorAll("body *")]
                  .filter((node) => node.getBoundingClientRect().right > arguments[0] + 1)
                  .slice(0, 5).map((node) => `${node.tagName}.${node.className}`);
                """,
                PHONE_WIDTH_PX,
            ))  # fmt: skip
        assert browser.js("return window.noted;") == []
        injected = "[onerror], [onload], [src=x], iframe, main script, main b, object, embed, base"
        assert browser.js("return document.querySelectorAll(arguments[0]).length;", injected) == 0
        text = browser.js("return document.body.textContent;")
        assert all(name in text for name in HOSTILE_NAMES if route.startswith(scene_route(site, name)))
        if route == scene_route(site, HOSTILE_NAMES[0]):
            browser.until("document.body.textContent.includes(arguments[0])", HOSTILE_DESCRIPTION)
    assert wide == {} and browser.note_logs() == []
    folder = site.index.parent.as_uri() + "/"
    assert len(browser.requests) > 20
    assert [each for each in browser.requests if not each.startswith((folder, "data:", "about:blank"))] == []


def background(browser: Browser) -> tuple[int, int, int]:
    """Colour behind the page, as it is painted."""
    text = browser.js(
        """
        const painted = (node) => getComputedStyle(node).backgroundColor;
        const clear = (colour) => colour === "rgba(0, 0, 0, 0)" || colour === "transparent";
        const body = painted(document.body);
        return clear(body) ? painted(document.documentElement) : body;
        """
    )
    red, green, blue = (int(part) for part in text[text.index("(") + 1 : -1].split(",")[:3])
    return red, green, blue


def theme(browser: Browser) -> str:
    return str(browser.js("return document.documentElement.dataset.theme;"))


def test_light_and_dark(browser: Browser, site: Site) -> None:
    browser.open("#/")
    browser.js("try { localStorage.clear(); } catch { /* A page from disk may have none. */ }")
    brightness = {}
    for scheme in ("light", "dark"):
        browser.prefer(scheme)
        browser.open("#/planners")
        assert theme(browser) == scheme
        brightness[scheme] = sum(background(browser))
    assert brightness["light"] > 600
    assert brightness["dark"] < 200
    browser.one("theme-toggle").click()
    assert theme(browser) == "light"
    assert sum(background(browser)) == brightness["light"]
    settle(browser, scene_route(site, most_collisions(site)[1]))
    assert theme(browser) == "light"
    browser.js("localStorage.clear();")
    browser.open("#/")
    assert theme(browser) == "dark"


def test_the_slash_leads_to_the_filter(browser: Browser) -> None:
    for route in ("#/", "#/scenes", "#/generation"):
        browser.open(route)
        browser.js("document.activeElement.blur();")
        browser.press("/")
        assert browser.js("return document.activeElement.dataset.testid;") == "filter-text"
        browser.press("a/b")
        assert browser.value("filter-text") == "a/b"


@pytest.mark.parametrize(
    ("page", "wanted"),
    [
        ("#/", {"theme-toggle", "showing-play", "filter-text"}),
        ("#/scenes", {"filter-text", "filter-split", "filter-manoeuvre", "filter-fails"}),
        ("scene", {"player-play", "player-scrub", "player-model", "player-birdseye"}),
    ],
)
def test_tab_reaches_controls_and_shows_where_it_is(browser: Browser, site: Site, page: str, wanted: set[str]) -> None:
    settle(browser, scene_route(site, most_collisions(site)[1]) if page == "scene" else page)
    browser.js("document.activeElement.blur(); scrollTo(0, 0);")
    reached, unseen = set(), []
    for _ in range(60):
        browser.press(Keys.TAB)
        name, seen = browser.js(
            """
            const node = document.activeElement, style = getComputedStyle(node);
            const outlined = style.outlineStyle !== "none" && parseFloat(style.outlineWidth) > 0;
            return [node.dataset.testid ?? "", outlined || style.boxShadow !== "none"];
            """
        )
        reached.add(name)
        if not seen:
            unseen.append(name or browser.js("return document.activeElement.outerHTML.slice(0, 120);"))
        if wanted <= reached:
            break
    assert wanted <= reached
    assert unseen == []


@pytest.fixture
def served(site: Site) -> Iterator[str]:
    """The site's address on a web server of this machine."""

    class Quiet(SimpleHTTPRequestHandler):
        def log_message(self, *_: object) -> None:
            """Says nothing."""

    server = ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Quiet, directory=str(site.index.parent)))
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}/index.html"
    server.shutdown()
    server.server_close()
    thread.join()


def test_a_web_server_will_do_too(browser: Browser, site: Site, served: str) -> None:
    _, scene = most_collisions(site)
    browser.open("#/scenes", start=served)
    assert len(browser.all("scene-card")) > 0
    browser.open(scene_route(site, scene, "?t=2"), start=served)
    browser.one("player-scrub")
    assert browser.value("player-scrub") == "24"
    browser.note_logs()
    hosts = {urlparse(each).netloc for each in browser.requests if not each.startswith(("data:", "about:"))}
    assert hosts == {urlparse(served).netloc}


def test_the_site_may_be_moved(browser: Browser, site: Site) -> None:
    """Addresses in it are relative: the same page opens whatever stands before the hash."""
    open_player(browser, scene_route(site, most_collisions(site)[1]))
    texts = [path.read_text(encoding="utf-8") for path in site.index.parent.rglob("*.js")]
    texts.append(site.index.read_text(encoding="utf-8"))
    machine = str(site.made.out)
    assert not any(machine in text for text in texts)
