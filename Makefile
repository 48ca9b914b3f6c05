# `make help` lists the targets of every day; tests/assurance/targets.mk has the long tests, which CONTRIBUTING.md names.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# CONSTRAINTS=.ci/constraints.txt installs the releases that CI tests with; otherwise the newest.
# Twice quiet: setuptools warns at length of every editable installation.
PIP = $(BIN)/python -m pip install --quiet --quiet --disable-pip-version-check $(if $(CONSTRAINTS),--constraint $(CONSTRAINTS))

# Each worker of pytest-xdist would otherwise rewrite the asserts of every test file in each run: 12 seconds.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help demo test test-all lint types schemas docs site dist deb constraints clean

help: ## this list
	@awk -F ':.*## ' '/^[a-z-]+:.* ## / {printf "make %-12s %s\n", $$1, $$2}' Makefile

include tests/assurance/targets.mk

# Debian keeps the venv of its Python in a package of its own; .ci/venv sees to that. Older pips know no groups.
$(VENV)/made:
	@echo "setting up $(VENV)"
	@$(PYTHON) -m venv $(VENV) >/dev/null 2>&1 || sh .ci/venv $(PYTHON) $(VENV)
	@$(PIP) 'pip>=25.1'
	@touch $@

$(BIN)/rorg: pyproject.toml | $(VENV)/made
	@$(PIP) --editable .
	@touch $@

$(VENV)/test-installed: $(BIN)/rorg
	@$(PIP) --editable . --group dev
	@touch $@ $(VENV)/lint-installed $(VENV)/types-installed

# Ruff and mypy alone, which is quicker than all that tests need.
$(VENV)/lint-installed: pyproject.toml | $(VENV)/made
	@$(PIP) --group lint
	@touch $@

# What mypy looks into: rorg's dependencies, and those of its plots.
$(VENV)/types-installed: $(VENV)/lint-installed $(BIN)/rorg
	@$(PIP) --editable '.[plots]'
	@touch $@

$(VENV)/dist-installed: pyproject.toml | $(VENV)/made
	@$(PIP) --group dist
	@touch $@

# Which of these has the tools that a target needs: the venv of the tests has all of them.
installed = $(if $(wildcard $(VENV)/test-installed),$(VENV)/test-installed,$(VENV)/$(1)-installed)

demo: $(BIN)/rorg ## the tour-guide robot of 41 stand-in services, in under two minutes
	@$(BIN)/rorg demo $(ARGS)

# A file is one worker's, since its tests share what is slow to set up. A worker that crashes ends the run: a new one
# would meet the same test. Failures and errors are listed at the end, and skipped tests with their reasons.
PARALLEL := --dist loadfile --max-worker-restart 0 -rfEs

# Two workers for each core, because most tests that are slow wait; WORKERS=2 for fewer. The seed is fixed, so that
# everyone's run is the same; RORG_TEST_SEED=2 for other random examples. The tests begin hundreds of processes, in some
# of which the environment forbids to keep what was compiled.
test: $(VENV)/test-installed ## lint, types, and the quick tests: 5 minutes, no Docker needed; ARGS=tests/unit for some
	@$(BIN)/python -m compileall -q rorg clients/python
	RORG_TEST_SEED=$(or $(RORG_TEST_SEED),1) $(BIN)/pytest $(or $(ARGS),-n $(or $(WORKERS),$$((2 * $$(nproc)))) $(PARALLEL) --no-loadscope-reorder -m "smoke or not (slow or docker)")

# More workers than cores, because most tests that are slow wait. Random examples are new in each run; the last lines
# name their seed. Without a Docker engine, the tests that need one are skipped.
test-all: $(VENV)/test-installed ## all tests, with those of Docker and ROS 2, as root; ARGS selects some of them
	@$(BIN)/python -m compileall -q rorg clients/python
	$(BIN)/pytest -n $(or $(WORKERS),4) $(PARALLEL) --folders $(ARGS)

lint: $(call installed,lint) ## ruff: mistakes, names, form
	$(BIN)/ruff check .
	$(BIN)/ruff check --preview --select RUF027 rorg clients
	$(BIN)/ruff format --check .

types: $(call installed,types) ## mypy --strict
	$(BIN)/mypy

schemas: $(BIN)/rorg ## JSON Schemas and OpenAPI, generated from the models
	$(BIN)/python -m rorg.manifest.schema schemas
	$(BIN)/python -m rorg.api.app schemas/openapi.json
	$(BIN)/python -m rorg.api.records schemas/journal.proto

docs: $(BIN)/rorg ## the reference, generated from the code
	$(BIN)/python docs/reference/generate.py
	$(BIN)/python docs/explanation/import_graph.py

site: $(VENV)/test-installed ## the documentation as a site with search
	$(BIN)/python docs/build_site.py $(VENV)/site
	@echo "open $(VENV)/site/index.html"

dist: $(VENV)/dist-installed ## dist/: a wheel and a source distribution, checked
	rm -rf build dist/rorg-*.whl dist/rorg-*.tar.gz
	$(BIN)/python -m build --outdir dist .
	$(BIN)/twine check --strict dist/rorg-*.whl dist/rorg-*.tar.gz
	$(BIN)/check-wheel-contents dist/rorg-*.whl

deb: $(BIN)/rorg ## dist/rorg_*.deb for Debian bookworm; ARCH=arm64 or amd64 for another machine
	$(BIN)/python images/rorg/deb/build.py $(if $(ARCH),--architecture $(ARCH))

constraints: ## the releases that the image and CI install
	$(PYTHON) .ci/constraints

clean: ## removes the venv
	rm -rf $(VENV)
