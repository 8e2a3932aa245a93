import importlib.util
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

_TOY = Path(__file__).with_name("toy.py")


@pytest.fixture(scope="session")
def toy() -> ModuleType:
    """Import the pipeline of three quick stages in toy.py."""
    spec = importlib.util.spec_from_file_location("toy", _TOY)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["toy"] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def scan(toy: ModuleType, tmp_path: Path) -> Path:
    """Write a small scan folder for the toy pipeline."""
    return toy.write_scan(tmp_path / "scan")


@pytest.fixture
def warnings() -> Iterator[list[str]]:
    """Collect the diagnostics of the test as texts."""
    # Imported here because some tests change the platform before the import.
    from scanloom.stages.diagnostics.collector import listen_to_diagnostics

    said: list[str] = []
    with listen_to_diagnostics(lambda one: said.append(str(one))):
        yield said


@pytest.fixture
def cache(tmp_path: Path, warnings: list[str]) -> Any:  # noqa: ARG001
    # Imported here because some tests change the platform before the import.
    from scanloom.pipeline.cache.store import Cache

    return Cache(tmp_path / "cache")
