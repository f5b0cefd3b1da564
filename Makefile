# make demo · make PRESET · make params PRESET=… · make test · make bench · make stress · make lint: each sets up what it
# needs (Debian, Python 3.11 or 3.12). A preset is a file of presets/: make kitti · make real · make table2 · make replay ·
# make studies.

PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
# The stages that DVC starts must find this environment's python.
export PATH := $(abspath $(BIN)):$(PATH)
export DVC_NO_ANALYTICS := 1

PRESETS := $(patsubst presets/%.yaml,%,$(wildcard presets/*.yaml))
RUNS := $(PRESETS:%=run-of-%)

.PHONY: demo $(PRESETS) $(RUNS) params test bench stress lint format setup system

# dvc repro, but without the graph variants that no model of params.yaml takes.
demo: setup            ## the whole chain on the embedded sample, then its table
	dvc repro check pictures report
	@cat data/report/table.md && echo "Open data/report/index.html in a browser."

# The same chain with a preset laid over params.yaml, in a copy of the code under runs/NAME: params.yaml and data/ stay as
# they are. What is there already, here or from an earlier run, comes from the one cache. One at a time: a second run of the
# same preset would exchange the code under the first.
$(PRESETS): setup
	@mkdir -p runs && flock --nonblock --conflict-exit-code 99 "runs/$@.lock" $(MAKE) --no-print-directory "run-of-$@" || \
	{ [ $$? -ne 99 ] || echo "error: another make $@ is at work in runs/$@: wait for it to end" >&2; exit 1; }

$(RUNS): run-of-%:
	@mkdir -p "runs/$*/data" data/report weights
	@python -m pipeline.sections.preset "$*" --out "runs/$*/params.yaml"
	@rm -rf "runs/$*/pipeline" "runs/$*/models" "runs/$*/stages"
	@cp -R pipeline models stages dvc.yaml .dvcignore "runs/$*/" && cp data/.gitignore "runs/$*/data/"
	@ln -sfn ../../../data/raw "runs/$*/data/raw" && ln -sfn ../../weights "runs/$*/weights"
	@cd "runs/$*" && { [ -d .dvc ] || dvc init --quiet --no-scm; } && dvc cache dir ../../.dvc/cache && dvc repro
	@rm -rf "data/report/$*"; [ ! -e "runs/$*/data/report/settings/studies.md" ] || cp -RL "runs/$*/data/report/settings" "data/report/$*"
	@for kind in md csv; do cp "runs/$*/data/report/table.$$kind" "data/report/$*.$$kind"; done
	@cp "runs/$*/data/report/index.html" "data/report/$*.html" && cat "data/report/$*.md"

PRESET ?=
params: setup          ## a preset's changes written into params.yaml: make params PRESET=kitti, or a file of your own
	@[ -n "$(PRESET)" ] || { echo "make params PRESET=… is one of: $(PRESETS), or the path of a file" >&2; exit 1; }
	@python -m pipeline.sections.preset "$(PRESET)" --out params.yaml

test: setup            ## all tests on all cores, with coverage of all that runs; pytest -m "not slow": the quick ones
	OMP_NUM_THREADS=1 pytest -n "$$(nproc)" --dist loadfile --no-loadscope-reorder --cov --cov-report=term:skip-covered --cov-fail-under=98

# Scans: STEER_KITTI=/path/to/kitti, or ../shared/kitti where it lies; else the sample's clouds, of make demo.
ROWS ?=
bench: setup           ## beside what a user would pick instead: a table, and benchmarks/results.json; ROWS="cluster demo": these
	@STEER_KITTI="$${STEER_KITTI:-$(wildcard ../shared/kitti)}"; [ -n "$$STEER_KITTI" ] && export STEER_KITTI || unset STEER_KITTI; \
	python -m benchmarks.bench $(ROWS) --out benchmarks/results.json

# Recorded files too, of STEER_KITTI=/path/to/kitti, or ../shared/kitti where it lies.
stress: setup          ## damaged files, kills, full disks, as in docs/robustness.md: 30 min
	@kitti="$${STEER_KITTI:-$(wildcard ../shared/kitti)}"; OMP_NUM_THREADS=1 python -m benchmarks.stress $${kitti:+--kitti "$$kitti"} --trials 400
	OMP_NUM_THREADS=1 python -m tests.kills 50
	OMP_NUM_THREADS=1 unshare --map-root-user --mount python -m tests.disks 0 0.5 0.9

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
