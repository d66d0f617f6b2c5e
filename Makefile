# `make render` draws a picture, `make test` runs every check; each sets up what it needs in .venv first.
.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: help setup render test test-all bench docs clean

PYTHON ?= python3
VENV   := .venv
# Windows keeps a venv's programs in Scripts.
BIN    := $(VENV)/$(if $(filter Windows_NT,$(OS)),Scripts,bin)
STAMP  := $(VENV)/.set-up
WORKERS ?= 2
PRESET ?= enamel-on-gold

help:
	@echo "make render     draw out/$(PRESET).png (PRESET=name draws another one)"
	@echo "make test       lint, types and the tests that are not slow"
	@echo "make test-all   the slow tests as well"
	@echo "make bench      write the benchmark table"
	@echo "make docs       check the documentation and build its site, docs/_build/html/index.html"
	@echo "make setup      only set up .venv;  make clean: remove it and everything else that was made"

setup: $(STAMP)

# The stamp is written last, so that an interrupted set-up is done again.
$(STAMP): pyproject.toml constraints.txt tools/make_venv.py
	@$(PYTHON) tools/make_venv.py $(VENV)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt pip setuptools
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --no-build-isolation -e '.[dev,plot]'
	@touch $(STAMP)

render: setup
	$(BIN)/urushi render preset:$(PRESET) -o out/$(PRESET).png

test: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/python -m pytest -q -n $(WORKERS) -m "not slow"

test-all: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/python -m pytest -q -n $(WORKERS)

bench: setup
	$(BIN)/python benchmarks/run.py
	$(BIN)/python tools/make_docs.py
	$(BIN)/python tools/make_docs.py

docs: $(STAMP)-docs
	$(BIN)/python tools/make_docs.py --check
	$(BIN)/python tools/check_links.py
	$(BIN)/python -m sphinx -W -E --keep-going -q -b html docs docs/_build/html
	@echo "docs/_build/html/index.html"

# Only who builds the site needs what builds it.
$(STAMP)-docs: $(STAMP)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --no-build-isolation -e '.[docs]'
	@touch $@

clean:
	rm -rf $(VENV) out build dist docs/_build .pytest_cache .ruff_cache .mypy_cache .hypothesis src/*.egg-info
	find src tests tools benchmarks -name __pycache__ -type d -prune -exec rm -rf {} + 2>/dev/null || true
