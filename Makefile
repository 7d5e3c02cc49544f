# make demo, make test: a virtual environment, the package in it, and the thing itself.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
ARGS ?=
# make test CPU=x86-64-v3 CORES=1: as on another machine (tests/machine), by the names of LLVM; native and all cores by default
CPU ?=
CORES ?=
# make test WORKERS=3: so many processes; as many as there are cores by default
WORKERS ?= auto
AS_MACHINE := $(if $(CPU)$(CORES),PYTHONPATH="$(CURDIR)/tests/machine" MULTIROD_TEST_CPU=$(CPU) MULTIROD_TEST_CORES=$(CORES) )

.PHONY: demo test test-all quick-tests heap lint docs bench clean

demo: $(VENV)/.installed
	$(BIN)/multirod demo $(ARGS)

# a process a core, each of which needs but its own: threads of BLAS would wait for their turn, at a tenth of all time
test test-all quick-tests: export OPENBLAS_NUM_THREADS ?= 1
PYTEST = $(BIN)/pytest --numprocesses $(WORKERS) --dist loadfile --no-loadscope-reorder

test: $(VENV)/.installed-test
	$(AS_MACHINE)$(PYTEST) --quick $(ARGS)

test-all: $(VENV)/.installed-test
	$(AS_MACHINE)$(PYTEST) $(ARGS)

# measures what each test takes, and chooses anew which ones `make test` runs: tests/left_to_test_all.txt lists the others; with
# ARGS=--quick, which of those it runs it is to leave out
quick-tests: export MULTIROD_TEST_COSTS := $(CURDIR)/build/costs
quick-tests: export PYTHONPATH := $(CURDIR)/tests/machine
quick-tests: $(VENV)/.installed-test
	rm -rf build/costs && mkdir -p build/costs
	$(PYTEST) -p costs $(ARGS)
	$(BIN)/python tests/machine/costs.py build/costs

# the tests with guards around every block of the heap: which kernel writes past its array?
heap: $(VENV)/.installed-test
	mkdir -p build
	$(CC) -O2 -fPIC -shared -o build/heap.so tests/machine/heap.c
	OMP_NUM_THREADS=1 PYTHONPATH="$(CURDIR)/tests/machine" LD_PRELOAD="$(CURDIR)/build/heap.so" $(BIN)/pytest -p heap_watch $(ARGS)

lint: $(VENV)/.installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/python tests/typing_tree.py
	$(BIN)/mypy

docs: $(VENV)/.installed-docs
	$(BIN)/sphinx-build -W --keep-going --fresh-env --quiet docs build/docs
	@echo build/docs/index.html

bench: $(VENV)/.installed
	$(BIN)/python tests/benchmarks/single_rod.py $(ARGS)
	$(BIN)/python tests/benchmarks/one_solve.py $(ARGS)
	$(BIN)/python tests/benchmarks/concentric_tubes.py $(ARGS)
	$(BIN)/python tests/benchmarks/precision.py $(ARGS)
	$(BIN)/python tests/benchmarks/parallel_rods.py $(ARGS)
	$(BIN)/python tests/benchmarks/batches.py $(ARGS)
	$(BIN)/python tests/benchmarks/sweep.py
	$(BIN)/python tests/benchmarks/stability.py $(ARGS)
	$(BIN)/python tests/benchmarks/derivatives.py
	$(BIN)/python tests/benchmarks/features.py
	$(BIN)/python tests/benchmarks/lines.py $(ARGS)
	$(BIN)/python tests/benchmarks/reach.py --quick
	$(BIN)/python tests/benchmarks/estimate.py
	$(BIN)/python tests/benchmarks/first_call.py

$(BIN)/python:
	$(PYTHON) -c "import sys; sys.exit('multirod needs Python 3.11 or later: make PYTHON=python3.11') if sys.version_info < (3, 11) else 0"
	$(PYTHON) -m venv $(VENV)

$(VENV)/.installed: pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --editable .
	touch $@

$(VENV)/.installed-%: pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --editable ".[$*]"
	touch $@

clean:
	rm -rf $(VENV) build dist *.egg-info .typing
