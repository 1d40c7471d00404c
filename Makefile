# make sample: set up the program and run the main job on sample_logs/
# make test:   set up the tests too and pass them
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile
# Exactly what was tested: files with hashes, which `make lock` writes.
LOCKS := .locks
LOCKED := $(PIP) --require-hashes --requirement
PROGRAM := $(VENV)/.program
EVERYTHING := $(VENV)/.everything

# The tests of rooms that open no files, without what is slow or needs more than Python.
QUICK_TESTS := tests/atmosphere tests/refraction tests/flight tests/block tests/physics tests/base
QUICK := -m "not slow and not browser and not emulator and not shared" $(QUICK_TESTS)

.PHONY: sample test quick lint docs bench faults planted lock lowest latest clean

$(PROGRAM): pyproject.toml $(LOCKS)/build.txt $(LOCKS)/main.txt
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "unbend needs Python 3.11 or newer: make PYTHON=python3.11 ...")'
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(LOCKED) $(LOCKS)/build.txt --requirement $(LOCKS)/main.txt
	$(PIP) --no-deps --no-build-isolation --editable .
	touch $@

$(EVERYTHING): $(PROGRAM) $(LOCKS)/test.txt
	$(LOCKED) $(LOCKS)/test.txt
	touch $@

sample: $(PROGRAM)
	$(BIN)/unbend run configs/sample_bin.yaml configs/sample_tlog.yaml configs/sample_mcap.yaml

# Ten minutes on two cores: of the costliest tests (DRAWN in tests/conftest.py) a tenth, others each
# day. CASES=all runs all of them, half an hour.
CASES ?= drawn
test: $(EVERYTHING)
	$(BIN)/lint-imports
	UNBEND_CASES=$(CASES) OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 --dist worksteal

# Lint and the tests of all pure rooms but the slow ones: a minute on two cores, once
# kernels are compiled and mypy has its cache.
quick: lint
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -q -n 2 --dist worksteal $(QUICK)

lint: $(EVERYTHING)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# The newest release of every dependency, for all systems and Pythons. Other files stay within test.txt.
COMPILE = $(BIN)/uv pip compile --quiet --upgrade --universal --python-version 3.11 --generate-hashes --custom-compile-command 'make lock'
WITHIN = $(COMPILE) --constraint $(LOCKS)/test.txt
lock: $(EVERYTHING)
	$(COMPILE) pyproject.toml --extra test --output-file $(LOCKS)/test.txt
	$(WITHIN) pyproject.toml --output-file $(LOCKS)/main.txt
	$(WITHIN) pyproject.toml --extra rasters --extra nwp --extra dask --extra cloud --output-file $(LOCKS)/cluster.txt
	$(WITHIN) $(LOCKS)/build.in --output-file $(LOCKS)/build.txt

# The bounds of pyproject.toml: the lowest releases they allow, and the newest without a lock.
lowest latest: $(EVERYTHING)
	$(BIN)/python tests/contract/bounds.py --python $(PYTHON) $@ $(QUICK)

# The documentation as a site: open docs/site/index.html.
docs: $(EVERYTHING)
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --config-file docs/mkdocs.yml

# 100,000 mutated logs of each format, half an hour; `make test` does 500. 4,000 logs of each format
# with values at their limits; `make test` does 20. 400 of each kind of other input (tables, tags,
# weather, blocks, grids, mission files) with fields at their limits; `make test` does 2. 1,000
# flights drawn for the assignment of events to images; `make test` does 200. 208 faults drawn into
# two flights; `make test` does 104. All mistakes of survey engineers; `make test` does 6. All cases
# of what tie points find in simulated blocks; `make test` does some. Every cell of the large logs;
# `make test` reads their first megabytes. 30 adjusted blocks for each flying height and all airs of
# docs/when.md; `make test` does one. 1,600 flights with thermometers that work; `make test` does
# 24. Memory of all five block exports; `make test` does two. 200 races of two writers in each
# object store, Azure's emulator among them where there is npm; `make test` does 4 in each of two.
# 20 runs on a cluster of which six workers are killed each; `make test` does one with two. 200 runs
# that a signal ends at a random time; `make test` does 4. 1,000 missions in one process; `make test`
# does 10. Six machines that must give the same bytes; `make test` does two.
AZURITE := $(abspath $(VENV))/azurite
faults: $(EVERYTHING)
	command -v npm > /dev/null && npm install --silent --no-fund --no-audit --prefix $(AZURITE) azurite || true
	UNBEND_AZURITE=$(AZURITE) UNBEND_RACES=200 UNBEND_AIR_FLIGHTS=3 UNBEND_CLUSTER_KILLS=20 UNBEND_THERMOMETERS=1600 UNBEND_WHOLE_LOGS=1 UNBEND_MUTATIONS=100000 UNBEND_SNIPPETS=all UNBEND_FLIGHTS=1000 UNBEND_MISTAKES=100 UNBEND_BLOCKS=8 UNBEND_ADJUSTMENTS=30 UNBEND_KILLS=all UNBEND_SIGNALS=200 UNBEND_SOAK=1000 UNBEND_MACHINES=all $(BIN)/python -m pytest -n 2 --dist loadfile tests/faults tests/batch/test_resume.py tests/batch/test_same_bytes.py tests/batch/test_soak.py tests/cli/test_interrupts.py tests/batch/test_dask_executor.py tests/ingest tests/flight/test_injected_faults.py tests/atmosphere/test_estimate_montecarlo.py tests/atmosphere/estimate/test_honest_thermometers.py tests/atmosphere/test_model_montecarlo.py tests/batch/object_store tests/block tests/stages/test_mistakes.py tests/golden/test_block_heights.py tests/golden/test_when.py tests/contract/test_documentation.py tests/tables/exports/test_block_memory.py

# Bugs planted one at a time: do the tests of their room notice? All, or ROOM=refraction; two hours.
# DRAWN=60 plants bugs that are drawn blindly instead of those of our lists, by SEED (today's date).
SEED ?= $(shell date +%Y%m%d)
planted: $(EVERYTHING)
	UNBEND_BLOCKS=8 $(BIN)/python tests/planted/run.py $(ROOM) $(if $(DRAWN),--drawn $(DRAWN) --seed $(SEED))

# Ratios of things timed by turns, each with its bound; a quarter of an hour on a quiet machine.
bench: $(EVERYTHING)
	OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -o addopts='' -o python_files='bench_*.py' -q benchmarks

clean:
	rm -rf $(VENV) $(VENV)-* results docs/site
