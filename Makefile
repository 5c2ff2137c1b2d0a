# Each of these works as the first command on a fresh machine with Python 3.11 or newer: .venv is made when needed.
BIN := .venv/bin
# pyright runs as installed and does not look for newer versions of itself.
export PYRIGHT_PYTHON_IGNORE_WARNINGS := 1

.PHONY: demo test test-system test-long check clean

demo: .venv/.installed
	$(BIN)/longreach run dual-trajectory --out out/demo

# What a newcomer needs to trust the install. Kernels are compiled by the tests that need them, once on a machine.
test: .venv/.installed-dev
	$(BIN)/pytest --numprocesses=auto

# One process, because these tests keep time by the wall clock. A failed one is repeated once, and counted.
test-system: .venv/.installed-dev
	$(BIN)/longreach warmup
	$(BIN)/pytest -m system

# LONGREACH_DATA, where set, names the folder of real recordings that tests/real needs.
test-long: .venv/.installed-dev
	$(BIN)/pytest --numprocesses=auto --dist=loadfile -m long

check: .venv/.installed-dev
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/pyright
	$(BIN)/lint-imports

clean:
	rm -rf .venv out build dist src/*.egg-info .pytest_cache .ruff_cache .import_linter_cache .hypothesis
	find src tests benchmarks examples -name __pycache__ -type d -prune -exec rm -rf {} +

# The first Python that is new enough and can make environments; a name on the PATH alone does not tell.
.venv/bin/python:
	@for python in python3.13 python3.12 python3.11 python3; do \
		if $$python -c 'import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then \
			echo "Making .venv with $$($$python --version)."; \
			exec $$python -m venv .venv; \
		fi; \
	done; \
	echo "longreach needs Python 3.11 or newer with its venv module, and found none: install it (on Debian: python3 and" \
		"python3-venv) and run make again." >&2; \
	exit 1

.venv/.installed: pyproject.toml | .venv/bin/python
	@echo "Installing longreach, the packages it needs and a physics engine into .venv; this takes a minute or two."
	@$(BIN)/python -m pip install -qq --disable-pip-version-check --editable '.[sim]'
	@touch $@

.venv/.installed-dev: pyproject.toml | .venv/bin/python
	@echo "Installing longreach, the packages it needs and the tools of its developers into .venv; this takes a few minutes."
	@$(BIN)/python -m pip install -qq --disable-pip-version-check --editable '.[dev]'
	@touch .venv/.installed $@
