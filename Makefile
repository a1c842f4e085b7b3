# Everything sets itself up in .venv; what is needed beforehand is Python >= 3.11, make and a network.
#
#   make demo    fly, identify, compare with the paper, write out/demo/report.html, in 1 to 5 minutes on two idle cores
#   make web     build the browser page of web/ into the package
#   make play    the page in out/play that flies the virtual rig in a browser, without a server
#   make wheel   dist/twodof-*.whl with the page inside: `pip install` it where there is no make, node or compiler
#   make quick   what is cheap of every room, one to two minutes: at each change
#   make test    every test that takes less than 1 s of processor time, and the page's, in minutes
#   make thorough    the others; CI runs both              make soak   the long versions of tests, for hours
#   make check   format, lint, types, order of imports     make bench  figures against peers, in bench/results
#   make docs    the documentation as a site with search, in out/docs
#   make fuzz    coverage-guided fuzzing of what reads files and packets (SECONDS=3600: of each)
#   make shake   every test while their processes are stopped at random: what fails is flaky (SEED=2: others)
#   make lock    pin the requirements again                make clean  remove what the above made, .venv apart
#   make sbom    list every pinned part, as CycloneDX, in out/sbom
#   make tools   install gcc, g++, arm-none-eabi-gcc, qemu-system-arm, node, npm, octave, curl and chromium for tests
#                (Debian, as root) or name them, and node-mavlink into .venv/node

VENV := .venv
BIN := $(VENV)/bin
# The first interpreter that is new enough; `make PYTHON=... demo` overrides it.
PYTHON ?= $(shell for p in python3 python3.13 python3.12 python3.11 python; do \
	"$$p" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo "$$p" && break; done)
# One more than the two cores of continuous integration: some tests wait for real time to pass, and others fill it.
TEST_JOBS ?= 3
# The tests start our programs more than a hundred times: without the byte code of the last start each costs twice.
unexport PYTHONDONTWRITEBYTECODE
# The matrices here are small: threads of BLAS that wait for each other cost more than they save.
export OPENBLAS_NUM_THREADS ?= 1
# A worker that has nothing left takes from the other: the long tests stand side by side in the order of files.
PYTEST := $(BIN)/python -m pytest -n $(TEST_JOBS) --dist worksteal

.DEFAULT_GOAL := help
.PHONY: help demo web play wheel quick test thorough shake check bench soak docs tools lock sbom clean fuzz
.DELETE_ON_ERROR:

help:
	@sed -n '/^#   /s/^#   //p' Makefile

# Quick and silent when nothing in web/ has changed. Its absolute path is wanted: the build goes into web/.
web: $(VENV)/ready-run
	@tools/web.sh "$(CURDIR)/$(BIN)/python" build

# The demonstration needs no page: where the npm registry is not reached, it goes on without.
demo: $(VENV)/ready-run
	@tools/web.sh "$(CURDIR)/$(BIN)/python" build || \
		echo "web: the browser page is not built, for the reason above; 'make web' tries again"
	$(BIN)/twodof demo --force

play: $(VENV)/ready-run
	@tools/web.sh "$(CURDIR)/$(BIN)/python" play
	@$(BIN)/python tools/play.py

wheel: web
	$(BIN)/python -m pip wheel --quiet --no-deps --no-build-isolation --wheel-dir dist .
	@echo "written: $$(ls -t dist/twodof-*.whl | head -n 1)"

quick: $(VENV)/ready-dev
	$(BIN)/python -m pytest -q -n 2 --dist loadfile --quick -m "not long and not soak"

test: $(VENV)/ready-dev tools web
	$(PYTEST) -m "not long and not soak"

thorough: $(VENV)/ready-dev tools
	$(PYTEST) -m "long and not soak"

check: $(VENV)/ready-dev
	$(BIN)/ruff format --check --quiet .
	$(BIN)/ruff check --quiet .
	$(BIN)/mypy
	$(BIN)/python -m pytest -q tests/test_layers.py
	@tools/web.sh "$(CURDIR)/$(BIN)/python" check

bench: $(VENV)/ready-dev tools
	$(BIN)/python -m bench

# The site carries the page Play; where the npm registry is not reached, it goes on without.
docs: $(VENV)/ready-docs
	@$(MAKE) --no-print-directory play || echo "play: not built, for the reason above; the site goes on without it"
	$(BIN)/python tools/site.py

SECONDS ?= 60
fuzz: $(VENV)/ready-dev
	$(BIN)/python -m tests.fuzz.runner all --seconds $(SECONDS)

SEED ?= 1
shake: $(VENV)/ready-dev tools
	$(BIN)/python tools/shake.py $(SEED) $(PYTEST)

soak: $(VENV)/ready-dev tools
	$(PYTEST) -m soak

# Part of test, soak and bench; quick and silent when everything is there.
tools:
	@tools/toolchains.sh
	@tools/node_packages.sh $(VENV)/node

$(BIN)/python:
	@test -n "$(PYTHON)" || { echo "twodof needs Python 3.11 or newer: none found; name one with make PYTHON=..."; exit 1; }
	@"$(PYTHON)" -c 'import ensurepip, venv' 2>/dev/null || { \
		echo "$(PYTHON) cannot make virtual environments: install its venv module (Debian: apt-get install python3-venv)"; exit 1; }
	"$(PYTHON)" -m venv $(VENV)

# Hashes are required of everything that is downloaded: of pip too, which installs the rest, and of setuptools, which
# builds a package that has no wheel for this machine. Without build isolation pip fetches nothing besides.
INSTALL := -m pip install --quiet --disable-pip-version-check --no-build-isolation
$(VENV)/ready-pip: requirements/pip.txt | $(BIN)/python
	$(BIN)/python $(INSTALL) --require-hashes -r $<
	@touch $@

$(VENV)/ready-run: requirements/run.txt pyproject.toml $(VENV)/ready-pip
	$(BIN)/python $(INSTALL) --require-hashes -r $<
	$(BIN)/python $(INSTALL) --no-deps -e .
	@touch $@

$(VENV)/ready-docs: requirements/docs.txt $(VENV)/ready-pip
	$(BIN)/python $(INSTALL) --require-hashes -r requirements/docs.txt
	@touch $@

$(VENV)/ready-dev: requirements/dev.txt pyproject.toml $(VENV)/ready-pip
	$(BIN)/python $(INSTALL) --require-hashes -r requirements/dev.txt
	$(BIN)/python $(INSTALL) --no-deps -e .
	@touch $@ $(VENV)/ready-run $(VENV)/ready-docs

# What maintains the pins has an environment of its own, so that nobody else installs it.
MAINTAIN := $(VENV)/maintain
$(MAINTAIN)/ready: requirements/maintain.txt requirements/pip.txt | $(BIN)/python
	$(BIN)/python -m venv --clear $(MAINTAIN)
	$(MAINTAIN)/bin/python $(INSTALL) --require-hashes -r requirements/pip.txt
	$(MAINTAIN)/bin/python $(INSTALL) --require-hashes -r requirements/maintain.txt
	@touch $@

# `dev` first: the others take their versions from it. No option names an index, so that the files
# hold for any. `UPGRADE=--upgrade` takes the newest of everything, otherwise what is pinned stays.
LOCK := CUSTOM_COMPILE_COMMAND="make lock" $(MAINTAIN)/bin/pip-compile --quiet --generate-hashes --allow-unsafe \
	--strip-extras --no-annotate --no-emit-index-url --no-emit-find-links --no-emit-trusted-host $(UPGRADE)
LOCK_PROJECT := $(LOCK) --build-deps-for=editable
lock: $(MAINTAIN)/ready
	$(LOCK_PROJECT) --extra dev --extra docs -o requirements/dev.txt pyproject.toml
	$(LOCK_PROJECT) -c requirements/dev.txt -o requirements/run.txt pyproject.toml
	$(LOCK_PROJECT) -c requirements/dev.txt --extra docs -o requirements/docs.txt pyproject.toml
	$(LOCK) -o requirements/node.txt requirements/node.in
	$(LOCK) -o requirements/pip.txt requirements/pip.in
	$(LOCK) -o requirements/maintain.txt requirements/maintain.in

# One document for each file of pins: name, version, purl and hashes of every part, checked against CycloneDX's schema.
sbom: $(MAINTAIN)/ready
	@mkdir -p out/sbom
	@for pins in run docs dev maintain pip; do \
		PYTHONWARNINGS=ignore $(MAINTAIN)/bin/cyclonedx-py requirements --validate --output-reproducible --short-PURLs \
			--mc-type library --pyproject pyproject.toml -o out/sbom/$$pins.cdx.json requirements/$$pins.txt && \
		[ $$(grep -c '^[^ #].*==' requirements/$$pins.txt) = $$(grep -c '"purl"' out/sbom/$$pins.cdx.json) ] && \
		echo "written: out/sbom/$$pins.cdx.json" || { echo "out/sbom/$$pins.cdx.json: incomplete"; exit 1; }; done

clean:
	rm -rf out dist build .hypothesis .mypy_cache .pytest_cache .ruff_cache
	find src tests bench examples -name __pycache__ -type d -prune -exec rm -rf {} + 2>/dev/null || true
