# One word a task. Everything is installed into .venv; `make install` is idempotent and every other target calls it.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
DASHBOARD := service/plumbline/api/dashboard/index.html
export NUMBA_NUM_THREADS := 1
export OPENBLAS_NUM_THREADS := 1

.PHONY: install demo test soak lint bench openapi clean

install: $(STAMP) $(DASHBOARD)
	@$(BIN)/python -m plumbline.warm_up

$(STAMP): pyproject.toml clients/python/pyproject.toml clients/dtu/pyproject.toml
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet -e ".[dev,postgresql]" -e clients/python -e clients/dtu
	@touch $@

$(DASHBOARD): $(shell find clients/dashboard -type f -not -path '*/node_modules/*' 2>/dev/null) | $(STAMP)
	@PYTHON=$(abspath $(BIN))/python sh clients/dashboard/build.sh

demo: install
	$(BIN)/plumbline-dtu demo

test: install
	$(BIN)/python -m pytest

soak: install
	$(BIN)/python -m pytest -m soak

lint: install
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy service/plumbline clients/python/plumbline_client clients/dtu/plumbline_dtu
	$(BIN)/lint-imports

bench: install
	$(BIN)/python -m tests.benchmarks

openapi: install
	$(BIN)/python -m plumbline.api.documents

clean:
	rm -rf $(VENV) service/plumbline/api/dashboard clients/dashboard/node_modules
