PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
export OMP_NUM_THREADS ?= 1

.PHONY: setup browser demo paper test check bench clean

setup: $(VENV)/.complete

$(VENV)/.complete: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable ".[dev]"
	touch $@

browser:
	@sh tests/leaderboard/site/get_chromium.sh

demo: setup
	$(BIN)/challenger-bench demo

paper: setup
	$(BIN)/challenger-bench demo --full

check: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

test: check browser
	$(BIN)/pytest -n auto --dist loadscope

bench: setup
	for script in bench/[a-z]*.py; do echo "== $$script"; $(BIN)/python $$script || exit 1; done

clean:
	rm -rf $(VENV) challenger-out build *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis
