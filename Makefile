# Everything sets itself up in .venv; what is needed beforehand is Python >= 3.11, make and a network.
#
#   make demo    fly, identify, compare with the paper, write out/demo/report.html
#   make sandbox what drones need to fly controllers of one's own: wasmtime and ziglang, into .venv
#   make test    every test but the long versions          make soak   the long versions
#   make check   format, lint, types, order of imports     make bench  figures against peers, in bench/results
#   make shake   every test while their processes are stopped at random: what fails is flaky (SEED=2: others)
#   make lock    pin the requirements again                make clean  remove what the above made, .venv apart
#   make tools   install gcc, g++, arm-none-eabi-gcc, qemu-system-arm, node and npm for the tests (Debian, as root) or
#                name them, and node-mavlink into .venv/node

VENV := .venv
BIN := $(VENV)/bin
# The first interpreter that is new enough; `make PYTHON=... demo` overrides it.
PYTHON ?= $(shell for p in python3 python3.13 python3.12 python3.11 python; do \
	"$$p" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo "$$p" && break; done)
# Without a system C compiler the one in the ziglang wheel is installed and used.
RUN_REQUIREMENTS := requirements/$(if $(shell command -v cc 2>/dev/null),run,compiler).txt
# One more than the two cores of continuous integration: some tests wait for real time to pass, and others fill it.
TEST_JOBS ?= 3
# A worker that has nothing left takes from the other: the long tests stand side by side in the order of files.
PYTEST := $(BIN)/python -m pytest -n $(TEST_JOBS) --dist worksteal

.DEFAULT_GOAL := help
.PHONY: help demo sandbox test shake check bench soak tools lock clean
.DELETE_ON_ERROR:

help:
	@sed -n '/^#   /s/^#   //p' Makefile

demo: $(VENV)/ready-run
	$(BIN)/twodof demo

sandbox: $(VENV)/ready-sandbox

test: $(VENV)/ready-dev tools
	$(PYTEST)

check: $(VENV)/ready-dev
	$(BIN)/ruff format --check --quiet .
	$(BIN)/ruff check --quiet .
	$(BIN)/mypy
	$(BIN)/python -m pytest -q tests/test_layers.py

bench: $(VENV)/ready-dev tools
	$(BIN)/python -m bench

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

# Hashes are required of everything that is downloaded; the package itself is built with the pinned back end.
$(VENV)/ready-run: $(RUN_REQUIREMENTS) pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r $(RUN_REQUIREMENTS)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	@touch $@

$(VENV)/ready-sandbox: requirements/sandbox.txt $(VENV)/ready-run
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements/sandbox.txt
	@touch $@

$(VENV)/ready-dev: requirements/dev.txt pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements/dev.txt
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	@touch $@ $(VENV)/ready-run $(VENV)/ready-sandbox

# `dev` first: the three smaller files take their versions from it. No option names an index, so that the files
# hold for any. `UPGRADE=--upgrade` takes the newest of everything, otherwise what is pinned stays.
LOCK := CUSTOM_COMPILE_COMMAND="make lock" $(BIN)/pip-compile --quiet --generate-hashes --allow-unsafe \
	--strip-extras --no-annotate --no-emit-index-url --no-emit-find-links --no-emit-trusted-host \
	--build-deps-for=editable $(UPGRADE)
lock: $(VENV)/ready-dev
	$(BIN)/python -m pip install --quiet --disable-pip-version-check 'pip-tools >= 7.4'
	$(LOCK) --extra dev -o requirements/dev.txt pyproject.toml
	$(LOCK) -c requirements/dev.txt -o requirements/run.txt pyproject.toml
	$(LOCK) -c requirements/dev.txt --extra compiler -o requirements/compiler.txt pyproject.toml
	$(LOCK) -c requirements/dev.txt --extra wasm -o requirements/sandbox.txt pyproject.toml

clean:
	rm -rf out dist build .hypothesis .mypy_cache .pytest_cache .ruff_cache
	find src tests bench examples -name __pycache__ -type d -prune -exec rm -rf {} + 2>/dev/null || true
