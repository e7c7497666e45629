# `make run` sets up and runs the main job, `make test` sets up and passes the tests.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.ready

.PHONY: run test test-slow setup check bench docs clean help

help:
	@echo "make run    set up, then measure, predict and explain the tour (report in out/tour)"
	@echo "make test   set up, then run the tests"
	@echo "make test-slow  set up, then run the tests that take minutes"
	@echo "make check  lint, types, import contract"
	@echo "make bench  benchmarks: ratios against a reference in the same run"
	@echo "make docs   check the documentation's examples, then build it: build/docs/index.html"
	@echo "make clean  remove everything that was built, the environment too"

setup: $(STAMP)

# uv where it is installed, else pip; bytecode is compiled so that the first start is fast too.
$(STAMP): pyproject.toml
	@if command -v uv >/dev/null 2>&1; then \
		uv venv --quiet --allow-existing --python $(PYTHON) $(VENV) && \
		uv pip install --quiet --compile-bytecode --python $(BIN)/python -e '.[render,qmcpy,parquet,vegas,docs,dev]'; \
	else \
		{ [ -x $(BIN)/python ] || $(PYTHON) -m venv $(VENV); } && \
		$(BIN)/python -m pip install --quiet --upgrade pip && \
		$(BIN)/python -m pip install --quiet -e '.[render,qmcpy,parquet,vegas,docs,dev]'; \
	fi
	@$(BIN)/python -m compileall -q src
	@touch $@

run: setup
	@rm -rf out/tour
	@$(BIN)/mcspectra run studies/tour.toml --out out/tour

test: setup
	$(BIN)/python -m pytest -n auto $(PYTEST_ARGS)

# Minutes: hundreds of kills, and what is marked slow anyway.
test-slow: setup
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
