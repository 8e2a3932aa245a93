"""Fixtures every room's tests share."""

import gc
import os
import signal
from pathlib import Path

import pytest
from hypothesis import settings

# Before NumPy is loaded, here and in every child: between two products the threads of OpenBLAS otherwise spin
# for some 20 ms, which other tests could use. 2⁴ turns, the least, change no result.
os.environ.setdefault("OPENBLAS_THREAD_TIMEOUT", "4")

# What decides whether a change lands draws the same examples every time; elsewhere new ones are tried.
settings.register_profile("ci", derandomize=True)
if os.environ.get("CI"):
    settings.load_profile("ci")

# Started in the background of a script, Ctrl-C is ignored, here and in every child; tests of it need it.
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


TESTS = Path(__file__).parent

# Slow tests that `make test` also runs: golden files, cache keys, commands, and textured models.
IN_EVERY_RUN = (
    "cli",
    "golden",
    "pipeline/test_keys.py",
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
    """Leave all that is there by now, thousands of tests and modules, out of every search for garbage."""
    gc.freeze()


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of real scans beside the checkout; the test is skipped where it is absent."""
    folder = Path(__file__).resolve().parents[2] / "shared" / "data"
    if not folder.is_dir():
        pytest.skip("the real scans are not beside this checkout")
    return folder
