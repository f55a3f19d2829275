"""The table."""

from bench.speed.case import Case
from bench.speed.cases import driving, files, judging, networks, search

CASES: tuple[Case, ...] = (*judging.CASES, *search.CASES, *networks.CASES, *driving.CASES, *files.CASES)
