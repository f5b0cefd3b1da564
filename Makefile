# make help lists the targets. Each sets up its environment first. Needs Python 3.11 to 3.14; tried on Debian 12 and 13.

PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
# DVC starts the stages with the first python in PATH, which make 3.81 (macOS) ignores with its default shell.
export PATH := $(abspath $(BIN)):$(PATH)
# DVC runs commands by the shell that this variable names.
export SHELL := /bin/bash
export DVC_NO_ANALYTICS := 1
# DVC asks for the user's name, which a container may lack: docker run --user 1234.
ifndef LOGNAME
export LOGNAME := $(firstword $(shell id -un 2>/dev/null || id -u))
endif
# uv installs no bytecode. Where this is set, as in many containers, each process would compile its libraries anew.
unexport PYTHONDONTWRITEBYTECODE
PRESETS := $(filter-out encoder,$(patsubst presets/%.yaml,%,$(wildcard presets/*.yaml)))
.PHONY: demo help $(PRESETS) encoder street udacity test bench lint format setup system

demo: setup            ## run the complete chain on the embedded sample and print its table
	@git rev-parse 2>/dev/null || if [ -e .git ] && command -v git >/dev/null; then git rev-parse; else \
	dvc config --local core.no_scm true; fi  # GitHub's ZIP, or a container without git
	dvc repro check labels motion graphs
	@mkdir -p .dvc/tmp && rm -f .dvc/tmp/train@*  # errors, shown after all models have ended; xargs stops at DVC's 255
	@dvc stage list --name-only | grep '^train@' | xargs -n 1 -P 2 sh -c \
	'dvc --wait-for-lock repro --single-item $$0 evaluate@$${0#train@} 2>.dvc/tmp/$$0 || exit 1' || { cat .dvc/tmp/train@* >&2; exit 1; }
	dvc repro
	@cat data/report/table.md && echo "Open data/report/index.html in a browser."

help:                  ## list the targets
	@awk -F ':.*## ' '/^[a-z]+:.*## / {printf "%-10s%s\n", $$1, $$2}' Makefile
	@echo "PRESET    run a preset in runs/PRESET: $(PRESETS)"

$(PRESETS): setup
	@python -m stages.preset "$@"

.DEFAULT:  # of another name
	@echo "error: $@: no such preset or target. Presets: $(PRESETS). Targets: make help" >&2; exit 1

encoder: setup         ## fit the sample's encoder, models/encoder/sample, on roads that no other settings name: 15 min
	@python -m stages.preset encoder encoder
	@mkdir -p models/encoder/sample && cp runs/encoder/data/encoder/encoder.pt runs/encoder/data/encoder/config.json models/encoder/sample

street: setup          ## make the encoder of real streets, weights/street, from published weights: seconds
	@python -m steer.app street

UDACITY ?= data/raw/udacity
udacity: street        ## compare with the teams of Udacity's Challenge 2; UDACITY is the folder of the three files
	@# K is that of the rig's right camera; the height follows from lanes
	@out=$$(mktemp -d) && steer measure $(UDACITY)/udacity_ch2_001.mp4 --K 2152,2166,268,303 \
	--distortion -0.042,-0.89,0,0 --camera-height 1.48 --no-video --out $$out && python -m benchmarks.alternatives \
	udacity $$out/motion.csv $(UDACITY)/udacity_ch2_001.csv $(UDACITY)/udacity_leaderboard.csv && rm -r $$out

test: setup            ## run all tests, with coverage
	OMP_NUM_THREADS=1 pytest -n "$$(nproc 2>/dev/null || getconf _NPROCESSORS_ONLN)" --dist loadfile --no-loadscope-reorder --cov --cov-report=term:skip-covered --cov-fail-under=92

bench: setup           ## measure this project beside its alternatives, then its training
	python -m benchmarks.alternatives networks
	python -m benchmarks.card

lint: setup            ## check style, types and import contracts
	ruff check . && ruff format --check . && mypy && lint-imports

format: setup          ## rewrite the code in the project's style
	ruff check --fix . && ruff format .

setup: system $(VENV)/.installed  ## make .venv

# The environment has absolute paths, so a copied or moved checkout makes it again: its path stands in .installed.
INSTALLED := $(shell cat $(VENV)/.installed 2>/dev/null)
.PHONY: $(if $(filter $(INSTALLED),$(abspath $(VENV))),,$(VENV)/.installed)
# uv installs in seconds, but does not read pip's settings. Without uv, pip installs.
PIP := $(BIN)/python -m pip
INSTALL := install --quiet --constraint constraints.txt
pip_setting = $$($(PIP) config list | sed -n "s/^[^=]*[.]$(1)='\(.*\)'$$/\1/p" | sed 's/\\n/ /g')
$(VENV)/.installed: pyproject.toml constraints.txt
	@[ ! -L $(VENV) ] || rm $(VENV)  # a link to the environment of another checkout, which --clear would empty
	[ "$(INSTALLED)" = "$(abspath $(VENV))" ] && $(PIP) --version >/dev/null 2>&1 || $(PYTHON) -m venv --clear $(VENV)
	@$(PIP) $(INSTALL) uv || echo "uv is not available: pip installs, which takes minutes"
	@links=$(call pip_setting,find-links); UV_FIND_LINKS=$${UV_FIND_LINKS:-$$(echo $$links | tr ' ' ,)}; \
	UV_EXTRA_INDEX_URL=$${UV_EXTRA_INDEX_URL:-$(call pip_setting,extra-index-url)}; \
	UV_INDEX_URL=$${UV_INDEX_URL:-$(call pip_setting,index-url)}; UV_INDEX_STRATEGY=unsafe-best-match; \
	export UV_FIND_LINKS UV_EXTRA_INDEX_URL UV_INDEX_URL UV_INDEX_STRATEGY; \
	{ [ -x $(BIN)/uv ] && $(BIN)/uv pip $(INSTALL) --python $(BIN)/python torch --editable '.[dev]'; } || \
	$(PIP) $(INSTALL) torch --editable '.[dev]'
	@echo "$(abspath $(VENV))" > $@

# Libraries that Open3D loads, and venv, which Debian packages separately. Only root can install them.
LIBRARIES := libusb-1.0.so.0=libusb-1.0-0 libEGL.so.1=libegl1 libGL.so.1=libgl1
system:
	@$(PYTHON) -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 14))' || \
	{ echo "error: $(PYTHON): expected Python 3.11 to 3.14. Name one: make PYTHON=python3.12 …" >&2; exit 1; }
	@command -v apt-get >/dev/null || exit 0; \
	known=$$(PATH="$$PATH:/sbin:/usr/sbin" ldconfig -p); missing=; \
	for pair in $(LIBRARIES); do case $$known in *$${pair%=*}*) ;; *) missing="$$missing $${pair#*=}" ;; esac; done; \
	$(PYTHON) -c 'import ensurepip' 2>/dev/null || missing="$$missing python3-venv"; \
	[ -z "$$missing" ] || if [ "$$(id -u)" = 0 ]; then apt-get update -qq && apt-get install -y -qq --no-install-recommends $$missing; \
	else echo "error: packages are missing. Install them: sudo apt-get install$$missing" >&2; exit 1; fi
