# Two commands do everything on a fresh machine: `make demo` and `make test`.
PYTHON ?= python3
BIN := .venv/bin

# One more than processors, as some tests wait for other programs.
WORKERS := $(shell expr $$(nproc) + 1)

.PHONY: demo test test-all lint docs dist installed bench pictures clean

demo: .venv/installed
	$(BIN)/twinlens demo -o demo

# Bytecode is cached even where the environment says otherwise: workers, and processes that tests start, share it.
test test-all: export PYTHONDONTWRITEBYTECODE :=

test: .venv/installed-test
	$(BIN)/pytest -n $(WORKERS) --dist loadfile --no-loadscope-reorder -m "not slow"

test-all: .venv/installed-test
	$(BIN)/pytest -n $(WORKERS) --dist loadfile --no-loadscope-reorder
	$(MAKE) installed

lint: .venv/installed-lint
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

docs: .venv/installed-docs
	$(BIN)/sphinx-build --quiet --fail-on-warning --keep-going --conf-dir docs --doctree-dir .venv/doctrees . docs/site
	@echo "docs/site/index.html"

# What is uploaded to a package index.
dist: .venv/installed-dist
	rm -rf dist
	$(BIN)/python -m build --installer uv --outdir dist . > dist.log || { cat dist.log; exit 1; }
	rm dist.log
	$(BIN)/twine check --strict dist/*
	du -b dist/*

# The wheel in empty environments, with the newest and with the oldest dependencies.
installed: dist
	.ci/installed
	.ci/installed lowest-direct

bench: .venv/installed-test
	for script in benchmarks/bench_*.py; do $(BIN)/python $$script || exit 1; done

clean:
	rm -rf .venv demo docs/site docs/reference docs/gallery

.venv/bin/python:
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --upgrade pip

.venv/installed: pyproject.toml | .venv/bin/python
	$(BIN)/pip install --quiet --editable .
	touch $@

.venv/installed-test: pyproject.toml | .venv/bin/python
	$(BIN)/pip install --quiet --editable ".[test]"
	touch $@ .venv/installed

.venv/installed-lint: pyproject.toml | .venv/bin/python
	$(BIN)/pip install --quiet --editable ".[lint]"
	touch $@

.venv/installed-dist: pyproject.toml | .venv/bin/python
	$(BIN)/pip install --quiet --editable ".[dist]"
	touch $@ .venv/installed

.venv/installed-docs: pyproject.toml | .venv/bin/python
	$(BIN)/pip install --quiet --editable ".[docs]"
	touch $@

pictures: .venv/installed
	$(BIN)/python docs/pictures.py
	$(BIN)/python docs/families.py
	$(BIN)/python docs/light_fields.py
	$(BIN)/python docs/studies.py
