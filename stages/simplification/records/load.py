"""Loading of collapse records from files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.simplification.codes import SIMPLIFY_RECORD_INVALID
from scanloom.stages.simplification.records.archive import Arrays, json_object, read_arrays
from scanloom.stages.simplification.records.record import FORMAT_VERSION, CollapseRecord
from scanloom.stages.simplification.records.sound import require_sound
from scanloom.stages.simplification.records.stored_mesh import mesh_of
from scanloom.stages.simplification.records.stored_wedges import wedges_of
from scanloom.stages.surface.mesh import validated

_NEEDED = ("mesh/vertices", "mesh/triangles", "removed", "survivor", "path", "lock")
# Exceptions that arrays of an invalid record cause.
_STRANGE = (AttributeError, IndexError, KeyError, OverflowError, RecursionError, TypeError, ValueError)


def load_record(path: Path | str) -> CollapseRecord:
    """Read a record that `CollapseRecord.save` wrote.

    Raises
    ------
    InputError
        If the file is missing, damaged, no record, or of another version.
    """
    path = Path(path)
    arrays = read_arrays(path)
    version = arrays.get("scanloom_collapse_record")
    if version is None:
        raise InputError(SIMPLIFY_RECORD_INVALID, "is not a collapse record.", path)
    if version.shape != () or version != FORMAT_VERSION:
        raise InputError(
            SIMPLIFY_RECORD_INVALID,
            "is a record of version {version}; this scanloom reads version {format_version}.",
            path,
            version=version,
            format_version=FORMAT_VERSION,
        )
    try:
        about = json_object(arrays["about"])
        missing = [name for name in _NEEDED if name not in arrays]
        if missing:
            raise InputError(
                SIMPLIFY_RECORD_INVALID, "is damaged: {missing} is missing.", path, missing=missing[0]
            )
        record = _record_of(arrays, about, path)
    except _STRANGE as error:
        raise InputError(
            SIMPLIFY_RECORD_INVALID, "is damaged, or not a collapse record ({error}).", path, error=error
        ) from error
    require_sound(record, path)
    return record


def _record_of(arrays: Arrays, about: dict[str, Any], path: Path) -> CollapseRecord:
    wedges = None
    if "wedges" in about:
        wedges = wedges_of(_group(arrays, "wedges/"), about["wedges"])
    mesh = validated(mesh_of(_group(arrays, "mesh/"), about["mesh"]), str(path))
    return CollapseRecord(
        mesh,
        removed=arrays["removed"],
        survivor=arrays["survivor"],
        path=arrays["path"],
        lock=arrays["lock"],
        vertex_source=arrays.get("vertex_source"),
        triangle_source=arrays.get("triangle_source"),
        wedges=wedges,
    )


def _group(arrays: Arrays, prefix: str) -> Arrays:
    return {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}
