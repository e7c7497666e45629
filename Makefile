# `make run` sets up and runs the main job, `make test` sets up and passes the tests.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.ready
BROWSER := $(VENV)/.browser

# uv where it is installed, else pip.
UV := $(shell command -v uv 2>/dev/null)
PIP_INSTALL := $(if $(UV),$(UV) pip install --compile-bytecode --python $(BIN)/python,$(BIN)/python -m pip install) --quiet

.PHONY: run test test-slow test-python test-lowest weekly setup check bench docs clean help

help:
	@echo "make run    set up, then measure, predict and explain the tour (report in out/tour)"
	@echo "make test   set up, then run the tests"
	@echo "make test-slow  set up, then run the tests that take minutes"
	@echo "make test-python  install in new environments of $(PYTHONS), run the tour and some tests"
	@echo "make test-lowest  run the tests with the lowest versions that pyproject.toml allows"
	@echo "make weekly the last three"
	@echo "make check  lint, types, import contract"
	@echo "make bench  benchmarks: ratios against a reference in the same run"
	@echo "make docs   check the documentation's examples, then build it: build/docs/index.html"
	@echo "make clean  remove everything that was built, the environment too"

setup: $(STAMP)

# Bytecode is compiled so that the first start is fast too. QMCPy is built from its source.
$(STAMP): pyproject.toml
ifdef UV
	@$(UV) venv --quiet --allow-existing --python $(PYTHON) $(VENV)
else
	@$(PYTHON) -c 'import ensurepip' 2>/dev/null || { $(GET_ENSUREPIP); }
	@$(PYTHON) -m venv $(VENV)
	@$(PIP_INSTALL) --upgrade pip
endif
	@$(PIP_INSTALL) -e '.[render,parquet,vegas,docs,dev]'
	@$(PIP_INSTALL) -e '.[qmcpy]' >$(VENV)/qmcpy.log 2>&1 || \
		echo "QMCPy cannot be built, for want of a C compiler or Python's headers; its tests will be skipped."
	@$(BIN)/python -m compileall -q src
	@touch $@

# Debian packs ensurepip, without which venv cannot bring pip, apart from python3.
define GET_ENSUREPIP
if [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null 2>&1; then \
	echo "$(PYTHON) lacks ensurepip; installing the package $(notdir $(PYTHON))-venv."; \
	apt-get -qq update && apt-get -qq -y install $(notdir $(PYTHON))-venv >/dev/null; \
else \
	echo "$(PYTHON) lacks ensurepip: install the package $(notdir $(PYTHON))-venv, or uv, and run make again." >&2; \
	false; \
fi
endef

# The tests of pages want a browser; they are skipped where there is none and none can be had.
$(BROWSER): $(STAMP)
	@$(BIN)/python -m tests.browser
	@touch $@

run: setup
	@rm -rf out/tour
	@$(BIN)/mcspectra run tour --out out/tour

test: $(BROWSER)
	$(BIN)/python -m pytest -n auto $(PYTEST_ARGS)

# Minutes: hundreds of kills, and what is marked slow anyway.
test-slow: $(BROWSER)
	$(BIN)/python -m pytest -n auto -m "slow or endurance" $(PYTEST_ARGS)

check: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

bench: setup
	@$(PIP_INSTALL) -e '.[bench]'
	$(BIN)/python -m benchmarks

docs: setup
	$(BIN)/python -m pytest --doctest-modules --doctest-glob='*.md' src docs README.md
	$(BIN)/python -m sphinx -q -W --keep-going -b html docs build/docs

clean:
	rm -rf $(VENV) out build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
