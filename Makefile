# Needs python3 (>= 3.11), make and a package index; everything else is installed into .venv.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# What is installed: everything, or at least what the demo needs.
STAMP := $(VENV)/.installed
DEMO_STAMP := $(VENV)/.installed-for-demo
# One BLAS thread per worker process, so that parallel tests do not fight over the cores.
TEST_ENV := OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1
WORKERS ?= 2

.PHONY: setup demo test test-all fuzz harden check release-check headline results results-all bench docs tutorial screenshots clean

setup: $(STAMP)

$(STAMP): pyproject.toml packages/magmatch-serve/pyproject.toml packages/magmatch-evaluation/pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e ".[dev]" \
	  -e "./packages/magmatch-serve[foxglove]" -e ./packages/magmatch-evaluation
	touch $@ $(DEMO_STAMP)

$(DEMO_STAMP): pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile -e ".[viz]"
	touch $@

demo: $(DEMO_STAMP)
	$(BIN)/magmatch demo --out demo-output

# Every law, oracle, door and error. A worker that has finished takes over what another has before it: otherwise
# neighbours, and what they share, lie in one process.
PYTEST := $(TEST_ENV) $(BIN)/python -m pytest -n $(WORKERS) --dist worksteal

test: setup
	$(PYTEST) -m "not slow"

# And what is long by nature: recoveries, kills, clusters, long simulations, whole notebooks, more of what is random.
test-all: setup
	$(PYTEST) --fuzz 120 --corruptions 200

# At least this many mutated files for each reader; the suite tries a few of them.
FUZZ ?= 10000

fuzz: setup
	$(PYTEST) --fuzz $(FUZZ) tests/data/logs/test_fuzz.py \
	  tests/hardening/test_fuzz_records.py

# Kills among all writers, and corruptions of each saved file; the suite does some of both.
KILLS ?= 600
CORRUPTIONS ?= 5000

harden: setup
	$(TEST_ENV) $(BIN)/python -m pytest -s --kills $(KILLS) --corruptions $(CORRUPTIONS) tests/hardening

check: setup
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python benchmarks/write_results.py --check

# Before a release: no table may be older than the code it covers.
release-check: check
	$(BIN)/python benchmarks/write_results.py --release

# Writes the tables of README.md and docs/results.md from benchmarks/results.
results: setup
	$(BIN)/python benchmarks/write_results.py

# The figures of README, in two minutes on two cores; fails where one has left the interval that README states.
headline: setup
	OPENBLAS_NUM_THREADS=1 $(BIN)/python benchmarks/headline.py --jobs $(WORKERS) --check

# Renews the published tables that are older than the code, in at most four hours; goes on where it stood. ONLY="a b"
# names some tables, DATA is the folder of recordings, DRY=1 only lists what is to be done, with minutes.
results-all: setup
	$(BIN)/python benchmarks/renew_results.py --jobs $(WORKERS) $(if $(DATA),--data $(DATA)) $(if $(DRY),--dry-run) \
	  $(if $(ONLY),--only $(ONLY))

# Under three hours on two cores; an interrupted run goes on where it stood.
bench: setup
	OPENBLAS_NUM_THREADS=1 $(BIN)/magmatch evaluate --jobs $(WORKERS) --out evaluation-output

docs: setup
	$(BIN)/python -m pytest --doctest-modules -p no:cacheprovider src/magmatch \
	  packages/magmatch-serve/src packages/magmatch-evaluation/src
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet --strict --clean

# Runs every command of both tutorials and writes what it prints into the pages.
tutorial: setup
	$(BIN)/python tests/run_tutorial.py

# Takes the pictures of docs/viewing.md anew; needs Chromium.
screenshots: setup
	$(BIN)/python tests/take_screenshots.py

clean:
	rm -rf $(VENV) build dist site demo-output evaluation-output headline-output results-output .mypy_cache .ruff_cache .pytest_cache .hypothesis
