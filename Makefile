# make demo: set up and run the pipeline on a sample scan.  make test: set up and check everything that often breaks.
# make check: before every commit.  make test-all: what is slow and rarely fails, too.  CONTRIBUTING.md says more.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
COMPILERS := $(VENV)/.compilers
DEPENDENCIES := $(VENV)/.dependencies
KERNELS := $(VENV)/.kernels
STUBS_FIT := $(VENV)/.stubs-fit
# Tests wait for processes, browsers and each other: three at a time keep two cores busy.
WORKERS ?= $(shell $(PYTHON) -c "import os; print(-(-3 * os.cpu_count() // 2))")
KERNEL_SOURCES := $(shell find kernels/src -name '*.rs') kernels/Cargo.toml kernels/Cargo.lock
# Tests start hundreds of Pythons: what they compile of our sources is kept, whatever the surroundings say.
unexport PYTHONDONTWRITEBYTECODE

# Links to the packages under their installed names, `scanloom.stages` and so on: mypy does not follow `__path__`.
TYPES := build/types/scanloom
PACKAGE_LINKS := $(addprefix $(TYPES)/,stages pipeline cli)

# Where npm puts what pages are made of and checked with; its own list there is written last.
PAGE := pipeline/report/page
PACKAGES := $(PAGE)/node_modules/.package-lock.json

# The site of docs/, which opens from the disk: build/docs/index.html.
SITE := build/docs

.PHONY: docs page browser packages demo check test suite test-all campaign bench format lint python-lint ruff mypy mypy-windows stubtest clippy clippy-benches rust-tests collected clean

# pip names every package that it fetches, and says every minute that the kernels are being compiled.
demo:
	@echo "Step 1 of 2: install the Python packages (about 3 GB in .venv) and compile the kernels, side by side. This takes"
	@echo "minutes, the first time only."
	@$(MAKE) --no-print-directory --jobs=2 PIP_OUTPUT=--progress-bar=off $(READY)
	@echo "Step 2 of 2: turn the sample scan into a mesh."
	$(BIN)/scanloom run samples/rgbd -o demo/rgbd
	@echo
	@echo "The mesh is demo/rgbd/textured.glb (and simplified.ply), the figures demo/rgbd/report.json, the pictures demo/rgbd/pictures/."

check: lint
	$(BIN)/pytest --quiet -m "not slow" $(QUICK)

# Imports, messages and names: what most changes break.
QUICK := tests/test_imports.py tests/docs/test_diagnostics.py tests/docs/test_keywords.py tests/test_import_name.py tests/stages/test_package.py tests/pipeline/test_versions.py

# What needs no Python, and what is only fetched, goes on while the kernels are compiled. A machine with nothing prepared
# compiles them for the tests alone: to optimise them together with the crates they use takes minutes, and changes no
# result. In several pieces they would be compiled sooner, but distances to triangles take two and a half times as long.
test: export CARGO_PROFILE_RELEASE_LTO = off
test: export CARGO_PROFILE_RELEASE_CODEGEN_UNITS = 1
# Rust's tests are compiled but once there: half of the work is saved where no piece is kept for the next time, none is
# optimised across others, and lines are told by what fails alone.
test: export CARGO_INCREMENTAL = 0
test: export CARGO_PROFILE_TEST_LTO = off
test: export CARGO_PROFILE_TEST_CODEGEN_UNITS = 2
test: export CARGO_PROFILE_TEST_DEBUG = 0
# The kernels take longest and keep one core busy: they start first, and everything that works without them runs beside,
# on what they leave.
BESIDE := nice
test:
	@$(MAKE) --no-print-directory --jobs=3 --output-sync=target \
	  $(KERNELS) $(DEPENDENCIES) rust-tests clippy mypy ruff browser packages
	@$(MAKE) --no-print-directory --jobs=2 --output-sync=target collected stubtest
	@$(MAKE) --no-print-directory suite

suite: $(READY)
	$(BIN)/pytest -n $(WORKERS) --dist worksteal --quiet -m "not thorough"

# Real scans, wheels, the documentation site, simulated clusters and systems, benches, kills and random damage.
test-all: test mypy-windows clippy-benches
	$(BIN)/pytest -n $(WORKERS) --dist worksteal --quiet -m thorough

# Tests of pages need Chromium, best without the parts that draw windows: with them each start takes seconds. Where it
# cannot be had, they say so: CI fails then, a developer's run skips them. After the compilers, because the system's
# packages are installed one at a time.
browser: | $(COMPILERS)
	@command -v chromium-headless-shell >/dev/null || { \
	  if [ "$$(id -u)" = 0 ]; then root=; else root="sudo -n"; fi; \
	  get="$$root env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends"; \
	  $$root apt-get update -qq && { $$get chromium-headless-shell || $$get chromium; } >/dev/null; \
	} || command -v chromium >/dev/null || \
	  echo "Chromium is missing and cannot be installed from here; on Debian: apt-get install chromium-headless-shell"

packages:
	@if command -v npm >/dev/null; then $(MAKE) --no-print-directory $(PACKAGES); \
	else echo "npm is missing: tests of pages and tiles need Node 20 or later; on Debian: apt-get install npm"; fi

$(PACKAGES): $(PAGE)/package-lock.json
	cd $(PAGE) && npm ci --ignore-scripts --no-audit --no-fund --loglevel=error
	@touch $@

# The libraries of pages as one file, and their licences. After: npm install NAME@VERSION there, and git diff.
page: $(PACKAGES)
	cd $(PAGE) && node build.mjs

# Half-built pages are no use: all is made anew, and a link that leads nowhere ends it.
docs: $(READY)
	rm -rf $(SITE)
	$(BIN)/python -m sphinx --fail-on-warning --keep-going --quiet -c docs -d build/docs-trees . $(SITE)
	@echo "The site is $(SITE)/index.html."

# Random damage, kills and meshes for some minutes: make campaign MINUTES=60, with WORDS for its other options.
MINUTES ?= 10
campaign: $(READY)
	PYTHONPATH=.:tests/made $(BIN)/python -m tests.campaign --minutes $(MINUTES) $(WORDS)

# Each is one core's work for most of its time, so they run side by side.
lint: python-lint clippy

# Compiles whatever tests import, once; workers, which begin together, would all do it. They tell what is wrong, too.
collected: $(READY)
	@$(BIN)/pytest --collect-only -qq >/dev/null || true

python-lint: $(READY)
	@$(MAKE) --no-print-directory --jobs --output-sync=target ruff mypy stubtest

ruff: | $(DEPENDENCIES)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

mypy: $(PACKAGE_LINKS) | $(DEPENDENCIES)
	$(BESIDE) $(BIN)/mypy

$(PACKAGE_LINKS):
	@mkdir -p $(TYPES)
	@ln -sfn ../../../$(@F) $@

# What the Python of Windows lacks is an error there.
mypy-windows: $(READY) $(PACKAGE_LINKS)
	$(BIN)/mypy --platform win32 --cache-dir .mypy_cache/windows

# When one of both sides has changed. With the settings of mypy it would spoil mypy's cache.
stubtest: $(STUBS_FIT)
$(STUBS_FIT): stages/_kernels.pyi $(READY) | $(PACKAGE_LINKS)
	MYPYPATH=build/types $(BIN)/python -m mypy.stubtest scanloom.stages._kernels
	@touch $@

clippy: | $(COMPILERS)
	cd kernels && cargo fmt --check
	cd kernels && MAKEFLAGS= $(BESIDE) cargo clippy --locked --quiet --tests --features python -- -D warnings

clippy-benches: | $(COMPILERS)
	cd kernels && MAKEFLAGS= cargo clippy --locked --quiet --benches --features python,bench -- -D warnings

rust-tests: | $(COMPILERS)
	cd kernels && MAKEFLAGS= $(BESIDE) cargo test --locked --quiet --lib

bench:
	cd kernels && cargo bench --locked --features bench -- $(BENCH)

format: $(READY)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .
	cd kernels && cargo fmt

$(COMPILERS):
	@command -v cargo >/dev/null || { echo "cargo is missing: the mesh kernels are built with Rust 1.89 or later."; exit 1; }
	@command -v c++ >/dev/null || { \
	  echo "Installing the C++ compiler"; \
	  if [ "$$(id -u)" = 0 ]; then root=; else root="sudo -n"; fi; \
	  $$root apt-get update -qq && $$root apt-get install -y -qq --no-install-recommends g++ >/dev/null; \
	} || { echo "c++ is missing: the kernels include a library in C++. On Debian: apt-get install g++"; exit 1; }
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV) || { echo "On Debian: apt-get install python3-venv"; exit 1; }
	@touch $@

# Most of what is installed is never imported: Python compiles the rest when it is.
PIP_OUTPUT ?= --quiet
PIP := $(BIN)/python -m pip install $(PIP_OUTPUT) --disable-pip-version-check --no-compile

$(DEPENDENCIES): pyproject.toml packaging/list_requirements.py | $(COMPILERS)
	@echo "Installing the Python packages that scanloom needs"
	@$(BIN)/python packaging/list_requirements.py > $(VENV)/requirements.txt
	@$(PIP) --requirement $(VENV)/requirements.txt
	@touch $@

# Installing compiles the kernels. Without dependencies, so that both run side by side.
$(KERNELS): pyproject.toml $(KERNEL_SOURCES) | $(COMPILERS)
	@echo "Compiling the kernels; this takes minutes"
	@$(PIP) --no-deps --editable .
	@touch $@

$(READY): $(DEPENDENCIES) $(KERNELS)
	@touch $@

clean:
	rm -rf $(VENV) demo kernels/target
