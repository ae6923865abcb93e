# Each target sets up what it needs in a private .venv; only Python 3.11+, make and a C library are assumed;
# a C compiler makes the models faster.
PYTHON ?= python3
BIN := .venv/bin
BENCH ?=
.DEFAULT_GOAL := help
.PHONY: help demo test test-slow bench lint docs clean

help:
	@echo "make demo   install, run both detectors on a looming disk, plot the comparison"
	@echo "make test   run the tests"
	@echo "make lint   ruff and mypy --strict"
	@echo "make docs   regenerate the generated pages of docs/"

.venv/.ready: pyproject.toml hatch_build.py $(wildcard oppload_cli/native/*.[ch])
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[test,lint]'
	$(BIN)/python -m compileall -q oppload_cli stimuli
	@touch $@

demo: .venv/.ready
	$(BIN)/oppload demo --output demo --if-exists overwrite

test: .venv/.ready
	$(BIN)/python -m pytest --numprocesses 2

bench: .venv/.ready
	$(BIN)/python -m pip install --quiet --disable-pip-version-check "scenedetect>=0.6"
	$(BIN)/python -m benchmarks.bench $(BENCH)

test-slow: .venv/.ready
	$(BIN)/python -m pytest --numprocesses 2 -m slow

lint: .venv/.ready
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

docs: .venv/.ready
	$(BIN)/python docs/generate.py

clean:
	rm -rf .venv demo .pytest_cache .mypy_cache .ruff_cache
