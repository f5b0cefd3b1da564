# make help lists the targets. Each sets up its environment first. Needs Debian or Ubuntu and Python 3.11 or 3.12.

PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
# DVC starts the stages with the first python in PATH.
export PATH := $(abspath $(BIN)):$(PATH)
export DVC_NO_ANALYTICS := 1
# uv installs no bytecode. Where this is set, as in many containers, each process would compile its libraries anew.
unexport PYTHONDONTWRITEBYTECODE

PRESETS := $(patsubst presets/%.yaml,%,$(wildcard presets/*.yaml))
CHAINS := $(filter-out encoder street,$(PRESETS))
RUNS := $(CHAINS:%=run-of-%)
# Benchmarks also use recorded scans, if there are any.
KITTI := $(or $(STEER_KITTI),$(wildcard ../shared/kitti))

.PHONY: demo help encoder street udacity $(CHAINS) $(RUNS) params test bench lint format setup system

demo: setup            ## run the complete chain on the embedded sample and print its table
	dvc repro
	@cat data/report/table.md && echo "Open data/report/index.html in a browser."

help:                  ## list the targets
	@sed -n 's/^\([a-z]*\):.*## /\1\t/p' Makefile | expand -t 10
	@echo "PRESET    run a preset in runs/PRESET: $(CHAINS)"

# Each preset runs in a copy of the code, runs/NAME, with its settings merged into params.yaml. The cache is shared.
# The lock refuses a second run, which would replace the code of the first.
$(CHAINS): setup
	@mkdir -p runs && flock --nonblock --conflict-exit-code 99 "runs/$@.lock" $(MAKE) --no-print-directory "run-of-$@" || \
	{ [ $$? -ne 99 ] || echo "error: runs/$@: another make $@ is running. Wait until it ends" >&2; exit 1; }

$(RUNS): run-of-%:
	@mkdir -p "runs/$*/data" data/report weights
	@python -m pipeline.settings.preset "$*" --out "runs/$*/params.yaml"
	@rm -rf "runs/$*/pipeline" "runs/$*/models" "runs/$*/stages"
	@cp -R pipeline models stages dvc.yaml .dvcignore "runs/$*/" && cp data/.gitignore "runs/$*/data/"
	@ln -sfn ../../../data/raw "runs/$*/data/raw" && ln -sfn ../../weights "runs/$*/weights"
	@cd "runs/$*" && { [ -d .dvc ] || dvc init --quiet --no-scm; } && dvc config cache.type hardlink,copy && dvc cache dir ../../.dvc/cache && dvc repro
	@for kind in md csv; do cp "runs/$*/data/report/table.$$kind" "data/report/$*.$$kind"; done
	@cp "runs/$*/data/report/index.html" "data/report/$*.html" && cat "data/report/$*.md" && echo "Open data/report/$*.html in a browser."

encoder: setup         ## fit the sample's encoder, models/encoder/sample, on roads that no other settings name: 15 min
	@mkdir -p runs/encoder && python -m pipeline.settings.preset encoder --out runs/encoder/params.yaml
	@cd runs/encoder && export PYTHONPATH=../.. && for stage in sample ingest encoder; do python -m stages.$$stage || exit; done
	@mkdir -p models/encoder/sample && cp runs/encoder/data/encoder/encoder.pt runs/encoder/data/encoder/config.json models/encoder/sample

street: setup          ## make the encoder of real streets, weights/street, from published weights: seconds
	@mkdir -p runs/street && python -m pipeline.settings.preset street --out runs/street/params.yaml
	@python -m stages.encoder --params runs/street/params.yaml --out weights/street

UDACITY ?= data/raw/udacity
udacity: street        ## compare with the teams of Udacity's Challenge 2; UDACITY is the folder of the three files
	@python -m benchmarks.udacity $(UDACITY)/udacity_ch2_001.mp4 $(UDACITY)/udacity_ch2_001.csv \
	$(UDACITY)/udacity_leaderboard.csv

PRESET ?=
params: setup          ## write the settings of a preset into params.yaml: make params PRESET=kitti, or your own file
	@[ -n "$(PRESET)" ] || { echo "error: PRESET is missing. Choose one of: $(PRESETS), or a path" >&2; exit 1; }
	@python -m pipeline.settings.preset "$(PRESET)" --out params.yaml

PYTEST = OMP_NUM_THREADS=1 pytest -n "$$(nproc)" --dist loadfile --no-loadscope-reorder
test: setup            ## run all tests, with coverage
	$(PYTEST) --cov --cov-report=term:skip-covered --cov-fail-under=95

ROWS ?=
bench: setup           ## measure this project beside its alternatives; ROWS="ltc demo" measures these rows only
	@rm -f benchmarks/results.json
	$(if $(KITTI),STEER_KITTI="$(KITTI)") python -m benchmarks.bench $(ROWS) --out benchmarks/results.json

lint: setup            ## check style, types and import contracts
	ruff check .
	ruff format --check .
	mypy
	lint-imports

format: setup          ## rewrite the code in the project's style
	ruff check --fix .
	ruff format .

setup: system $(VENV)/.installed  ## make .venv

# uv installs in seconds, but does not read pip's settings. Without uv, pip installs.
PIP := $(BIN)/python -m pip
INSTALL := install --quiet --constraint constraints.txt
pip_setting = $$($(PIP) config list | sed -n "s/^[^=]*[.]$(1)='\(.*\)'$$/\1/p" | sed 's/\\n/ /g')

$(VENV)/.installed: pyproject.toml constraints.txt
	$(PIP) --version >/dev/null 2>&1 || $(PYTHON) -m venv --clear $(VENV)
	@$(PIP) $(INSTALL) uv || echo "uv is not available: pip installs, which takes minutes"
	@links=$(call pip_setting,find-links); UV_FIND_LINKS=$${UV_FIND_LINKS:-$$(echo $$links | tr ' ' ,)}; \
	UV_EXTRA_INDEX_URL=$${UV_EXTRA_INDEX_URL:-$(call pip_setting,extra-index-url)}; \
	UV_INDEX_URL=$${UV_INDEX_URL:-$(call pip_setting,index-url)}; UV_INDEX_STRATEGY=unsafe-best-match; \
	export UV_FIND_LINKS UV_EXTRA_INDEX_URL UV_INDEX_URL UV_INDEX_STRATEGY; \
	{ [ -x $(BIN)/uv ] && $(BIN)/uv pip $(INSTALL) --python $(BIN)/python torch --editable '.[dev]'; } || \
	$(PIP) $(INSTALL) torch --editable '.[dev]'
	touch $@

# Open3D links against libusb, and Debian packages venv separately. Only root can install them.
system:
	@$(PYTHON) -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 12))' || \
	{ echo "error: $(PYTHON): expected Python 3.11 or 3.12. Name one: make PYTHON=python3.11 …" >&2; exit 1; }
	@missing=""; \
	PATH="$$PATH:/sbin:/usr/sbin" ldconfig -p | grep -q libusb-1.0.so.0 || missing="libusb-1.0-0"; \
	$(PYTHON) -c 'import ensurepip' 2>/dev/null || missing="$$missing python3-venv"; \
	[ -z "$$missing" ] || \
	if [ "$$(id -u)" = 0 ]; then apt-get update -qq && apt-get install -y -qq $$missing; \
	else echo "error: packages are missing. Install them: sudo apt-get install $$missing" >&2; exit 1; fi
