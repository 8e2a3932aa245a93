"""Changed members of a record: one error, or a replayed mesh."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from collapse_records import KINDS, load_arrays, save_record

from scanloom.stages.diagnostics.errors import ScanloomError
from scanloom.stages.simplification.records.load import load_record
from scanloom.stages.surface.mesh import validate_mesh

SEEDS = range(25)


def damage_array(array: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Change some or all values of an array to others of its type."""
    if array.size == 0 or array.ndim == 0:
        return array
    array = array.copy()
    flat = array.reshape(-1)
    count = int(rng.choice([1, 2, len(flat) // 4 + 1]))
    rows = rng.integers(0, len(flat), count)
    kind = rng.integers(4)
    if kind == 0:
        flat[rows] = flat[rng.permutation(rows)]
    elif kind == 1:
        array = array[rng.permutation(len(array))]
    elif array.dtype.kind == "f":
        flat[rows] = rng.choice([1e300, -1e300, 1e154, 1e61, 1e38, 1e-300, 0.0, np.nan, np.inf])
    elif array.dtype.kind == "b":
        flat[rows] = ~flat[rows]
    elif kind == 2:
        flat[rows] = rng.integers(0, max(int(flat.max()), 0) + 1, count)
    else:
        flat[rows] = np.iinfo(array.dtype).max if rng.integers(2) else np.iinfo(array.dtype).min
    return array


def replay_file(path: Path, **how: Any) -> str:
    try:
        validate_mesh(load_record(path).replay(**how).mesh)
    except ScanloomError as error:
        return str(error)
    return "replayed"


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_changed_members_are_refused_or_replayed(tmp_path: Path, kind: str) -> None:
    whole = load_arrays(save_record(kind, tmp_path))
    names = [name for name, array in whole.items() if array.dtype.kind in "iufb"]
    path = tmp_path / "changed.npz"
    outcomes = []
    for seed in SEEDS:
        rng = np.random.default_rng(seed)
        arrays: dict[str, Any] = dict(whole)
        for name in rng.choice(names, rng.integers(1, 3)):
            arrays[name] = damage_array(arrays[name], rng)
        np.savez(path, **arrays)
        outcomes += [replay_file(path), replay_file(path, collapses=5), replay_file(path, fit=True)]
    assert all("\n" not in text for text in outcomes)
    assert "replayed" in outcomes
    assert any("changed.npz: " in text for text in outcomes)
