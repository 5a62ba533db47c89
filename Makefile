# `make demo` and `make test` each work alone on a machine that has make and Python 3.11 or newer.
# PYTHON names another one: make test PYTHON=python3.12

.PHONY: help demo lint test coverage test-fast test-slow test-live bench clean
.DELETE_ON_ERROR:

# The first of these that is new enough; python3 where none is, so that the complaint names it.
PYTHON ?= $(shell for python in python3 python3.14 python3.13 python3.12 python3.11; do \
	$$python -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo $$python && exit; done; echo python3)

# What keeps $(PYTHON) from making the environment, in one line; nothing where nothing does.
PROBLEM = $(shell python='$(PYTHON)'; \
	if ! command -v "$$python" >/dev/null; then \
		echo "$$python is not there: install Python 3.11 or newer, or name one with make PYTHON=/path/to/python3.11"; \
	elif ! "$$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then \
		echo "rotorfit needs Python 3.11 or newer and $$python is $$("$$python" -V 2>&1): name a newer one with make PYTHON=python3.11"; \
	elif ! "$$python" -c 'import ensurepip, venv' 2>/dev/null; then \
		echo "$$python has no venv: install it (Debian, Ubuntu: apt install python3-venv), or name another with make PYTHON=/path/to/python3"; \
	fi)

BIN := .venv/bin
# Tests run on all cores already, and the matrices are tiny: threads inside BLAS would only wait for each other.
export OPENBLAS_NUM_THREADS ?= 1
export OMP_NUM_THREADS ?= 1
# Byte-code is compiled once here, even where the shell forbids it: otherwise every first import takes seconds.
INSTALL = env -u PYTHONDONTWRITEBYTECODE $(@D)/bin/python -m pip install --quiet --disable-pip-version-check --compile

# Byte-code is kept, the tests' own too: without it each worker and each process that a test starts compiles its modules anew.
TESTS := env -u PYTHONDONTWRITEBYTECODE $(BIN)/pytest --numprocesses auto --dist worksteal

help:
	@echo "make demo       simulate, fit, validate; results in ./demo"
	@echo "make test       lint, types, layers, tests"
	@echo "make coverage   the same, and counts which lines and branches the tests run; a third longer"
	@echo "make test-fast  the daily loop: what takes no simulated or recorded flight, under a minute"
	@echo "make test-slow  hundreds of simulated flights, and what a quicker test proves already"
	@echo "make test-live  flights over ROS 1, MAVLink and UDP against fake vehicles, and what may go wrong with them; as root installs Debian's rospy"
	@echo "make bench      timings"
	@echo "make clean      remove what make has made"

demo: .venv/installed
	$(BIN)/rotorfit demo demo

lint: .venv/installed-dev
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	MYPY_NUM_WORKERS=auto $(BIN)/mypy
	$(BIN)/lint-imports

test: lint
	$(TESTS)

# Apart, because counting lines takes the interpreter a third more time.
coverage: lint
	$(TESTS) --cov --cov-report term:skip-covered --cov-report xml

test-fast: .venv/installed-dev
	$(BIN)/pytest --numprocesses auto -m 'not slow and not flights'

test-slow: .venv/installed-dev
	$(BIN)/pytest -m slow

test-live: .venv/installed-dev
	$(BIN)/pytest -m slow -s -rs tests/flying/test_links_live.py tests/flying/test_links_faults.py

bench: .venv-bench/installed
	set -e; for script in bench/bench_*.py; do .venv-bench/bin/python "$$script"; done

clean:
	rm -rf .venv .venv-bench demo build dist .mypy_cache .pytest_cache .ruff_cache .hypothesis
	find src tests bench -name __pycache__ -type d -prune -exec rm -rf {} + 2>/dev/null || true

# The project is installed in place (editable): again only when pyproject.toml has changed.
.venv/installed: pyproject.toml | .venv/bin/python
	$(INSTALL) --editable .
	@touch $@

.venv/installed-dev: pyproject.toml | .venv/bin/python
	$(INSTALL) --editable '.[dev]'
	@touch $@ .venv/installed

# Apart: some of the peers want an older NumPy than the types are checked with.
.venv-bench/installed: pyproject.toml | .venv-bench/bin/python
	$(INSTALL) --editable '.[bench]'
	@touch $@

.venv/bin/python .venv-bench/bin/python:
	$(if $(PROBLEM),$(error $(PROBLEM)))
	"$(PYTHON)" -m venv --clear $(@D:/bin=) || { rm -rf $(@D:/bin=); exit 1; }
