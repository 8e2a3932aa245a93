"""The collapses of method `seams`, kept so that any of its intermediate meshes can be had again."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stages.errors import InputError, UsageError
from stages.files.replacing import replacing
from stages.params import resolve
from stages.simplification.records.steps import Replayed, ReplayParams, Steps, roots
from stages.simplification.seams.attributes import Ids, SeamAttributes, SeamState
from stages.surface.mesh import Mesh, validated
from stages.surface.texture import Image, Material, Texture

# What the kernel records; the names are those of the fields of SeamRecord.
LOGGED = (
    "removed",
    "survivor",
    "places",
    "wedge_removed",
    "wedge_survivor",
    "wedge_when",
    "changed",
    "changed_to",
    "changed_source",
    "changed_when",
    "corner_wedge",
    "corner_vertex",
)

_FORMAT = 1
_SCALES = ("uv_scale", "color_scale", "normal_scale", "has_uvs", "has_colors", "has_normals")


@dataclass(frozen=True, eq=False)
class SeamRecord:
    """All collapses of one run of `simplify` with method `seams`.

    A progressive mesh (Hoppe 1996) with wedges (Hoppe 1999). Vertices and wedges have numbers of their own,
    `corner_vertex` and `corner_wedge` (3 t,) of each corner of the input; −1 in triangles without area, which
    were left out.

    Attributes
    ----------
    mesh : the input.
    attributes : what its corners carry, and where its vertices are.
    removed, survivor, places : (m,), (m,) int32 and (m, 3) float64, for each collapse the vertex that
        vanished, the one it went into, and where that went, from the origin of the attributes.
    wedge_removed, wedge_survivor, wedge_when : (w,) int32, wedges that became part of others, and in which
        collapse.
    changed, changed_to, changed_source, changed_when : (c, …), wedges that took other attributes, which, the
        corner of the input that has the same (−1 for none), and in which collapse.
    """

    mesh: Mesh
    attributes: SeamAttributes
    removed: Ids
    survivor: Ids
    places: NDArray[np.float64]
    wedge_removed: Ids
    wedge_survivor: Ids
    wedge_when: Ids
    changed: Ids
    changed_to: NDArray[np.float64]
    changed_source: Ids
    changed_when: Ids
    corner_wedge: Ids
    corner_vertex: Ids

    @cached_property
    def _kept(self) -> NDArray[np.int64]:
        """Triangles of the input that were not left out."""
        return np.flatnonzero(self.corner_vertex[::3] >= 0)

    @cached_property
    def _steps(self) -> Steps:
        triangles = self.corner_vertex.reshape(-1, 3)[self._kept]
        return Steps(triangles, int(triangles.max(initial=-1)) + 1, self.removed, self.survivor)

    def triangles_after(self, collapses: int) -> int:
        """Return how many triangles are left after so many collapses."""
        return self._steps.triangles_after(collapses)

    def replay(self, params: ReplayParams | None = None, **changes: Any) -> Replayed:
        """Return the mesh as it was when so many triangles were left, or after so many collapses.

        At the last it equals what `simplify` gave out with `fit=False`, to the bit.

        Raises
        ------
        UsageError
            For fewer triangles or more collapses than the record leads to, and for `fit`, which needs the
            whole run.
        """
        params = resolve(ReplayParams, params, changes)
        if params.fit:
            raise UsageError("a record of method seams cannot be fitted; simplify to that number instead.")
        collapses = self._steps.wanted(params)
        corners = np.flatnonzero(self.corner_vertex >= 0)
        # Backwards, so that of all corners of a vertex or wedge the first one counts.
        first = np.zeros(self._steps.vertices, np.int64)
        first[self.corner_vertex[corners][::-1]] = corners[::-1]
        inputs = self.mesh.triangles.reshape(-1)[first]
        places = self.attributes.positions[inputs] - self.attributes.origin
        places[self.survivor[:collapses]] = self.places[:collapses]
        root = roots(len(places), self.removed[:collapses], self.survivor[:collapses])

        wedges = int(self.corner_wedge.max(initial=-1)) + 1
        source = np.zeros(wedges, np.int64)
        source[self.corner_wedge[corners][::-1]] = corners[::-1]
        values = self.attributes.columns[source]
        until = np.searchsorted(self.changed_when, collapses)
        values[self.changed[:until]] = self.changed_to[:until]
        source[self.changed[:until]] = self.changed_source[:until]
        until = np.searchsorted(self.wedge_when, collapses)
        wedge_root = roots(wedges, self.wedge_removed[:until], self.wedge_survivor[:until])

        left = self._kept[self._steps.ends >= collapses]
        kept_corners = (3 * left[:, None] + np.arange(3)).reshape(-1)
        vertices = root[self.corner_vertex[kept_corners]]
        used = np.unique(vertices)
        wedge = wedge_root[self.corner_wedge[kept_corners]]
        state = SeamState(
            places=places[used],
            triangles=np.searchsorted(used, vertices).reshape(-1, 3).astype(np.int32),
            corners=values[wedge],
            corner_source=source[wedge].astype(np.int32),
            vertex_source=inputs[used].astype(np.int32),
            triangle_source=left.astype(np.int32),
        )
        mesh, vertex_source = self.attributes.as_mesh(self.mesh, state)
        return Replayed(mesh, vertex_source, state.triangle_source, collapses)

    def save(self, path: Path | str) -> None:
        """Write the record, images included, to a file that `load_record` reads, `.npz` by custom.

        Raises
        ------
        StageError
            If the system refuses to write.
        """
        mesh, attributes = self.mesh, self.attributes
        arrays: dict[str, Any] = {
            "scanloom_seam_record": np.array(_FORMAT),
            "vertices": mesh.vertices,
            "triangles": mesh.triangles,
            "colors": mesh.colors,
            "normals": mesh.normals,
            "corner_normals": mesh.corner_normals,
            "part_ids": mesh.part_ids,
            "origin": attributes.origin,
            "positions": attributes.positions,
            "columns": attributes.columns,
            **{name: getattr(self, name) for name in LOGGED},
        }
        words: dict[str, Any] = {
            "part_names": mesh.part_names,
            **{name: getattr(attributes, name) for name in _SCALES},
        }
        if mesh.texture is not None:
            images = mesh.texture.images
            number = {id(image): i for i, image in enumerate(images)}
            arrays |= {"uvs": mesh.texture.uvs, "material_ids": mesh.texture.material_ids}
            arrays |= {f"image_{i}": np.frombuffer(im.file_bytes, np.uint8) for i, im in enumerate(images)}
            words["images"] = [image.name for image in images]
            words["materials"] = [
                [m.name, None if m.image is None else number[id(m.image)], m.base_color, m.wrap]
                for m in mesh.texture.materials
            ]
        arrays["words"] = np.array(json.dumps(words))
        with replacing(Path(path)) as part, part.open("wb") as file:
            np.savez(file, **{name: array for name, array in arrays.items() if array is not None})


def seam_record_of(arrays: dict[str, NDArray[Any]], path: Path) -> SeamRecord:
    """Return the record that the arrays of a file hold.

    Raises
    ------
    InputError
        If they cannot be those of a record of this version.
    """
    version = arrays["scanloom_seam_record"]
    if version.shape != () or version != _FORMAT:
        raise InputError(f"is a record of version {version}; this scanloom reads version {_FORMAT}.", path)
    try:
        words = json.loads(str(arrays["words"]))
        texture = None
        if "uvs" in arrays:
            images = [
                Image(str(name), arrays[f"image_{i}"].astype(np.uint8).tobytes())
                for i, name in enumerate(words["images"])
            ]
            materials = tuple(
                Material(
                    str(name),
                    None if image is None else images[image],
                    None if color is None else (color[0], color[1], color[2], color[3]),
                    (wrap[0], wrap[1]),
                )
                for name, image, color, wrap in words["materials"]
            )
            texture = Texture(arrays["uvs"], arrays["material_ids"], materials)
        mesh = Mesh(
            arrays["vertices"],
            arrays["triangles"],
            arrays.get("colors"),
            arrays.get("normals"),
            texture,
            arrays.get("corner_normals"),
            arrays.get("part_ids"),
            tuple(map(str, words["part_names"])),
        )
        attributes = SeamAttributes(
            arrays["origin"],
            arrays["positions"],
            arrays["columns"],
            uv_scale=float(words["uv_scale"]),
            color_scale=float(words["color_scale"]),
            normal_scale=float(words["normal_scale"]),
            has_uvs=bool(words["has_uvs"]),
            has_colors=bool(words["has_colors"]),
            has_normals=bool(words["has_normals"]),
        )
        record = SeamRecord(validated(mesh, str(path)), attributes, **{name: arrays[name] for name in LOGGED})
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise InputError(f"is damaged, or no record of collapses ({error}).", path) from error
    _require_sound(record, path)
    return record


def _require_sound(record: SeamRecord, path: Path) -> None:
    """Refuse a record whose collapses cannot have taken place on its mesh."""
    corners, collapses = 3 * len(record.mesh.triangles), len(record.removed)
    attributes, columns = record.attributes, record.attributes.columns.shape[-1]
    wanted = 2 + 3 * attributes.has_colors + 3 * attributes.has_normals
    merged, changed = len(record.wedge_removed), len(record.changed)
    shapes: dict[str, tuple[NDArray[Any], type, tuple[int, ...]]] = {
        "origin": (attributes.origin, np.float64, (3,)),
        "positions": (attributes.positions, np.float64, record.mesh.vertices.shape),
        "columns": (attributes.columns, np.float64, (corners, wanted)),
        "removed": (record.removed, np.int32, (collapses,)),
        "survivor": (record.survivor, np.int32, (collapses,)),
        "places": (record.places, np.float64, (collapses, 3)),
        "wedge_removed": (record.wedge_removed, np.int32, (merged,)),
        "wedge_survivor": (record.wedge_survivor, np.int32, (merged,)),
        "wedge_when": (record.wedge_when, np.int32, (merged,)),
        "changed": (record.changed, np.int32, (changed,)),
        "changed_to": (record.changed_to, np.float64, (changed, columns)),
        "changed_source": (record.changed_source, np.int32, (changed,)),
        "changed_when": (record.changed_when, np.int32, (changed,)),
        "corner_wedge": (record.corner_wedge, np.int32, (corners,)),
        "corner_vertex": (record.corner_vertex, np.int32, (corners,)),
    }
    for name, (array, kind, shape) in shapes.items():
        if array.dtype != kind or array.shape != shape or not np.isfinite(array).all():
            raise InputError(f"is damaged: {name} is {array.dtype} of shape {array.shape}.", path)
    left_out = record.corner_vertex.reshape(-1, 3) < 0
    vertices, wedges = (int(ids.max(initial=-1)) + 1 for ids in (record.corner_vertex, record.corner_wedge))
    within = {
        "removed": (record.removed, 0, vertices),
        "survivor": (record.survivor, 0, vertices),
        "wedge_removed": (record.wedge_removed, 0, wedges),
        "wedge_survivor": (record.wedge_survivor, 0, wedges),
        "changed": (record.changed, 0, wedges),
        "changed_source": (record.changed_source, -1, corners),
        "corner_vertex": (record.corner_vertex, -1, corners),
        "corner_wedge": (record.corner_wedge, -1, corners),
    }
    for name, (ids, low, end) in within.items():
        if len(ids) and not (ids.min() >= low and ids.max() < end):
            raise InputError(f"is damaged: {name} names what is not there.", path)
    in_order = all((np.diff(when) >= 0).all() for when in (record.wedge_when, record.changed_when))
    whole = (left_out == left_out[:, :1]).all() and (record.corner_wedge[~left_out.reshape(-1)] >= 0).all()
    if not (in_order and whole and _is_forest(record.removed, record.survivor, vertices)):
        raise InputError("is damaged: its collapses cannot follow each other.", path)
    if not _is_forest(record.wedge_removed, record.wedge_survivor, wedges):
        raise InputError("is damaged: a wedge is gone already when it takes in another.", path)


def _is_forest(removed: Ids, survivor: Ids, count: int) -> bool:
    """Return whether everything is removed once, and into what is still there."""
    steps = np.arange(len(removed))
    when = np.full(count, len(removed))
    when[removed] = steps
    return bool(((when[removed] == steps) & (when[survivor] > steps)).all())
