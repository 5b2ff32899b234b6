# What a newcomer types: `make run`, `make test`. What a developer types: see CONTRIBUTING.md.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
STAMP  := $(VENV)/.installed
JOBS   ?= 2

.PHONY: help setup run test check bench docs lint format inplace clean

help:
	@echo "make run      set up, then observe a field of 500 positioners on the twin"
	@echo "make test     set up, then run the tests"
	@echo "make check    sanitizers on firmware and core, static checks"
	@echo "make bench    what is fast, measured"
	@echo "make setup    .venv/bin/fiberloom"
	@echo "make inplace  rebuild the C++ into src/ without reinstalling"

setup: $(STAMP)

# Rebuilt when the sources that are compiled change; Python is used in place.
NATIVE := CMakeLists.txt pyproject.toml constraints.txt $(shell find firmware core -type f 2>/dev/null)

$(VENV)/.dependencies: constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --upgrade pip -c constraints.txt
	$(BIN)/pip install --quiet -r constraints.txt
	@touch $@

$(STAMP): $(VENV)/.dependencies $(NATIVE)
	$(BIN)/pip install --quiet --no-build-isolation --no-deps --editable .
	@touch $@

run: setup
	$(BIN)/fiberloom observe examples/targets_sdssv.csv --seed 0 --out runs/first

test: setup
	$(BIN)/pytest -n $(JOBS)

inplace:
	cmake -S . -B build/inplace -G Ninja -DFIBERLOOM_INPLACE=ON -DPython_EXECUTABLE=$(abspath $(or $(DEVPYTHON),$(BIN)/python))
	cmake --build build/inplace

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

format: setup
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .
	$(BIN)/clang-format -i $(shell git ls-files '*.c' '*.h' '*.cpp' '*.hpp')

clean:
	rm -rf build .venv .cache
