# `make run` sets up and runs the main job, `make test` sets up and passes the tests.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.ready
BROWSER := $(VENV)/.browser

# Use uv if it is installed, else pip.
UV := $(shell command -v uv 2>/dev/null)
PIP_INSTALL := $(if $(UV),$(UV) pip install --compile-bytecode --python $(BIN)/python,$(BIN)/python -m pip install) --quiet

PYTHONS := 3.11 3.12 3.13 3.14

.PHONY: run test test-room test-bare test-slow test-python test-lowest weekly setup check bench docs clean help

help:
	@echo "make run    set up, then measure, predict and explain the tour (report in out/tour)"
	@echo "make test   set up, then run the tests"
	@echo "make test-room ROOM=samplers  run the tests of one package, such as tests/samplers"
	@echo "make test-bare  install the wheel without extras in a new environment, then use it"
	@echo "make test-slow  set up, then run the tests that take minutes"
	@echo "make test-python  install the wheel for each of Python $(PYTHONS), then run the tour and some tests"
	@echo "make test-lowest  run the tests with the lowest versions that pyproject.toml allows"
	@echo "make weekly the last three: for CI, once a week"
	@echo "make check  lint, types, import contract, prose"
	@echo "make bench  benchmarks: ratios against a reference in the same run"
	@echo "make docs   check the documentation's examples, then build it: build/docs/index.html"
	@echo "make clean  remove everything that was built, the environment too"

setup: $(STAMP)

# Compile the bytecode, so that the first start is fast as well. QMCPy is built from its source.
$(STAMP): pyproject.toml
ifdef UV
	@$(UV) venv --quiet --allow-existing --python $(PYTHON) $(VENV)
else
	@$(PYTHON) -c 'import ensurepip' 2>/dev/null || { $(GET_ENSUREPIP); }
	@$(PYTHON) -m venv $(VENV)
	@$(PIP_INSTALL) --upgrade pip
endif
	@$(PIP_INSTALL) -e '.[all,docs,dev]'
	@$(PIP_INSTALL) -e '.[qmcpy]' >$(VENV)/qmcpy.log 2>&1 || \
		echo "QMCPy cannot be built without a C compiler and Python's headers; its tests will be skipped."
	@$(BIN)/python -m compileall -q src
	@touch $@

# Debian ships ensurepip, which venv needs to install pip, in a separate package.
define GET_ENSUREPIP
if [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null 2>&1; then \
	echo "$(PYTHON) lacks ensurepip; installing the package $(notdir $(PYTHON))-venv."; \
	apt-get -qq update && apt-get -qq -y install $(notdir $(PYTHON))-venv >/dev/null; \
else \
	echo "$(PYTHON) lacks ensurepip: install the package $(notdir $(PYTHON))-venv, or uv, and run make again." >&2; \
	false; \
fi
endef

# The tests of pages need a browser. They are skipped if no browser can be found or installed.
$(BROWSER): $(STAMP)
	@if $(BIN)/python -m tests.browser; then touch $@; fi

run: setup
	@rm -rf out/tour
	@$(BIN)/mcspectra run tour --out out/tour

test: $(BROWSER)
	$(BIN)/python -m pytest -n auto $(PYTEST_ARGS)

test-room: setup
	@test -n "$(ROOM)" -a -d "tests/$(ROOM)" || { echo "ROOM is '$(ROOM)'; give a folder of tests, such as make test-room ROOM=samplers." >&2; false; }
	$(BIN)/python -m pytest -n auto tests/$(ROOM) $(PYTEST_ARGS)

# Tests that take minutes: hundreds of kills, and the tests that are marked slow.
test-slow: $(BROWSER)
	$(BIN)/python -m pytest -n auto -m "slow or endurance" $(PYTEST_ARGS)

.PHONY: wheel
wheel: setup
	@rm -rf build/dist
	@$(BIN)/python -m hatchling build -t wheel -d build/dist 2>/dev/null

# Test the wheel with only its required packages, in a new environment, away from the sources.
test-bare: wheel
	@rm -rf build/bare
ifdef UV
	@$(UV) venv --quiet --python $(BIN)/python build/bare
	@$(UV) pip install --quiet --python build/bare/bin/python build/dist/*.whl
else
	@$(BIN)/python -m venv build/bare
	@build/bare/bin/python -m pip install --quiet build/dist/*.whl
endif
	cd build/bare && bin/python ../../tests/bare.py

# Install the wheel without extras for each Python, run the tour from another folder, then some tests.
test-python: $(PYTHONS:%=test-python-%)

test-python-%: wheel
	@$(PIP_INSTALL) uv
	@rm -rf build/python-$*
	@$(BIN)/uv venv --quiet --python $* build/python-$*
	@$(BIN)/uv pip install --quiet --python build/python-$* build/dist/*.whl
	cd build/python-$* && bin/mcspectra run tour
	@$(BIN)/uv pip install --quiet --python build/python-$* "$$(echo build/dist/*.whl)[report,store,cluster,frames,testing]" pytest pytest-xdist pytest-timeout
	build/python-$*/bin/python -m pytest -n auto $(QUICK)

QUICK := tests/test_start.py tests/core tests/estimators tests/integrands tests/quality

# Test the lowest versions that pyproject.toml allows, on the oldest Python; ignore their deprecations.
test-lowest: setup
	@$(PIP_INSTALL) uv
	@rm -rf build/lowest
	@$(BIN)/uv venv --quiet --python 3.11 build/lowest
	@$(BIN)/uv pip install --quiet --python build/lowest --resolution lowest-direct \
		-e '.[all,qmcpy,dev]'
	NUMBA_CACHE_DIR=$(CURDIR)/build/lowest/numba build/lowest/bin/python -m pytest -n auto \
		-m "not browser and not endurance" -W default::DeprecationWarning

# MCSPECTRA_REQUIRE_ALL=1 turns skipped tests into failures.
weekly: test-slow test-python test-lowest

check: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python -m tests.prose

bench: setup
	@$(PIP_INSTALL) -e '.[bench]'
	$(BIN)/python -m benchmarks

docs: setup
	$(BIN)/python -m pytest --doctest-modules --doctest-glob='*.md' src docs README.md
	$(BIN)/python -m sphinx -q -W --keep-going -b html docs build/docs

clean:
	rm -rf $(VENV) out build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
