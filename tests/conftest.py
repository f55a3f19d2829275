"""What all tests share, and the parts in which they run: the core, the extensions, and what runs at night."""

import gc
import time
from collections.abc import Iterator
from functools import cache

# Imported first: it looks for who refers to its generators, which does not find what is frozen below.
import hypothesis
import pytest
import typer.main

from tests.parts import PARTS, part_of

# No test fails because a machine is busy.
hypothesis.settings.register_profile("untimed", deadline=None)
hypothesis.settings.load_profile("untimed")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--part", choices=PARTS, help="run one part of the tests instead of all")
    parser.addoption("--budget", type=float, metavar="SECONDS", help="start no test after so many seconds")


def pytest_configure(config: pytest.Config) -> None:
    if config.getoption("--budget") is not None:
        config.pluginmanager.register(Budget(config.getoption("--budget")))


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if (part := config.getoption("--part")) is None:
        return
    chosen: list[pytest.Item] = []
    others: list[pytest.Item] = []
    for item in items:
        (chosen if part_of(item) == part else others).append(item)
    config.hook.pytest_deselected(items=others)
    items[:] = chosen


class Budget:
    """Skips the tests that come after the budget is spent, so that the summary counts them."""

    def __init__(self, seconds: float) -> None:
        self.seconds, self.start = seconds, time.monotonic()

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_setup(self) -> None:
        if time.monotonic() - self.start > self.seconds:
            pytest.skip(f"after the budget of {self.seconds:g} s; make test runs it")


@pytest.fixture(scope="module", autouse=True)
def nothing_left_open() -> Iterator[None]:
    """What a module leaves open is its own failure, not that of whichever test runs when Python notices.

    What is alive after that (imports, session fixtures, the tests themselves) is not looked through again.
    """
    yield
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session", autouse=True)
def built_once() -> Iterator[None]:
    """A scene of the embedded town, which its arguments decide, and the tree of commands are built once a process."""
    from generation.sources.town import build_town_scene

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("generation.sources.mini.build_town_scene", cache(build_town_scene))
        patch.setattr("typer.main.get_command", cache(typer.main.get_command))
        yield
