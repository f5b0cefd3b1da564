# make demo · make table2 · make replay · make test · make lint: each sets up what it needs (Debian, Python 3.11 or 3.12).

PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
# The stages that DVC starts must find this environment's python.
export PATH := $(abspath $(BIN)):$(PATH)
export DVC_NO_ANALYTICS := 1

.PHONY: demo table2 replay test lint format setup system

demo: setup            ## the whole chain on the embedded sample, then its table
	dvc repro
	@cat data/report/table.md

# table2: every model of the paper's tables, on the sample. replay: the sample along the recorded drives of data/raw.
# The same chain with params.NAME.yaml, in a copy of the code under runs/NAME: params.yaml and data/ stay as they are.
# What is there already, here or from an earlier run, comes from the one cache.
table2 replay: setup
	@mkdir -p runs/$@/data data/report weights
	@rm -rf runs/$@/pipeline runs/$@/models runs/$@/stages
	@cp -R pipeline models stages dvc.yaml runs/$@/ && cp params.$@.yaml runs/$@/params.yaml
	@cp data/.gitignore runs/$@/data/ && ln -sfn ../../../data/raw runs/$@/data/raw && ln -sfn ../../weights runs/$@/weights
	@cd runs/$@ && { [ -d .dvc ] || dvc init --quiet --no-scm; } && dvc cache dir ../../.dvc/cache && dvc repro
	@for kind in md csv; do cp runs/$@/data/report/table.$$kind data/report/$@.$$kind; done
	@cat data/report/$@.md

test: setup            ## all tests, with coverage of pipeline/ and models/
	pytest --cov --cov-report=term:skip-covered --cov-fail-under=90

lint: setup
	ruff check .
	ruff format --check .
	mypy
	lint-imports

format: setup
	ruff check --fix .
	ruff format .

setup: system $(VENV)/.installed

$(VENV)/.installed: pyproject.toml constraints.txt
	$(BIN)/python -m pip --version >/dev/null 2>&1 || $(PYTHON) -m venv --clear $(VENV)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt torch
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[dev]'
	touch $@

# Open3D links against libusb, and Debian ships Python without venv: root gets both, others are told.
system:
	@$(PYTHON) -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 12))' || \
	{ echo "$(PYTHON) is not 3.11 or 3.12: make PYTHON=python3.11 …" >&2; exit 1; }
	@missing=""; \
	PATH="$$PATH:/sbin:/usr/sbin" ldconfig -p | grep -q libusb-1.0.so.0 || missing="libusb-1.0-0"; \
	$(PYTHON) -c 'import ensurepip' 2>/dev/null || missing="$$missing python3-venv"; \
	[ -z "$$missing" ] || \
	if [ "$$(id -u)" = 0 ]; then apt-get update -qq && apt-get install -y -qq $$missing; \
	else echo "missing: sudo apt-get install $$missing" >&2; exit 1; fi
