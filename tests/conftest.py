"""Fixtures and settings of all tests."""

import gc
import os
import signal
from pathlib import Path

import pytest
from hypothesis import settings

# Set before NumPy is loaded, here and in every child process: OpenBLAS threads otherwise spin for 20 ms after
# each product and slow other tests down. 2⁴ turns is the minimum and changes no result.
os.environ.setdefault("OPENBLAS_THREAD_TIMEOUT", "4")

# CI draws the same examples in every run; elsewhere Hypothesis tries new examples.
settings.register_profile("ci", derandomize=True)
if os.environ.get("CI"):
    settings.load_profile("ci")

# Background processes of scripts ignore Ctrl-C, and so do their children. Tests of Ctrl-C need the default
# handler.
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


TESTS = Path(__file__).parent

# Slow tests that also run in `make test`: golden files, cache keys, commands, and textured models.
IN_EVERY_RUN = (
    "cli",
    "golden",
    "pipeline/test_keys.py",
    "pipeline/test_one_change.py",
    "stages/simplification/test_textured.py",
    "stages/texturing/test_bake_materials.py",
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark tests with real scans as slow, and slow tests that rarely fail as thorough."""
    for item in items:
        has_real_scans = "shared_data" in getattr(item, "fixturenames", ())
        if has_real_scans:
            item.add_marker(pytest.mark.slow)
        place = item.path.relative_to(TESTS)
        is_in_every_run = any(place.is_relative_to(one) for one in IN_EVERY_RUN)
        is_in_every_run &= not has_real_scans and place.name != "test_memory.py"
        if item.get_closest_marker("slow") is not None and not is_in_every_run:
            item.add_marker(pytest.mark.thorough)


def pytest_collection_finish() -> None:
    """Exclude all existing objects (thousands of tests and modules) from garbage collection."""
    gc.freeze()


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Get the folder of real scans next to the checkout, or skip the test if it does not exist."""
    folder = Path(__file__).resolve().parents[2] / "shared" / "data"
    if not folder.is_dir():
        pytest.skip("the real scans are not beside this checkout")
    return folder
