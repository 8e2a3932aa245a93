"""Files of version 1, which were two formats: one for collapses of vertices, one for those with wedges."""

from __future__ import annotations

from typing import Any

import numpy as np

from stages.simplification.records.archive import Arrays, json_object

# What names the format, and holds its version.
WITH_WEDGES = "scanloom_seam_record"

_OF_MESH = ("vertices", "triangles", "colors", "normals", "corner_normals", "part_ids", "uvs", "material_ids")
_OF_WEDGES = {
    "wedge_removed": "removed",
    "wedge_survivor": "survivor",
    "wedge_when": "when",
    **{name: name for name in ("changed", "changed_to", "changed_source", "changed_when")},
    **{name: name for name in ("corner_wedge", "corner_vertex", "origin", "positions", "columns")},
}
_OF_MESH_IN_WORDS = ("part_names", "images", "materials")


def as_version_2(arrays: Arrays) -> tuple[Arrays, dict[str, Any]]:
    """Return the arrays of a file of version 1 as version 2 names them, and what that says about them.

    Raises
    ------
    KeyError, ValueError, RecursionError
        If the words of the file are missing, or not its JSON.
    """
    names = {name: f"mesh/{name}" for name in arrays if name in _OF_MESH or name.startswith("image_")}
    if WITH_WEDGES not in arrays:
        return {names.get(name, name): array for name, array in arrays.items()}, {"mesh": {}}
    names |= {name: f"wedges/{new}" for name, new in _OF_WEDGES.items()} | {"places": "path"}
    found = {names.get(name, name): array for name, array in arrays.items()}
    # It did not tell which vertices were locked; nothing but a fit asks, and with wedges there is none.
    if "vertices" in arrays:
        found["lock"] = np.zeros(arrays["vertices"].shape[:1], bool)
    words = json_object(arrays["words"])
    of_mesh = {name: words.pop(name) for name in _OF_MESH_IN_WORDS if name in words}
    return found, {"mesh": of_mesh, "wedges": words}
