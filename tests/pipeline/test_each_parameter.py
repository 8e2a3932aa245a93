"""A run that differs in one thing has the same results from the cache as from nothing: everything."""

import shutil
from collections.abc import Mapping
from pathlib import Path

import pytest
from changed_runs import (
    ALL_STAGES,
    ONE_SCAN,
    WITH_FILES,
    Bases,
    Trial,
    check_parameter,
    compare_copy,
    compare_runs,
    list_keys,
    write_ball,
    write_pairs,
    write_unposed,
    write_views,
)
from small_sample import write_small_sample

from scanloom.pipeline.config import Config
from scanloom.pipeline.run.run import CACHE_VARIABLE
from scanloom.stages.scans.model.threads import THREADS_VARIABLE

pytestmark = pytest.mark.slow

WITH_ALL_STAGES = Trial(write_ball, ALL_STAGES)
TRIALS: Mapping[str, tuple[Trial, ...]] = {
    "scan": (ONE_SCAN, Trial(write_pairs)),
    "depth": (Trial(write_pairs), Trial(write_views)),
    "register": (Trial(write_unposed, ("texture.enabled=false",)),),
    "adjust": (Trial(write_small_sample, ("texture.enabled=false",)),),
    "fuse": (WITH_ALL_STAGES, ONE_SCAN),
    "photos": (Trial(write_ball, ("texture.images={scan}",)),),
    "bake": (WITH_ALL_STAGES,),
    "remesh": (WITH_ALL_STAGES,),
    "lod": (WITH_ALL_STAGES,),
    "tiles": (WITH_ALL_STAGES,),
    "coverage": (WITH_ALL_STAGES,),
}
# Parameters that no value of is accepted in these scans: they need tags, confidence maps or several units.
MIN_CHECKED_RATIO = 0.7


@pytest.fixture(autouse=True)
def _no_shared_cache(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(CACHE_VARIABLE, raising=False)


@pytest.fixture(scope="module")
def bases(tmp_path_factory: pytest.TempPathFactory) -> Bases:
    return Bases(tmp_path_factory.mktemp("bases"))


@pytest.mark.parametrize("section", Config.get_types())
def test_each_other_parameter(section: str, bases: Bases, tmp_path: Path) -> None:
    keys, checked = list_keys(section), set()
    for trial in TRIALS.get(section, (ONE_SCAN,)):
        checked |= {key for key in keys if check_parameter(key, trial, bases, tmp_path)}
    assert len(checked) > MIN_CHECKED_RATIO * len(keys), {*keys} - checked


@pytest.mark.parametrize("trial", [WITH_FILES, Trial(write_pairs)], ids=["with files", "pairs"])
def test_each_other_file_of_equal_size_and_time(trial: Trial, bases: Bases, tmp_path: Path) -> None:
    scan = bases.get_scan(trial)
    names = [path.relative_to(scan).as_posix() for path in sorted(scan.rglob("*")) if path.is_file()]
    assert len(names) >= 6
    for number, name in enumerate(names):
        folder = tmp_path / str(number)
        cached = compare_copy(trial, bases, folder, name)
        assert "report" not in cached, f"{name} has no effect"
        shutil.rmtree(folder)


def test_another_number_of_threads(bases: Bases, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    results = bases.get_results(WITH_ALL_STAGES, ())
    monkeypatch.setenv(THREADS_VARIABLE, "1")
    config = bases.configure(WITH_ALL_STAGES, "simplify.threads=1", "remesh.threads=1", "lod.threads=1")
    cached = compare_runs(bases.get_scan(WITH_ALL_STAGES), results, tmp_path, config)
    assert "lod" in cached
