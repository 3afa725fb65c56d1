# Needs Python 3.11 or newer, make and git; everything else goes into .venv. `make help` lists the targets.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PYTEST := MPLBACKEND=Agg $(BIN)/python -m pytest
# Three workers on two cores: a fifth of the tests' time is waiting, for a daemon's second or for a process to start.
WORKERS := -n 3 --dist worksteal

# Many containers set it. Every process that a test starts would then compile all that it imports: seconds each.
unexport PYTHONDONTWRITEBYTECODE

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: help demo test test-long quick check bench bench-real stress campaign campaign-integrity soak site install kernels lock clean

help:  ## this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / { printf "make %-19s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

demo: install  ## the main job: a simulated flight, GPS cut off; says where the report is
	$(BIN)/landfix demo

# Types are checked beside the first tests: 100 s, and no test of the first minutes is one of real time.
test: install  ## check and all tests but the long ones; the exit code tells of both
	@mkdir -p out; { $(MAKE) --no-print-directory check >out/check.log 2>&1 || { cat out/check.log; exit 1; }; } & checks=$$!; \
	status=0; $(PYTEST) $(WORKERS) || status=$$?; \
	wait $$checks || { echo "make check failed: out/check.log"; status=1; }; exit $$status

test-long: install  ## the tests that make test leaves out: campaigns in small, many cases of one kind, whole flights (half an hour)
	$(PYTEST) $(WORKERS) -m long

# The golden trajectory, the models, the sensors, the wire and the rules of the repository: 70 s of the processor.
quick: install  ## the tests of a minute: golden bits, models, sensors, messages, rules of the repository
	$(PYTEST) -q -n 2 tests/golden tests/models tests/estimator/sources tests/logs/wire tests/docs/test_architecture.py tests/docs/test_site.py

check: install  ## ruff, mypy --strict, import contracts
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

bench: install  ## what a message costs, by rate of fixes, GNSS and IMUs; of two versions in turns: see benchmarks/speed/cost.py
	$(BIN)/python -m benchmarks.speed.cost

bench-real: install  ## accuracy on the recorded flights of LANDFIX_DATA, beside the peers' figures
	$(BIN)/python -m benchmarks.flights.real

stress: install  ## accuracy and consistency where the world differs from the configuration, beside the plain filter (minutes)
	$(BIN)/python -m benchmarks.stress --quick

campaign: install  ## consistency over many simulated flights (minutes)
	$(BIN)/python -m benchmarks.campaign

campaign-integrity: install  ## protection levels against true errors, goes on where it ended (JOBS=2, SEEDS=3, SCHEDULER=tcp://...)
	$(BIN)/python -m benchmarks.integrity --jobs $(or $(JOBS),1) --seeds $(or $(SEEDS),3) --scheduler "$(SCHEDULER)"

soak: install  ## the daemon under load for an hour: latency, memory, drops, and its log replayed (MINUTES=60)
	$(BIN)/python -m benchmarks.service --minutes $(or $(MINUTES),60)

site: install $(VENV)/.site  ## the documentation as pages to browse, links checked: site/index.html
	NO_MKDOCS_2_WARNING=1 PYTHONPATH=. $(BIN)/mkdocs build

install: kernels

# Compiles the kernels where any file has changed that goes into one: numba looks at a kernel's own file only.
kernels: $(VENV)/.installed
	@$(BIN)/python -m estimator.tools.kernels

$(VENV)/.installed: pyproject.toml $(VENV)/.locked
	@.ci/install --no-deps --no-build-isolation --editable .
	@touch $@

$(VENV)/.site: requirements-site.lock | $(VENV)/.installed
	@.ci/install --require-hashes -r requirements-site.lock
	@touch $@

$(VENV)/.locked: requirements.lock | $(BIN)/python
	@.ci/install --require-hashes -r requirements.lock
	@touch $@

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "landfix needs Python 3.11 or newer: make PYTHON=python3.11")'
	$(PYTHON) -m venv $(VENV)

# Versions stay as they are; `make lock UPGRADE=--upgrade` takes the newest. Every platform and every Python >= 3.11; hashes, no addresses.
lock: install  ## write the lock files anew from pyproject.toml
	UV_CUSTOM_COMPILE_COMMAND="make lock" $(BIN)/uv pip compile --quiet --universal --python-version 3.11 --generate-hashes \
		--no-emit-index-url --no-emit-find-links --extra dev $(UPGRADE) --output-file requirements.lock pyproject.toml
	UV_CUSTOM_COMPILE_COMMAND="make lock" $(BIN)/uv pip compile --quiet --universal --python-version 3.11 --generate-hashes \
		--no-emit-index-url --no-emit-find-links --extra site --constraint requirements.lock $(UPGRADE) \
		--output-file requirements-site.lock pyproject.toml
	printf "matplotlib ; python_version < '3'\nlxml ; python_version < '3'\n" | UV_CUSTOM_COMPILE_COMMAND="make lock" $(BIN)/uv pip compile --quiet --universal --python-version 3.11 \
		--generate-hashes --no-emit-index-url --no-emit-find-links --overrides - --constraint requirements.lock $(UPGRADE) \
		--output-file requirements-flight.lock pyproject.toml

clean:  ## remove .venv and what tools left behind
	rm -rf $(VENV) build dist .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
