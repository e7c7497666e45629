# `make run` sets up and runs the main job, `make test` sets up and passes the tests.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.ready
BROWSER := $(VENV)/.browser
EXTRAS := render,qmcpy,parquet,vegas,docs,dev

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

# uv where it is installed, else pip; bytecode is compiled so that the first start is fast too.
# Debian packs ensurepip, without which venv cannot bring pip, apart from python3: as python3-venv.
$(STAMP): pyproject.toml
	@if command -v uv >/dev/null 2>&1; then \
		uv venv --quiet --allow-existing --python $(PYTHON) $(VENV) && \
		uv pip install --quiet --compile-bytecode --python $(BIN)/python -e '.[$(EXTRAS)]'; \
	else \
		{ $(PYTHON) -c 'import ensurepip' 2>/dev/null || $(GET_VENV); } && \
		$(PYTHON) -m venv $(VENV) && \
		$(BIN)/python -m pip install --quiet --upgrade pip && \
		$(BIN)/python -m pip install --quiet -e '.[$(EXTRAS)]'; \
	fi
	@$(BIN)/python -m compileall -q src
	@touch $@

VENV_PACKAGE = $(notdir $(PYTHON))-venv
define GET_VENV
{ [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null 2>&1 && \
	echo "$(PYTHON) lacks ensurepip; installing the package $(VENV_PACKAGE)." && \
	apt-get -qq update && apt-get -qq -y install $(VENV_PACKAGE) >/dev/null || \
	{ echo "$(PYTHON) lacks ensurepip: install the package $(VENV_PACKAGE), or uv, and run make again." >&2; \
	false; }; }
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
	@if command -v uv >/dev/null 2>&1; then \
		uv pip install --quiet --python $(BIN)/python -e '.[bench]'; \
	else \
		$(BIN)/python -m pip install --quiet -e '.[bench]'; \
	fi
	$(BIN)/python -m benchmarks

docs: setup
	$(BIN)/python -m pytest --doctest-modules --doctest-glob='*.md' src docs README.md
	$(BIN)/python -m sphinx -q -W --keep-going -b html docs build/docs

clean:
	rm -rf $(VENV) out build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
