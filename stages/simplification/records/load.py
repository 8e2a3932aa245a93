"""Loading of collapse records from files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.simplification.codes import SIMPLIFY_RECORD_INVALID
from scanloom.stages.simplification.records.archive import Arrays, parse_json_object, read_arrays
from scanloom.stages.simplification.records.mesh_serialization import deserialize_mesh
from scanloom.stages.simplification.records.record import FORMAT_VERSION, CollapseRecord
from scanloom.stages.simplification.records.record_validation import validate_record
from scanloom.stages.simplification.records.wedge_serialization import deserialize_wedges
from scanloom.stages.surface.mesh import validate_mesh

_REQUIRED_ARRAYS = ("mesh/vertices", "mesh/triangles", "removed", "survivor", "path", "lock")
# Exceptions that arrays of an invalid record cause.
_INVALID_ERRORS = (AttributeError, IndexError, KeyError, OverflowError, RecursionError, TypeError, ValueError)


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
        metadata = parse_json_object(arrays["about"])
        missing = [name for name in _REQUIRED_ARRAYS if name not in arrays]
        if missing:
            raise InputError(
                SIMPLIFY_RECORD_INVALID, "is damaged: {missing} is missing.", path, missing=missing[0]
            )
        record = _build_record(arrays, metadata, path)
    except _INVALID_ERRORS as error:
        raise InputError(
            SIMPLIFY_RECORD_INVALID, "is damaged, or not a collapse record ({error}).", path, error=error
        ) from error
    validate_record(record, path)
    return record


def _build_record(arrays: Arrays, metadata: dict[str, Any], path: Path) -> CollapseRecord:
    wedges = None
    if "wedges" in metadata:
        wedges = deserialize_wedges(_select_group(arrays, "wedges/"), metadata["wedges"])
    mesh = validate_mesh(deserialize_mesh(_select_group(arrays, "mesh/"), metadata["mesh"]), str(path))
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


def _select_group(arrays: Arrays, prefix: str) -> Arrays:
    return {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}
