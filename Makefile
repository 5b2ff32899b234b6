# What a newcomer types: `make run`, `make test`. What a developer types: see CONTRIBUTING.md.
PYTHON ?= python3
VENV   := .venv
JAEGER := .venv-jaeger
KAIJU  := .venv-kaiju
BIN    := $(VENV)/bin
STAMP  := $(VENV)/.installed
JOBS   ?= 2
DEV    := $(or $(DEVPYTHON),$(BIN)/python)
FRAMES ?= 20000000
FUZZED ?= 100000
STEPS  ?= 10000000
SEEDS  ?= 0:1000
PAIRS  ?= 0:1000
BUFFERS ?= 2.0 2.5
# Shows how far a long step is; all that it prints is in build/*.log.
PROGRESS := $(PYTHON) tools/setup/progress.py
# everything that a checkout builds stays below it, calibrations too
export FIBERLOOM_CACHE := $(CURDIR)/.cache

.PHONY: help setup run test jaeger test-jaeger check sanitized races bench campaign campaign-faults campaign-planning identification kaiju
.PHONY: reproduce firmware-report wheels docs tutorial lint audit format inplace stubs lock clean figures coverage mutate

help:
	@echo "make run      set up, calibrate arms, fibres and sag of 500 positioners of the twin (kept), observe a field;"
	@echo "              TIMINGS=--timings tells wall and processor seconds by stage"
	@echo "make test     set up, then run the tests"
	@echo "make check    firmware and core under sanitizers, fuzzed frames, 100 000 damaged files for the readers,"
	@echo "              20 000 images of any bytes, allocation guard, 10 000 legal"
	@echo "              moves without a false collision or a lost count, threads under"
	@echo "              the thread sanitizer, linters"
	@echo "make test-jaeger  the real jaeger (SDSS-V) drives the twin; sets it up in .venv-jaeger"
	@echo "make kaiju    the planner of SDSS-V, in .venv-kaiju: what \`make bench\` compares ours with"
	@echo "make bench    what is fast, measured; JSON into build/bench/"
	@echo "make campaign the long studies: lifetimes; resumes where it was interrupted; JSON into runs/"
	@echo "make campaign-faults  a thousand fields with random faults: what is told, missed, made worse; resumes;"
	@echo "              SEEDS=0:100 for some; exit code 3: too few seeds to judge every goal"
	@echo "make campaign-planning  a thousand pairs A to B at each buffer: who does not arrive, motion, CPU, points, and"
	@echo "              the verifier against an independent one; resumes; PAIRS=0:20 for some, ARRAY=DIR for another"
	@echo "              array; exit code 3: too few pairs"
	@echo "make reproduce  the paper's figures on the twin, ours beside theirs, into runs/reproduce/"
	@echo "make firmware-report  flash, RAM, stack, instructions per tick on a Cortex-M4F, against the aims"
	@echo "make identification  fifty units identified in full, against what they are"
	@echo "make figures  the tree in figures: sizes, documentation, tests, coverage, duplicates"
	@echo "make coverage line and branch coverage of Python, C and C++, for \`make figures\`"
	@echo "make mutate   small changes of the code that no test notices"
	@echo "make docs     the documentation as a site, into site/"
	@echo "make tutorial what the tutorial's commands answer, written into its page anew"
	@echo "make wheels   a wheel by each Python that is promised and here, installed and tried"
	@echo "make setup    .venv/bin/fiberloom"
	@echo "make lock     constraints.txt anew, with hashes (needs uv)"
	@echo "make inplace  rebuild the C and C++ into src/ without reinstalling"
	@echo "make stubs    types of the compiled module anew, after a change of core/bindings"

setup: $(STAMP)

# Built anew when the sources that are compiled change; Python is used in place.
NATIVE := CMakeLists.txt pyproject.toml constraints.txt \
          $(shell find firmware core -path firmware/boards -prune -o -type f -print 2>/dev/null)

# The lock names every package, so pip resolves nothing: with hashes, pip of Python 3.11 refuses `coverage[toml]` as soon
# as there is a newer coverage than the lock's. `pip check` says what the lock lacks.
$(VENV)/.dependencies: constraints.txt
	@echo "1 of 7: an environment in $(VENV)"
	@$(PYTHON) -m venv $(VENV)
	@$(PROGRESS) "2 of 7: Python packages" build/packages.log --of $(shell grep -c '^[a-z]' constraints.txt) -- \
	    $(BIN)/pip install --no-deps -r constraints.txt
	@$(BIN)/pip check
	@touch $@

$(STAMP): $(VENV)/.dependencies $(NATIVE)
	@$(PROGRESS) "3 of 7: firmware, core and bindings" build/setup.log -- \
	    $(BIN)/pip install --verbose --no-build-isolation --no-deps --editable .
	@touch $@

# As at an observatory: first where arms and fibres are, and how arms sag, once; then every field by that.
ARMS   := runs/focal-plane/arms.ecsv
FIBRES := runs/fibres/fibres.ecsv
SAG    := runs/gravity/gravity.ecsv
TWIN   := --seed 0 --errors all --camera image
# Where the telescope points at the images of the fibres, and how its rotator turns from then on, deg.
POINTING := --zenith 45 --rotator 0 --turn 90 --swing 10

run: setup $(FIBRES) $(SAG)
	@echo "7 of 7: a field of 500 positioners, 45 deg from the zenith; the rotator turns by 90 deg until the exposure"
	$(BIN)/fiberloom observe examples/targets_sdssv.csv $(TWIN) $(POINTING) --arms $(ARMS) --fibres $(FIBRES) \
	    --gravity $(SAG) --moves 3 --compare-linear $(TIMINGS) --out runs/first

$(ARMS): $(STAMP)
	@echo "4 of 7: where arms and fiducials are, 500 positioners; the first time transmissions are calibrated too"
	$(BIN)/fiberloom calibrate focal-plane $(TWIN) --configurations 12 --rotator 360 $(TIMINGS) --out $(@D)

$(FIBRES): $(ARMS)
	@echo "5 of 7: where their science fibres are, by three fields of stars for each kind of fibre"
	$(BIN)/fiberloom calibrate fibres $(TWIN) --arms $(ARMS) $(TIMINGS) --out $(@D)

$(SAG): $(ARMS)
	@echo "6 of 7: how arms sag, by images at six rotator angles in each of six configurations"
	$(BIN)/fiberloom calibrate gravity $(TWIN) --arms $(ARMS) $(TIMINGS) --out $(@D)

# A file to a worker: what its tests share is prepared once. At the end: what was left out, and what to install.
test: setup
	$(BIN)/pytest -rfEs -n $(JOBS) --dist loadfile --no-loadscope-reorder -m "not long"

# The real jaeger of SDSS-V, in an environment of its own; tests drive the twin with it where it is.
jaeger: $(JAEGER)/.installed

$(JAEGER)/.installed: tests/real_jaeger/requirements.txt
	$(PYTHON) -m venv $(JAEGER)
	$(JAEGER)/bin/pip install --quiet -r tests/real_jaeger/requirements.txt
	$(JAEGER)/bin/pip install --quiet --no-deps --ignore-requires-python jaeger==1.11.1
	@touch $@

test-jaeger: setup jaeger
	$(BIN)/pytest -m jaeger

# The planner of SDSS-V, in an environment of its own: it wants numpy 1. Where it cannot be built, the
# benchmark says why and goes on alone.
kaiju: $(KAIJU)/.installed

$(KAIJU)/.installed: benchmarks/planning/requirements-kaiju.txt benchmarks/planning/peer_build.py
	$(PYTHON) -m venv $(KAIJU)
	$(KAIJU)/bin/pip install --quiet -r benchmarks/planning/requirements-kaiju.txt
	$(KAIJU)/bin/python benchmarks/planning/peer_build.py
	@touch $@

# The dispatcher under address and undefined-behaviour sanitizers, and without a heap to allocate from.
check: lint
	cmake -S . -B build/checks -G Ninja -DFIBERLOOM_PYTHON=OFF -DFIBERLOOM_CHECKS=ON
	cmake --build build/checks
	cd build/checks && ctest --output-on-failure
	build/checks/firmware/tests/check_dispatch $(FRAMES) 1
	build/checks/firmware/tests/check_sequences $(STEPS) 1
	$(BIN)/python tests/fuzz/readers.py --files $(FUZZED)
	$(BIN)/python tests/fuzz/images.py --images 20000
	FIBERLOOM_DRIFT_MOVES=10000 $(BIN)/pytest tests/firmware/test_fw_drift.py
	$(BIN)/python benchmarks/collision.py legal --units 500 --moves 20
	$(MAKE) sanitized
	$(MAKE) races

# A build of the core with a sanitizer, and a copy of the package with it: $(call SPECIAL_BUILD,FOLDER,OPTION)
define SPECIAL_BUILD
cmake -S . -B build/$(1) -G Ninja -D$(2)=ON -DPython_EXECUTABLE=$(abspath $(DEV))
cmake --build build/$(1)
rm -rf build/$(1)/site && mkdir -p build/$(1)/site
cp -r src/fiberloom build/$(1)/site && rm -f build/$(1)/site/fiberloom/_core*.so
cp build/$(1)/core/bindings/_core*.so build/$(1)/site/fiberloom
endef
PRELOAD = $$(gcc -print-file-name=lib$(1).so)

# The core under sanitizers, driven by those Python tests that reach most of it in some minutes.
SANITIZED := tests/firmware tests/geometry tests/twin/test_twin.py tests/twin/test_neighbours.py \
             tests/twin/faults/test_faults.py tests/twin/test_laws_side_by_side.py tests/planning/test_verifier.py \
             tests/planning/points tests/planning/test_in_hand.py tests/planning/test_step_of_the_search.py \
             tests/planning/test_untangle.py tests/metrology/test_centroids.py tests/metrology/images/test_images.py \
             tests/fuzz/test_fuzz_images.py
sanitized: setup
	$(call SPECIAL_BUILD,sanitized,FIBERLOOM_SANITIZE)
	ASAN_OPTIONS=detect_leaks=0 LD_PRELOAD=$(call PRELOAD,asan):$(call PRELOAD,ubsan):$(call PRELOAD,stdc++) \
	    $(DEV) tests/sanitized.py $(abspath build/sanitized/site) $(SANITIZED)

# What runs in threads, under the thread sanitizer. setarch: addresses where the sanitizer expects them.
RACED := tests/twin/server/test_threads.py tests/twin/server/test_cannet_device.py tests/twin/test_twin.py \
         tests/metrology/images/test_images.py
races: setup
	$(call SPECIAL_BUILD,races,FIBERLOOM_RACES)
	FIBERLOOM_THREAD_ROUNDS=2000 TSAN_OPTIONS=halt_on_error=1:exitcode=66 LD_PRELOAD=$(call PRELOAD,tsan):$(call PRELOAD,stdc++) \
	    setarch -R $(DEV) tests/sanitized.py $(abspath build/races/site) $(RACED) -m "not slow and not long"

bench: setup
	mkdir -p build/bench
	$(BIN)/python benchmarks/startup.py --out build/bench/startup.json
	$(BIN)/python benchmarks/twin.py --out build/bench/twin.json
	$(BIN)/python benchmarks/twin_server.py --out build/bench/twin_server.json
	$(BIN)/python benchmarks/campaigns/workers.py --out build/bench/workers.json
	-$(MAKE) kaiju
	$(BIN)/python -m benchmarks.planning --buffer 2.0 2.5 --out build/bench/planning.json || test $$? = 3
	$(BIN)/python benchmarks/collision.py meet --out build/bench/collision.json
	$(BIN)/python benchmarks/focal_plane.py --out build/bench/focal_plane.json
	$(BIN)/python benchmarks/metrology.py --out build/bench/metrology.json
	$(BIN)/python benchmarks/statistical.py --out build/bench/statistical.json
	$(BIN)/python -m benchmarks.sky --out build/bench/sky.json
	$(BIN)/python -m benchmarks.sky.survey --out build/bench/survey.json

# A hundred cycles as in the paper, and what a hundred other units would have shown.
campaign: setup
	$(BIN)/fiberloom lifetime --cycles 100 --positioners 2 --seed 0 --out runs/lifetime
	$(BIN)/fiberloom lifetime --cycles 100 --every 11 --positioners 100 --seed 0 --workers $(JOBS) \
	    --out runs/lifetime-100

# Hang, crash, gross false good, contact with anything known: none; what is missed and flagged for nothing.
campaign-faults: setup
	$(BIN)/python -m benchmarks.faults --seeds $(SEEDS) --workers $(JOBS) --out runs/faults

# Who does not arrive, motion over its bound, CPU time, points; the verifier against an independent one.
campaign-planning: setup
	$(BIN)/python -m benchmarks.planning.campaign --pairs $(PAIRS) --buffer $(BUFFERS) --workers $(JOBS) \
	    $(if $(ARRAY),--array "$(ARRAY)") --out runs/planning

# FIGURES="16 19" for some; REPRODUCE="--full" for the paper's own sizes.
reproduce: setup
	$(BIN)/fiberloom reproduce $(FIGURES) $(REPRODUCE) --out runs/reproduce

# Built with gcc-arm-none-eabi, counted under QEMU; installs them where it may.
firmware-report: setup
	@PYTHONPATH=rig $(BIN)/python -m lab.report --out build
# Fifty random units of the twin, identified in full, against what they are.
identification: setup
	$(BIN)/python tests/calibration/recovery.py 50 0 full

# With the report of the last `make reproduce`, where there is one.
docs: setup
	$(BIN)/mkdocs build --quiet --strict
	@[ -f runs/reproduce/report.html ] || echo "docs: no report of the reproduction inside; \`make reproduce\` makes one"

# A wheel by each Python of pyproject.toml that is here, each tried where nothing else is; into build/wheels.
# PYTHONS="/opt/python3.13/bin/python" for others.
wheels:
	$(PYTHON) tools/setup/wheels.py build/wheels $(PYTHONS)

# What the commands of the tutorial answer today, into its page.
tutorial: setup
	$(BIN)/python -m tools.pages.transcript docs/start/tutorial.md

# JSON="--json build/figures.json" writes them, JSON="--list" prints every list in full.
figures: setup
	@$(DEV) -m tools.figures $(JSON)

coverage: setup
	$(DEV) -m tools.coverage_run --jobs $(JOBS)

# MUTANTS="--only laws --sample 0" for some, or all, of them.
mutate: setup
	$(DEV) -m tools.mutate $(MUTANTS)

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	@$(BIN)/clang-format --dry-run --Werror $(shell git ls-files '*.c' '*.h' '*.cpp' '*.hpp')

format: setup
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .
	$(BIN)/clang-format -i $(shell git ls-files '*.c' '*.h' '*.cpp' '*.hpp')

# What pyproject.toml asks for, as new as constraints.txt has it; UPGRADE="--upgrade" or "-P NAME" for newer. Needs uv.
lock:
	@head -2 constraints.txt > build/constraints.head
	uv pip compile pyproject.toml --extra dev --extra cameras --extra survey --extra serve --extra opcua \
	    --extra epics --extra postgres --python-version 3.11 \
	    --generate-hashes --no-header --no-annotate $(UPGRADE) --output-file constraints.txt
	@cat build/constraints.head constraints.txt > build/constraints.new && mv build/constraints.new constraints.txt

# Known vulnerabilities of what constraints.txt pins. Needs pip-audit and the network; nothing is asked at run time.
# Strict: a package that could not be asked about is a failure, not a good end.
audit:
	@command -v pip-audit > /dev/null || { echo "audit: pip-audit is not installed (pip install pip-audit); nothing was checked"; exit 1; }
	@pip-audit --strict --disable-pip --require-hashes -r constraints.txt || \
	    { echo "audit: something was found, or the advisories could not be asked; see above"; exit 1; }

inplace:
	cmake -S . -B build/inplace -G Ninja -DFIBERLOOM_INPLACE=ON \
	      -DPython_EXECUTABLE=$(abspath $(DEV))
	cmake --build build/inplace

# Types of the compiled module for type checkers, from the module itself; tests/bindings compares them.
stubs: inplace
	PYTHONPATH=src $(DEV) -m nanobind.stubgen --quiet --recursive \
	    --module fiberloom._core --pattern-file core/bindings/stubs.txt --output-dir src/fiberloom

clean:
	rm -rf build .venv .venv-jaeger .venv-kaiju .cache site
