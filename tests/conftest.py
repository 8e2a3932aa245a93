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


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Count every test with real scans among the slow ones."""
    for item in items:
        if "shared_data" in getattr(item, "fixturenames", ()):
            item.add_marker(pytest.mark.slow)


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
