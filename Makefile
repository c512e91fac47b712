# Every target sets up what it needs first: in a fresh clone, `make demo` is enough.
# `make help` lists the targets. Choose the interpreter with `make setup PYTHON=python3.12`.

PYTHON  ?=
WORKERS ?= 2
ARGS    ?=

candidates := $(or $(PYTHON),python3 python3.13 python3.12 python3.11 python)

bin   := .venv/bin
stamp := .venv/.ready

.DEFAULT_GOAL := help
.PHONY: setup demo test check docs format bench clean help

setup: $(stamp) ## create .venv with every dependency at its pinned version

# Runs again when the dependencies or their pins change. The first step looks for an interpreter:
# an old `python3`, or one without venv, must not hide a good `python3.12` beside it.
$(stamp): pyproject.toml constraints.txt
	@for candidate in $(candidates); do \
	  if "$$candidate" -c 'import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 11))' \
	      >/dev/null 2>&1; then \
	    echo "Setting up .venv (once; this takes a few minutes)"; \
	    exec "$$candidate" -m venv .venv; \
	  fi; \
	done; \
	echo "Python 3.11 or later with its venv module is needed and was not found" \
	  "(looked for: $(candidates)). Name one: make setup PYTHON=/path/to/python" >&2; \
	exit 1
	@$(bin)/python -m pip install -qq --constraint constraints.txt pip hatchling editables
	@$(bin)/python -m pip install -qq --constraint constraints.txt --no-build-isolation \
	  --editable '.[all]' --group dev
	@touch $@

demo: $(stamp) ## identify an arm from its files, then repeat the experiment of the thesis, into build/demo
	$(bin)/python -m scripts.studies.puma560.experiment -o build/demo $(ARGS)

test: $(stamp) ## run all tests and the examples in docstrings (one file: ARGS=tests/test_x.py)
	$(bin)/python -m pytest -n $(WORKERS) --dist worksteal $(ARGS)

check: $(stamp) ## check formatting, lint, types and the English of pages
	$(bin)/ruff format --check .
	$(bin)/ruff check .
	$(bin)/pyright
	$(bin)/python -m scripts.tools.english

docs: $(stamp) ## build the documentation site, into build/site
	NO_MKDOCS_2_WARNING=1 $(bin)/mkdocs build --strict

format: $(stamp) ## format the code and apply the linter's safe fixes
	$(bin)/ruff check --fix .
	$(bin)/ruff format .

bench: $(stamp) ## run the benchmarks
	$(bin)/python -m scripts.benchmarks.run $(ARGS)

clean: ## remove what the targets made, but for .venv
	rm -rf build dist .cache .pytest_cache .ruff_cache .hypothesis
	find . -name __pycache__ -not -path './.venv/*' -prune -exec rm -rf {} +

help: ## list the targets
	@awk -F ':.*## ' '/^[a-z]+:.*## / { printf "  make %-8s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)
