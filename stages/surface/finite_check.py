"""Check that coordinates are finite, on input and before writing."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import MeshError
from scanloom.stages.surface.codes import MESH_COORDINATES_TOO_LARGE, MESH_NOT_FINITE

# Maximum of formats that store single precision only: glTF, STL, USD.
FLOAT32_MAX = float(np.finfo(np.float32).max)

NamedArray = tuple[str, NDArray[Any] | None]


def _has_finite_sum(array: NDArray[Any]) -> bool:
    # Faster than a mask. A sum is finite only if all terms are finite.
    with np.errstate(over="ignore", invalid="ignore"):
        return bool(np.isfinite(array.sum()))


def require_finite(
    arrays: Iterable[NamedArray], where: Path | str, remedy: str, limit: float = np.inf
) -> None:
    """Raise MeshError for the first row that is not finite or exceeds a limit.

    Parameters
    ----------
    arrays : pairs of a row name ("vertex") and rows (n, …); None for data that the mesh does not have.
    where : file or argument that begins the message.
    remedy : end of the message: consequence and remedy.
    limit : maximum absolute value.
    """
    for name, array in arrays:
        if array is None or (limit == np.inf and _has_finite_sum(array)):
            continue
        is_good = np.isfinite(array) & (np.abs(array) <= limit)
        if is_good.all():
            continue
        bad = np.flatnonzero(~is_good.reshape(len(array), -1).all(axis=1))
        row = array[bad[0]]
        values = row.tolist()
        if not np.isfinite(row).all():
            raise MeshError(
                MESH_NOT_FINITE,
                "{name} {bad} is {values}, not finite ({bad_count:,} such)",
                where,
                remedy=remedy,
                name=name,
                bad=bad[0],
                values=values,
                bad_count=len(bad),
            )
        raise MeshError(
            MESH_COORDINATES_TOO_LARGE,
            "{name} {bad} is {values}, beyond single precision ({bad_count:,} such)",
            where,
            remedy=remedy,
            name=name,
            bad=bad[0],
            values=values,
            bad_count=len(bad),
        )
