"""Tables, planners and addresses of the site in a real browser."""

import csv
import io
from urllib.parse import quote, unquote

import pytest
from selenium.webdriver.common.by import By
from selenium.webdriver.remote.webelement import WebElement

from benchmark.report.words import ABBREVIATIONS
from tests.leaderboard.site.big_workspace import IMAGE_TAG
from tests.leaderboard.site.browser import Browser
from tests.leaderboard.site.conftest import Site
from tests.leaderboard.site.reading import NUMBER, UNDEFINED, query_of, record_of


def cells(browser: Browser, table: WebElement, column: int) -> list[str]:
    """Texts of a column in the order on the page, hidden rows left out."""
    return list(
        browser.js(
            """
            const [table, column] = arguments;
            return [...table.tBodies[0].rows].filter((row) => row.offsetParent !== null || !row.hidden)
              .map((row) => row.cells[column].textContent);
            """,
            table,
            column,
        )
    )


def numbers(texts: list[str]) -> list[float]:
    """Numbers in cells; a dash is none."""
    found = [NUMBER.search(text.replace("−", "-")) for text in texts if text != UNDEFINED]
    return [float(match.group()) for match in found if match]


def sortable(browser: Browser) -> tuple[WebElement, int]:
    """A table and the numeric column of it with most different numbers, some of them of other lengths than others."""
    best: tuple[int, WebElement, int] | None = None
    for table in browser.driver.find_elements(By.CSS_SELECTOR, '[data-testid^="table-"]'):
        heads = browser.js("return [...arguments[0].tHead.rows].at(-1).cells.length;", table)
        for column in range(1, heads):
            texts = cells(browser, table, column)
            found = [text for text in texts if NUMBER.fullmatch(text)]
            different = len(set(found))
            if len(found) >= len(texts) - 1 and different > 2 and sorted(found) != sorted(found, key=float):
                best = max(best or (0, table, column), (different, table, column), key=lambda each: each[0])
    assert best is not None, "no table has a column in which sorting by text and by number differ"
    return best[1], best[2]


def head(browser: Browser, table: WebElement, column: int) -> WebElement:
    return browser.js("return [...arguments[0].tHead.rows].at(-1).cells[arguments[1]];", table, column)  # type: ignore[no-any-return]


def test_a_column_sorts_by_number_up_and_down_and_back(browser: Browser) -> None:
    browser.open("#/")
    table, column = sortable(browser)
    as_it_came = cells(browser, table, column)
    button = head(browser, table, column).find_element(By.TAG_NAME, "button")
    browser.click(button)
    rising = cells(browser, table, column)
    assert numbers(rising) == sorted(numbers(rising))
    assert sorted(rising) == sorted(as_it_came)
    assert head(browser, table, column).get_attribute("aria-sort") == "ascending"
    browser.click(button)
    falling = cells(browser, table, column)
    assert numbers(falling) == sorted(numbers(rising), reverse=True)
    assert head(browser, table, column).get_attribute("aria-sort") == "descending"
    dashes = [place for place, text in enumerate(falling) if text == UNDEFINED]
    assert dashes == list(range(len(falling) - len(dashes), len(falling)))
    # Order and filter survive a fresh load.
    name = str(table.get_attribute("data-testid"))
    browser.choose("filter-text", "planner-0")
    shown = cells(browser, table, column)
    browser.open(browser.route)
    table = browser.one(name)
    assert browser.value("filter-text") == "planner-0" and cells(browser, table, column) == shown
    assert head(browser, table, column).get_attribute("aria-sort") == "descending"
    browser.choose("filter-text", "")
    browser.click(head(browser, table, column).find_element(By.TAG_NAME, "button"))
    assert cells(browser, table, column) == as_it_came


def test_filter_hides_rows_without_its_words(browser: Browser) -> None:
    browser.open("#/planners")
    table = browser.driver.find_element(By.CSS_SELECTOR, '[data-testid^="table-"]')
    every = cells(browser, table, 0)
    browser.choose("filter-text", "PLANNER-01")
    kept = cells(browser, table, 0)
    assert kept
    assert len(kept) < len(every)
    assert all("planner-01" in browser.js("return arguments[0].textContent.toLowerCase();", row)
               for row in table.find_elements(By.CSS_SELECTOR, "tbody tr") if row.is_displayed())  # fmt: skip
    assert query_of(browser)["q"] == ["PLANNER-01"]
    browser.choose("filter-text", "")
    assert cells(browser, table, 0) == every


def test_numbers_say_what_stands_behind_them(browser: Browser) -> None:
    browser.open("#/")
    cell = browser.driver.find_element(By.CSS_SELECTOR, '[data-testid^="table-"] td[data-facts]')
    browser.js("arguments[0].focus();", cell)
    note = browser.driver.find_element(By.CSS_SELECTOR, "[role=tooltip]")
    assert note.is_displayed()
    assert "N = " in note.text
    assert "record " in note.text
    assert "protocol " in note.text
    assert cell.get_attribute("aria-describedby") == note.get_attribute("id")


def test_slices_are_chosen_by_kind_and_by_name_and_the_choice_is_a_link(browser: Browser) -> None:
    browser.open("#/results?group=slices")
    kinds = browser.js("return [...arguments[0].options].map((option) => option.value);", browser.one("filter-by"))
    assert {"command", "manoeuvre"} <= set(kinds) and len(kinds) == len(set(kinds))
    browser.choose("filter-by", "manoeuvre")
    titles = [title.text for title in browser.driver.find_elements(By.CSS_SELECTOR, ".table-head h3")]
    assert any(" by manoeuvre" in title for title in titles) and not any(" by command" in title for title in titles)
    of_slices = '[data-testid*="-slices-manoeuvre-"]'
    table = browser.driver.find_element(By.CSS_SELECTOR, of_slices)
    every = cells(browser, table, 2)
    name = every[0]
    assert len(set(every)) > 1
    browser.choose("filter-slice", name)
    table = browser.driver.find_element(By.CSS_SELECTOR, of_slices)
    assert cells(browser, table, 2) == [each for each in every if each == name]
    asked = query_of(browser)
    assert (asked["group"], asked["by"], asked["slice"]) == (["slices"], ["manoeuvre"], [name])
    browser.open(browser.route)
    table = browser.driver.find_element(By.CSS_SELECTOR, of_slices)
    assert set(cells(browser, table, 2)) == {name} and browser.value("filter-slice") == name


def test_every_planner_has_a_page(browser: Browser, site: Site) -> None:
    browser.open("#/planners")
    links = {link.text: str(link.get_attribute("href")) for link in browser.all("model-link")}
    assert {name for name in site.made.planners if any(name in shown for shown in links)} == set(site.made.planners)
    for name in site.made.planners:
        target = next(href for shown, href in links.items() if name in shown)
        browser.open("#" + target.partition("#")[2])
        assert name in browser.driver.find_element(By.TAG_NAME, "h1").text
        assert browser.driver.find_elements(By.CSS_SELECTOR, "main table tbody tr")
        assert name in browser.driver.title


def test_a_planners_page_has_its_driving_scores_val_beside_adv(browser: Browser, site: Site) -> None:
    name = site.made.planners[0]
    browser.open(f"#/model/{quote(name, safe='')}")
    table = browser.driver.find_element(By.CSS_SELECTOR, '[data-testid$="-pdm"]')
    assert cells(browser, table, 1) == ["val", "adv"]
    heads = browser.js("return [...arguments[0].tHead.rows].at(-1).innerText.split(/\\s*\\t\\s*/);", table)
    for row, split in enumerate(("val", "adv")):
        driving = record_of(site, name, split).summary.driving
        assert driving is not None
        for column, shown in ((2, "score"), (heads.index("NC"), "nc"), (heads.index("EC"), "ec")):
            value = driving.columns[shown]["mean"].value
            assert cells(browser, table, column)[row] == f"{100 * (value or 0.0):.1f}"
    spelled = browser.js(
        "return [...arguments[0].querySelectorAll('abbr')].map((each) => [each.textContent, each.title]);", table
    )
    assert {"NC", "EC", "TTC"} <= {short for short, _ in spelled}
    assert all(words == ABBREVIATIONS[short] for short, words in spelled)


@pytest.mark.parametrize(
    "route",
    [
        "#/nothing-of-that-name",
        "#/results?group=slices&by=nonsense",
        "#/results?group=slices&by=command&slice=nonsense",
        "#/scene/0000000000000000",
        "#/scene/constructor",
        "#/compare/__proto__?a=x&b=y",
        "#/model/nobody",
        "#/model/%E0%A4%A",
        "#/%3Cimg%20src%3Dx%20onerror%3Dalert(1)%3E",
        "#/constructor",
    ],
)
def test_addresses_that_mean_nothing_say_so(browser: Browser, route: str) -> None:
    browser.open(route)
    error = browser.one("error")
    assert error.is_displayed()
    assert error.text.endswith(".")
    assert browser.js("return window.noted;") == []
    browser.go("#/planners")
    assert browser.all("error") == [] and browser.all("model-link")


def test_a_planner_called_like_html_is_text(browser: Browser, site: Site) -> None:
    assert IMAGE_TAG in site.made.planners
    for route in ("#/", "#/transfer", "#/planners", "#/scenes", "#/model/%3Cimg%20src%3Dx%20onerror%3Dalert(1)%3E"):
        browser.open(route)
        assert IMAGE_TAG in browser.js("return document.body.textContent;")
        assert browser.js("return document.querySelectorAll('img[src=x]').length;") == 0
        assert browser.js("return window.noted;") == []


def test_every_tab_shows_its_tables_whose_columns_are_reached_by_scrolling_their_own_box(browser: Browser) -> None:
    browser.open("#/")
    tabs = browser.driver.find_elements(By.CSS_SELECTOR, "[data-testid=nav] a")
    names = {tab.text: f"#{str(tab.get_attribute('href')).partition('#')[2]}" for tab in tabs}
    assert list(names) == ["Results", "Transfer", "Scenes", "Planners", "Generation", "Protocols"]
    for name, target in names.items():
        browser.open(target)
        assert browser.all("error") == []
        current = browser.driver.find_elements(By.CSS_SELECTOR, "[data-testid=nav] a[aria-current]")
        assert [tab.text for tab in current] == [name]
        assert browser.driver.find_elements(By.CSS_SELECTOR, "main table, main article")
        lost = browser.js(
            """
            return [...document.querySelectorAll(".table-box")].filter((box) => {
              const style = getComputedStyle(box);
              return box.scrollWidth > box.clientWidth + 1 && style.overflowX !== "auto";
            }).length + [...document.querySelectorAll("th, td")].filter((cell) =>
              cell.scrollWidth > cell.clientWidth + 1 && getComputedStyle(cell).overflow === "hidden").length;
            """
        )
        assert lost == 0


def test_one_protocol_at_a_time_is_chosen_and_the_choice_is_a_link(browser: Browser) -> None:
    browser.open("#/protocols")
    names = browser.js(
        "return [...arguments[0].options].map((option) => option.value);", browser.one("filter-protocol")
    )
    assert len(names) > 1
    for name in names:
        browser.choose("filter-protocol", name)
        titles = [title.text for title in browser.driver.find_elements(By.CSS_SELECTOR, ".table-head h3")]
        judged = [title.rpartition("protocol ")[2].split()[0] for title in titles if "protocol " in title]
        assert set(judged) == {name}
        assert any("measured by exact" in title for title in titles)
    browser.open(browser.route)
    assert browser.value("filter-protocol") == names[-1]


@pytest.mark.parametrize(
    ("before", "now"),
    [
        ("#/tables", "#/results"),
        ("#/tables?group=planners%20and%20transfer", "#/transfer"),
        ("#/tables?group=slices&by=command", "#/results?group=slices&by=command"),
        ("#/tables?group=protocol%20vad", "#/protocols?protocol=vad"),
        ("#/tables?group=scenes%20and%20their%20generation", "#/generation"),
        ("#/tables?group=figures", "#/results"),
        ("#/models?protocol=vad", "#/planners?protocol=vad"),
        ("#/attempts?reason=kept", "#/generation?reason=kept"),
    ],
)
def test_addresses_of_earlier_sites_lead_to_the_new_places(browser: Browser, before: str, now: str) -> None:
    browser.open(before)
    assert browser.all("error") == [] and browser.route.startswith(now)
    assert browser.driver.find_elements(By.CSS_SELECTOR, "main table")


def test_a_table_is_a_file_too(browser: Browser) -> None:
    browser.open("#/")
    link = browser.driver.find_element(By.CSS_SELECTOR, ".files a")
    browser.js("arguments[0].addEventListener('click', (event) => event.preventDefault());", link)
    browser.click(link)
    text = unquote(str(link.get_attribute("href")).partition(",")[2])
    rows = browser.js(
        "return [...arguments[0].closest('section').querySelector('tbody').rows].filter((row) => row.cells.length > 1)"
        ".map((row) => [...row.cells].map((cell) => cell.textContent));",
        link,
    )
    heads, *read = csv.reader(io.StringIO(text))
    assert read == [["" if cell == UNDEFINED else cell for cell in row] for row in rows]
    assert any(head.startswith("difference | ") for head in heads)
