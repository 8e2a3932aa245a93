# make demo: set up and run the pipeline on a sample scan.  make test: set up and run every check.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/.ready
KERNEL_SOURCES := $(shell find kernels/src -name '*.rs') kernels/Cargo.toml kernels/Cargo.lock

.PHONY: demo test rust-checks python-checks clean

demo: $(READY)
	$(BIN)/scanloom run samples/rgbd -o demo/rgbd
	@echo
	@echo "The mesh is demo/rgbd/simplified.ply, the figures demo/rgbd/report.json, the pictures demo/rgbd/pictures/."

test: $(READY) rust-checks python-checks
	$(BIN)/pytest -n auto --dist worksteal

rust-checks:
	cd kernels && cargo fmt --check
	cd kernels && cargo clippy --locked --all-targets --features python -- -D warnings
	cd kernels && cargo test --locked --quiet

python-checks: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/python -m mypy.stubtest --mypy-config-file pyproject.toml stages._kernels

# Installing is what compiles the kernels; a changed source or dependency list installs again.
$(READY): pyproject.toml $(KERNEL_SOURCES)
	@command -v cargo >/dev/null || { echo "cargo is missing: the mesh kernels are built with Rust 1.86 or later."; exit 1; }
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV) || { echo "On Debian: apt-get install python3-venv"; exit 1; }
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	@touch $@

clean:
	rm -rf $(VENV) demo kernels/target
