# Each target sets up a private .venv by itself; it needs only Python 3.11 or later and make. A C
# compiler makes the models faster. On Windows, run make in a POSIX shell such as Git Bash.
# PYTHON=python3.13 names the Python; a .venv of another one is made anew.
ifeq ($(OS),Windows_NT)
PYTHON ?= python
BIN := .venv/Scripts
else
PYTHON ?= python3
BIN := .venv/bin
endif
JOBS ?= 2
CASES ?= 500
SEED ?= 1
BENCH ?=
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check
base = $(shell exec 2>/dev/null; $(1) -c "import sys; print(sys.version, sys.base_prefix)")
.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: help demo test test-failed test-long test-slow test-lowest attack bench lint style types format docs dist clean another

help:
	@echo "make demo       install, run both detectors on a looming disk, plot, make a page"
	@echo "make test       run the quick tests; JOBS=4 runs them in 4 processes (2 by default)"
	@echo "make test-failed run the tests that failed last time, one after the other"
	@echo "make test-long  run the tests that take up to a few seconds each"
	@echo "make test-slow  run the tests that take more than a few seconds each"
	@echo "make test-lowest run the tests with the lowest versions of libraries that are allowed"
	@echo "make attack     damaged and hostile input, limits, signals; CASES=5000 SEED=1 (500 and 1)"
	@echo "make lint       ruff, and mypy --strict"
	@echo "make style      only ruff"
	@echo "make types      only mypy --strict"
	@echo "make format     let ruff format the code"
	@echo "make docs       refill the generated pages, and build the site into docs/_build/html"
	@echo "make dist       build and check the source archive and a wheel for each platform"
	@echo "make bench      measure speed against references; see benchmarks/README.md"
	@echo "make clean      remove what the other targets have made; keeps benchmarks/results and compiled loops"

# Without PYTHON, a .venv keeps its Python.
ifneq ($(filter environment command,$(origin PYTHON)),)
ifneq ($(call base,$(PYTHON)),$(call base,$(BIN)/python))
.venv/pyvenv.cfg: another
endif
endif
TOO_OLD := oppload needs Python 3.11 or later; name one, as in: make demo PYTHON=python3.13
.venv/pyvenv.cfg:
	@$(PYTHON) -c "import sys; sys.exit(None if sys.version_info >= (3, 11) else '$(TOO_OLD)')"
	$(PYTHON) -m venv --clear .venv

.venv/.ready: .venv/pyvenv.cfg pyproject.toml hatch_build.py $(wildcard oppload_cli/*/*.[ch])
	$(PIP) --editable '.[test,lint]'
	$(BIN)/python -m compileall -q oppload_cli stimuli
	@touch $@

demo: .venv/.ready
	$(BIN)/oppload demo --output demo --if-exists overwrite

test: .venv/.ready
	$(BIN)/python -m pytest --numprocesses $(JOBS) -m "not long and not slow"

test-failed: .venv/.ready
	$(BIN)/python -m pytest --numprocesses 0 -m "" --last-failed --last-failed-no-failures none

test-long: .venv/.ready
	$(BIN)/python -m pytest --numprocesses $(JOBS) -m "long and not slow"

test-slow: .venv/.ready
	$(BIN)/python -m pytest --numprocesses $(JOBS) -m slow

TOO_NEW := the lowest versions need Python 3.11 or 3.12; name one: make test-lowest PYTHON=python3.12
# Later versions of Python have no NumPy 1.26.
.venv-lowest/.ready: pyproject.toml .venv/.ready
	@$(BIN)/python -c "import sys; sys.exit(None if sys.version_info < (3, 13) else '$(TOO_NEW)')"
	$(BIN)/python -m venv --clear .venv-lowest
	grep -oE '[a-z0-9-]+>=[0-9.]+' pyproject.toml | sed 's/>=/==/; s/$$/.*/' > .venv-lowest/constraints.txt
	$(subst .venv,.venv-lowest,$(PIP)) --editable '.[test]' --constraint .venv-lowest/constraints.txt
	@touch $@

test-lowest: .venv-lowest/.ready
	$(subst .venv,.venv-lowest,$(BIN))/python -m pytest --numprocesses $(JOBS)

attack: .venv/.ready
	$(BIN)/python -m tools.attack --cases $(CASES) --seed $(SEED) --jobs $(JOBS)

bench: .venv/.ready
	$(PIP) "scenedetect>=0.6"
	$(BIN)/python -m benchmarks.bench $(BENCH)

lint: style types

style: .venv/.ready
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: .venv/.ready
	$(BIN)/mypy

format: .venv/.ready
	$(BIN)/ruff format .

.venv/.docs: .venv/.ready
	$(PIP) --editable '.[docs]'
	@touch $@

docs: .venv/.docs
	$(BIN)/python docs/generate.py
	$(BIN)/python -m tools.picture
	$(BIN)/python -m sphinx --fail-on-warning --keep-going --quiet --jobs auto docs docs/_build/html

.venv/.dist: .venv/.ready
	$(PIP) --editable '.[dist]'
	@touch $@

dist: .venv/.dist
	$(BIN)/python -m tools.dist

clean:
	rm -rf .venv .venv-lowest build demo attack dist docs/_build docs/reference/api .pytest_cache .mypy_cache .ruff_cache
