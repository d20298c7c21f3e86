# `make run` and `make test` set everything up by themselves; nothing else is needed beforehand
# but Python 3.11 and the network.
PYTHON ?= python3.11
BIN := .venv/bin
STAMP := .venv/.complete

.DEFAULT_GOAL := help
.PHONY: help setup run test style check bench blind lock clean

help:
	@echo "make run    a whole line on this machine: 24 units, verdicts and yield within a minute"
	@echo "make test   the tests, under five minutes on two cores"
	@echo "make check  style, types, import rules, and the long tests (2000 simulated lines, power loss)"
	@echo "make blind  the gap diagnosis on 400 cases with sealed labels, beside an oracle"
	@echo "make bench  every figure with its goal, beside the peer measured in the same run"

setup: $(STAMP)

# uv where it is installed (seconds), else venv and pip with the same hashed versions (a minute or two).
$(STAMP): pyproject.toml requirements.lock
	@echo "Setting up .venv: seconds with uv, a few minutes with pip; this happens once."
	@if command -v uv >/dev/null 2>&1; then \
		uv sync --frozen --python 3.11; \
	else \
		{ command -v $(PYTHON) >/dev/null 2>&1 && $(PYTHON) -m venv .venv || python3 -m venv .venv || \
		  { echo "Testloom needs Python 3.11 with its venv module; on Debian: apt-get install python3.11-venv"; exit 1; }; } && \
		$(BIN)/python -c 'import sys; assert sys.version_info[:2] == (3, 11), "Testloom needs Python 3.11, found " + sys.version' && \
		$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock && \
		$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .; \
	fi
	@touch $(STAMP)

run: setup
	$(BIN)/testloom up --units 24 --seed 7

test: setup
	$(BIN)/python -m pytest -q -n 2 --dist loadgroup -m "not slow"

style: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports
	$(BIN)/pyright

check: style
	$(BIN)/python -m coordinator.line_simulator --seeds 0:2000
	$(BIN)/python -m pytest -q -n 2 --dist loadgroup

bench: setup
	$(BIN)/python -m benchmarks

blind: setup
	nice -n 5 $(BIN)/python -m tests.blind

lock:
	uv lock
	uv export --frozen --all-groups --no-emit-project --format requirements-txt --output-file requirements.lock --quiet

clean:
	rm -rf .venv runs .pytest_cache .ruff_cache .hypothesis .import_linter_cache
