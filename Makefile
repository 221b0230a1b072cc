# `make report` and `make test` do all set-up: they need Python 3.11 or newer, make and git, nothing else.
PYTHON ?= $(shell command -v python3.11 || command -v python3)
BIN := .venv/bin

.PHONY: report test check bench lint
.DELETE_ON_ERROR:

report: .venv/installed
	$(BIN)/yarnval report

test: .venv/installed
	$(BIN)/python -m pytest

check: .venv/installed
	$(BIN)/yarnval check

bench: .venv/installed
	$(BIN)/yarnval bench

lint: .venv/installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright
	$(BIN)/lint-imports

# One environment for everything, from the pinned and hashed requirements.
.venv/installed: requirements.lock pyproject.toml
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	touch $@
