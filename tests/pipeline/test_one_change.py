"""A run that differs in one thing has the same results from the cache as from nothing: a sample."""

from pathlib import Path

import pytest
from changed_runs import ONE_SCAN, WITH_FILES, Bases, Trial, check_parameter, compare_copy

from scanloom.pipeline.run.run import CACHE_VARIABLE, run

pytestmark = pytest.mark.slow


@pytest.fixture(autouse=True)
def _no_shared_cache(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(CACHE_VARIABLE, raising=False)


@pytest.fixture(scope="module")
def bases(tmp_path_factory: pytest.TempPathFactory) -> Bases:
    return Bases(tmp_path_factory.mktemp("bases"))


@pytest.mark.parametrize("key", ["scan.check_poses", "adjust.enabled", "fuse.radius"])
def test_another_parameter(key: str, bases: Bases, tmp_path: Path) -> None:
    assert check_parameter(key, ONE_SCAN, bases, tmp_path)


@pytest.mark.parametrize("trial", [ONE_SCAN, WITH_FILES], ids=["scan", "with files"])
def test_a_scan_at_another_path_is_not_computed_again(trial: Trial, bases: Bases, tmp_path: Path) -> None:
    cached = compare_copy(trial, bases, tmp_path)
    outcomes = run(bases.get_scan(trial), bases.get_results(trial, ()), bases.configure(trial)).stages
    assert cached == [one.stage for one in outcomes]


def test_another_depth_image_of_equal_size_and_time(bases: Bases, tmp_path: Path) -> None:
    assert "fuse" not in compare_copy(WITH_FILES, bases, tmp_path, "depth-0.png")
