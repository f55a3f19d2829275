PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
export OMP_NUM_THREADS ?= 1
# Tests start many processes: each would compile everything anew where this is set.
unexport PYTHONDONTWRITEBYTECODE

INSTALL := $(PYTHON) .ci/install.py
# An environment that holds the built wheel and what it asks for, nothing else.
INSTALLED := build/installed
# PyTorch's own index of builds without CUDA, which save 6 GB where there is no NVIDIA GPU.
TORCH_CPU ?= https://download.pytorch.org/whl/cpu

.PHONY: setup browser demo paper test test-extensions test-all test-fast test-slow core-alone check site-check wheel wheel-check docs bench gpu attack clean

# The product alone, for make demo; set-up adds the tools of the tests and every extra that they need.
setup: $(VENV)/.complete

$(VENV)/.product: pyproject.toml constraints.txt
	@$(PYTHON) -c "import sys; sys.exit(sys.version_info < (3, 11))" || \
	  { echo "challenger-bench needs Python 3.11 or newer, and $(PYTHON) is older; try: make PYTHON=python3.12"; exit 2; }
	@echo "setting up $(CURDIR)/$(VENV): torch, nuscenes-devkit and what they need"
	@echo "0.4 GB to fetch and 1.7 GB on disk, minutes"
	@$(PYTHON) -m venv $(VENV)
	@$(INSTALL) --torch-from $(TORCH_CPU) $(VENV) --constraint constraints.txt --editable .
	@$(BIN)/python -c "import torch; print('set up, with torch', torch.__version__)"
	@touch $@

$(VENV)/.complete: $(VENV)/.product
	@echo "adding what the tests need: ray, transformers, tools; 0.2 GB to fetch, 0.6 GB more on disk"
	@$(INSTALL) $(VENV) --constraint constraints.txt --editable ".[dev]"
	@touch $@

# Debian's packages, as root or by sudo where it asks no password.
browser:
	@sh tests/leaderboard/site/get_chromium.sh

demo: $(VENV)/.product
	$(BIN)/challenger-bench demo

paper: $(VENV)/.product
	$(BIN)/challenger-bench demo --full

check: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

# The types of the pages' scripts, by TypeScript, which npm fetches once into build/; no other target needs Node.js.
TYPESCRIPT := 5.9.3
site-check:
	@command -v npm >/dev/null || { echo "make site-check needs Node.js with npm (Debian: nodejs npm)"; exit 2; }
	@test -x build/typescript-$(TYPESCRIPT)/node_modules/.bin/tsc || \
	  npm install --silent --no-audit --no-fund --prefix build/typescript-$(TYPESCRIPT) typescript@$(TYPESCRIPT)
	build/typescript-$(TYPESCRIPT)/node_modules/.bin/tsc --checkJs --strict --noEmit --project tests/leaderboard/site

# ruff, mypy, the core's tests and a golden path of each extension. Installs nothing beside the packages of set-up:
# without Chromium the tests in a browser are skipped.
test: check
	$(BIN)/pytest -n auto --dist loadscope --part core
	@{ command -v "$${CHROMIUM:-chromium}" && command -v "$${CHROMEDRIVER:-chromedriver}"; } >/dev/null 2>&1 || \
	  echo "there is no Chromium with its driver here: the tests of the site in a browser were skipped; make browser installs it"

# What is left of the extensions' tests.
test-extensions: setup
	$(BIN)/pytest -n auto --dist loadscope --part extensions

test-all: test test-extensions

# The tests of the folders that the working tree changes (of the last commit, if it changes none), within a minute.
test-fast: setup
	$(BIN)/ruff check .
	$(BIN)/pytest -n auto --dist loadscope --part core --budget 45 $$($(BIN)/python -m tests.parts)

# Training, soaks and kills: what runs at night.
test-slow: setup
	$(BIN)/pytest -n auto --dist loadscope --part slow

# The tests of the core in a copy without any extension.
core-alone: setup
	rm -rf build/core
	mkdir -p build/core
	git ls-files -z | xargs -0 cp --parents -t build/core
	rm -rf build/core/*/extensions/*/ build/core/tests/*/extensions
	cd build/core && PYTHONPATH="$$PWD" ../../$(BIN)/pytest -n auto --dist loadscope

# dist/: the wheel is made from the source archive, so that leftovers of this folder get into neither.
wheel: setup
	rm -rf dist
	SOURCE_DATE_EPOCH=$$(git log -1 --format=%ct 2>/dev/null || echo 1600000000) \
	  $(BIN)/python -m build --no-isolation --outdir dist . >/dev/null
	@$(BIN)/python tests/packaging/contents.py dist/*

# The built wheel in an empty environment: doctor, numerics, a tiny town, planners, a drive, the site; and then the demo.
wheel-check: wheel
	rm -rf $(INSTALLED)
	$(PYTHON) -m venv $(INSTALLED)
	@$(INSTALL) --torch-from $(TORCH_CPU) $(INSTALLED) --constraint constraints.txt dist/*.whl
	$(INSTALLED)/bin/python -I tests/packaging/check_installed.py --demo

$(VENV)/.docs: $(VENV)/.complete
	@$(INSTALL) $(VENV) --constraint constraints.txt --editable ".[docs]"
	@touch $@

# build/docs/index.html: opens from disk. Then every link is followed, and the longer lines of code of the pages run.
docs: $(VENV)/.docs
	NO_MKDOCS_2_WARNING=1 PYTHONPATH=. $(BIN)/python -m mkdocs build --quiet
	@$(BIN)/python tests/documentation/built_site.py build/docs
	CHALLENGER_BENCH_LONG_LINES=1 $(BIN)/pytest tests/documentation/test_lines.py

# What waits for a GPU has a target of its own.
bench: setup
	$(BIN)/python -m bench.speed

# Everything that waits for a GPU, in pieces of under ten minutes; the same command goes on (docs/performance.md).
gpu: setup
	$(BIN)/python bench/gpu.py $(GPU_OPTIONS)

# Hostile variants of everything that commands read, and absurd command lines, side by side: an hour on two processors.
# The same command goes on (docs/hostile-input.md).
attack: setup
	$(BIN)/python bench/attack.py --seed $${SEED:-0} --count $${COUNT:-1000}

clean:
	rm -rf $(VENV) challenger-out build dist *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis
