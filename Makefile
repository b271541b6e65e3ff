# The everyday commands; `make` alone lists them. Nothing but make and Python (or uv) is needed.
SHELL := /bin/sh
VENV := .venv
BIN := $(VENV)/bin
# Written last, so that a set-up that was cut short never counts as done.
STAMP := $(VENV)/.complete
DOCS_STAMP := $(VENV)/.complete-docs
MUTANTS_STAMP := $(VENV)/.complete-mutants
CONFIG := configs/quickstart.yaml
ARGS :=
N := 10000
SEED := 0
CASE :=
PATHS := diffshadow
SAMPLE := 200
# Tried in this order: the pinned packages are tested on 3.12 first.
PYTHON := python3.12 python3.13 python3.14 python3 python
UV := uv
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile
IMPORT_ALL := import importlib, pkgutil, diffshadow as own; \
    [importlib.import_module(each.name) for each in pkgutil.walk_packages(own.__path__, 'diffshadow.') if '__' not in each.name]
COMPILE := pip compile --universal --python-version 3.12 --upgrade --quiet --no-annotate --no-header --no-emit-index-url
# pyright's launcher otherwise remarks on releases newer than the pinned one.
export PYRIGHT_PYTHON_IGNORE_WARNINGS := 1
# Python keeps its bytecode in __pycache__, even where the shell forbids it: every process would compile it again.
export PYTHONDONTWRITEBYTECODE :=

.DEFAULT_GOAL := help
.PHONY: help setup fit gallery docs test test-rest test-all fuzz mutants lint types dist dist-check constraints clean

help: ## list these targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "make %-12s %s\n", $$1, $$2}' Makefile

setup: $(STAMP) ## make .venv with the pinned packages and diffshadow itself
	@:

fit: $(STAMP) ## run the quickstart fit (CONFIG=another.yaml)
	$(BIN)/diffshadow fit $(CONFIG) $(ARGS)

gallery: $(STAMP) ## draw every technique into docs/gallery.md (takes minutes)
	$(BIN)/python experiments/gallery.py configs/gallery.yaml $(ARGS)

docs: $(DOCS_STAMP) ## build the documentation site into site/ (read it with `python -m http.server -d site`)
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build $(ARGS)

test: $(STAMP) ## run the tests (ARGS="-k pcf")
	$(BIN)/python -m pytest $(ARGS)

test-rest: $(STAMP) ## run the exhaustive tests alone, which takes minutes more
	$(BIN)/python -m pytest -m exhaustive $(ARGS)

test-all: test test-rest ## run both
	@:

fuzz: $(STAMP) ## feed the command random input and say what it does badly (N=300 SEED=1; CASE=17 does one again)
	$(BIN)/python tests/fuzz/run.py --cases $(N) --seed $(SEED) $(if $(CASE),--case $(CASE)) $(ARGS)

mutants: $(MUTANTS_STAMP) ## put mistakes into a copy and say which the tests miss (PATHS=diffshadow/fit SAMPLE=20 SEED=1)
	$(BIN)/python tests/mutants/examine.py $(PATHS) --sample $(SAMPLE) --seed $(SEED) $(ARGS)

lint: $(STAMP) ## check style and formatting
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(STAMP) ## check types
	$(BIN)/pyright

dist: $(STAMP) ## build the sdist and the wheel into dist/
	rm -rf dist
	$(BIN)/hatchling build -d dist

dist-check: dist ## install the wheel outside of the clone, and run README's example and a fit there
	$(BIN)/python tests/wheel/run.py dist/*.whl

constraints: ## pin the newest packages that fit together into constraints*.txt (needs uv)
	@$(UV) --version >/dev/null 2>&1 || { \
	    echo "make constraints needs uv, which is not on the PATH: see docs.astral.sh/uv for how to install it." >&2; exit 2; }
	$(UV) $(COMPILE) pyproject.toml --group dev --group build --output-file constraints.txt.new
	for group in docs mutants; do \
	    $(UV) $(COMPILE) --group $$group --constraint constraints.txt.new \
	        --output-file constraints-$$group.txt.new || exit 1; \
	done
	@if grep -n '://' constraints*.txt.new; then \
	    echo "constraints*.txt would hold the addresses above; they are left as they were." >&2; \
	    rm -f constraints*.txt.new; exit 1; fi
	@mv constraints.txt.new constraints.txt
	@for group in docs mutants; do mv constraints-$$group.txt.new constraints-$$group.txt; done

clean: ## remove .venv and all caches
	rm -rf $(VENV) .pytest_cache .ruff_cache .hypothesis build dist site constraints*.txt.new
	find diffshadow docs experiments notebooks tests -name __pycache__ -type d -prune -exec rm -rf {} + 2>/dev/null || true

# With uv if there is one that works, else with the first Python that is new enough. A complete .venv is brought up to
# date in place; a half-made one is made anew. Packages come as wheels only: no compiler is ever needed. Only modules
# that diffshadow imports are compiled to bytecode; for all of them, that takes as long as the rest of the set-up.
$(STAMP): pyproject.toml constraints.txt
	@set -u; fresh=yes; \
	if [ -e $@ ] && $(BIN)/python -c '' 2>/dev/null; then fresh=no; fi; \
	rm -f $@; \
	new_enough='import sys; sys.exit(sys.version_info < (3, 12))'; \
	version='import sys; print(".".join(map(str, sys.version_info[:3])))'; \
	failed() { \
	    echo "The set-up of $(VENV) failed ($$1); the message above says why. Mend that and run make setup again." >&2; \
	    exit 1; \
	}; \
	with=pip; \
	if $(UV) --version >/dev/null 2>&1; then with=uv; fi; \
	if [ $$fresh = no ] && [ $$with = pip ] && ! $(BIN)/python -m pip --version >/dev/null 2>&1; then fresh=yes; fi; \
	if [ $$fresh = yes ] && [ $$with = uv ]; then \
	    echo "Making $(VENV) with $$($(UV) --version | cut -d ' ' -f 1,2)."; \
	    rm -rf $(VENV); \
	    $(UV) venv --quiet $(VENV) || failed "uv venv"; \
	elif [ $$fresh = yes ]; then \
	    chosen=; found=; bare=; \
	    for python in $(PYTHON); do \
	        is=$$($$python -c "$$version" 2>/dev/null) || continue; \
	        found="$$found  $$python is $$is ($$(command -v $$python))\n"; \
	        $$python -c "$$new_enough" || continue; \
	        if $$python -c 'import ensurepip, venv' 2>/dev/null; then chosen=$$python; break; fi; \
	        bare="$$bare $$python"; \
	    done; \
	    if [ -z "$$chosen" ] && [ -n "$$bare" ]; then \
	        { echo "Found$$bare, which cannot make virtual environments: its venv or ensurepip module is missing."; \
	          echo "Install it (on Debian and Ubuntu: apt install$$(echo "$$bare" | sed 's/[^ ][^ ]*/&-venv/g')), or install uv,"; \
	          echo "then run make setup again."; } >&2; exit 2; \
	    fi; \
	    if [ -z "$$chosen" ]; then \
	        { echo "diffshadow needs Python 3.12 or newer, and none was found on the PATH."; \
	          if [ -n "$$found" ]; then printf 'Found:\n%b' "$$found"; else echo "Tried: $(PYTHON)."; fi; \
	          echo "Install Python 3.12 (or uv, which brings its own), or name one: make setup PYTHON=/path/to/python3.12"; \
	        } >&2; exit 2; \
	    fi; \
	    echo "Making $(VENV) with $$chosen ($$is)."; \
	    rm -rf $(VENV); \
	    $$chosen -m venv $(VENV) || failed "$$chosen -m venv"; \
	fi; \
	echo "Installing the packages pinned in constraints.txt and diffshadow itself (takes a minute or two)."; \
	if [ $$with = uv ]; then \
	    install="$(UV) pip install --quiet --python $(BIN)/python"; check="$(UV) pip check --quiet --python $(BIN)/python"; \
	    wheels=--no-build; \
	else \
	    install="$(PIP)"; check="$(BIN)/python -m pip check"; \
	    wheels="--only-binary :all:"; \
	fi; \
	$$install $$wheels --requirement constraints.txt || failed "the pinned packages"; \
	$$install --no-deps --no-build-isolation --editable . || failed "diffshadow itself"; \
	$$check || failed "constraints.txt does not fit pyproject.toml: make constraints"; \
	$(BIN)/python -c "$(IMPORT_ALL)" || failed "the import of diffshadow"; \
	touch $@; \
	echo "$(VENV) is ready."

# The packages of the site, and of the mutation tester, which are not part of the everyday set-up. One of the latter is
# plain Python without a wheel.
$(DOCS_STAMP) $(MUTANTS_STAMP): $(VENV)/.complete-%: $(STAMP) constraints-%.txt
	@rm -f $@; \
	if $(UV) --version >/dev/null 2>&1; then \
	    $(UV) pip install --quiet --python $(BIN)/python --requirement constraints-$*.txt; \
	else \
	    $(PIP) --prefer-binary --requirement constraints-$*.txt; \
	fi || { echo "The packages of constraints-$*.txt were not installed; the message above says why." >&2; exit 1; }
	@touch $@
