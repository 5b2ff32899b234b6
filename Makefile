# What a newcomer types: `make run`, `make test`. What a developer types: see CONTRIBUTING.md.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
STAMP  := $(VENV)/.installed
JOBS   ?= 2
FRAMES ?= 20000000

.PHONY: help setup run test check bench reproduce docs lint format inplace clean

help:
	@echo "make run      set up, then observe a field of 500 positioners on the twin"
	@echo "make test     set up, then run the tests"
	@echo "make check    firmware and core under sanitizers, fuzzed frames, allocation guard, linters"
	@echo "make bench    what is fast, measured; JSON into build/bench/"
	@echo "make reproduce  the paper's figures on the twin, ours beside theirs, into runs/reproduce/"
	@echo "make docs     the documentation as a site, into site/"
	@echo "make setup    .venv/bin/fiberloom"
	@echo "make inplace  rebuild the C and C++ into src/ without reinstalling"

setup: $(STAMP)

# Built anew when the sources that are compiled change; Python is used in place.
NATIVE := CMakeLists.txt pyproject.toml constraints.txt $(shell find firmware core -type f 2>/dev/null)

$(VENV)/.dependencies: constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet -r constraints.txt
	@touch $@

$(STAMP): $(VENV)/.dependencies $(NATIVE)
	$(BIN)/pip install --quiet --no-build-isolation --no-deps --editable .
	@touch $@

run: setup
	$(BIN)/fiberloom observe examples/targets_sdssv.csv --seed 0 --compare-linear --out runs/first

test: setup
	$(BIN)/pytest -n $(JOBS)

# The dispatcher under address and undefined-behaviour sanitizers, and without a heap to allocate from.
check: lint
	cmake -S . -B build/checks -G Ninja -DFIBERLOOM_PYTHON=OFF -DFIBERLOOM_CHECKS=ON
	cmake --build build/checks
	cd build/checks && ctest --output-on-failure
	build/checks/firmware/tests/check_dispatch $(FRAMES) 1

bench: setup
	mkdir -p build/bench
	$(BIN)/python benchmarks/twin.py --out build/bench/twin.json
	$(BIN)/python benchmarks/planning.py --out build/bench/planning.json

# FIGURES="16 19" for some; REPRODUCE="--full" for the paper's own sizes.
reproduce: setup
	$(BIN)/fiberloom reproduce $(FIGURES) $(REPRODUCE) --out runs/reproduce

# With the report of the last `make reproduce`, where there is one.
docs: setup
	$(BIN)/mkdocs build --quiet --strict
	@if [ -f runs/reproduce/report.html ]; then cp runs/reproduce/report.html site/reproduction/report.html; \
	else echo "docs: no report of the reproduction inside; \`make reproduce\` makes one"; fi

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/clang-format --dry-run --Werror $(shell git ls-files '*.c' '*.h' '*.cpp' '*.hpp')

format: setup
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .
	$(BIN)/clang-format -i $(shell git ls-files '*.c' '*.h' '*.cpp' '*.hpp')

inplace:
	cmake -S . -B build/inplace -G Ninja -DFIBERLOOM_INPLACE=ON \
	      -DPython_EXECUTABLE=$(abspath $(or $(DEVPYTHON),$(BIN)/python))
	cmake --build build/inplace

clean:
	rm -rf build .venv .cache site
