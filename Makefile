# make demo · make test · make lint: each sets up what it needs (Debian, Python 3.11 or 3.12).

PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
# The stages that DVC starts must find this environment's python.
export PATH := $(abspath $(BIN)):$(PATH)
export DVC_NO_ANALYTICS := 1

.PHONY: demo test lint format setup libusb

demo: setup            ## the whole chain on the embedded sample, then its table
	dvc repro
	@mkdir -p weights && cp data/encoder/encoder.pt weights/sample.pt
	@cat data/report/table.md

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

setup: libusb $(VENV)/.installed

$(VENV)/.installed: pyproject.toml constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --constraint constraints.txt torch
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[dev]'
	touch $@

# Open3D links against it; Debian and Ubuntu leave it out of minimal installations.
libusb:
	@PATH="$$PATH:/sbin:/usr/sbin" ldconfig -p | grep -q libusb-1.0.so.0 && exit 0; \
	if [ "$$(id -u)" = 0 ]; then apt-get update -qq && apt-get install -y -qq libusb-1.0-0; \
	else echo "Open3D needs libusb: sudo apt-get install libusb-1.0-0" >&2; exit 1; fi
