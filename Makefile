.PHONY: help install test long format check docs demo

help:  ## This list
	@grep -E '^[a-z]+:.*##' Makefile | sed -E 's/:.*## /\t/' | expand -t 12

install:  ## Virtual environment, system packages, msbdb
	@scripts/setup test

demo:  ## A database of the real tile of Nîmes
	@scripts/demo

test:  ## All checks, and every test file in some minutes
	@scripts/test

long:  ## All checks and all tests, on each installed Python
	@scripts/test --long

check: install  ## Style, types and layers only
	@.venv/bin/ruff check . && .venv/bin/ruff format --check . && .venv/bin/mypy && .venv/bin/lint-imports

format: install  ## Put the code into its one format
	@.venv/bin/ruff format . && .venv/bin/ruff check --fix .

docs: install  ## Write the generated pages anew
	@.venv/bin/python scripts/generate_docs
