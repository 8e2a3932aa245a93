"""All frames of a scan, each read once: what they measured of a surface, and of the space around it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stages.errors import InputError
from stages.inspecting.coverage.evidence import Evidence, Measured, Probes, measured_by, probes_of
from stages.inspecting.coverage.nearest import Remembered
from stages.inspecting.coverage.space import Space
from stages.inspecting.coverage.thin import vertex_areas
from stages.inspecting.coverage.views import Floats, View, read_view
from stages.progress import Progress
from stages.scans.prefetch import read_ahead, workers
from stages.scans.scan import Frame, SkippedFrame
from stages.surface.mesh import Mesh
from stages.surface.topology import areas
from stages.surface.vertex_normals import vertex_normals

# Edges of the mesh that a cell of space is wide, where nobody says it.
_CELL_EDGES = 4.0


@dataclass(frozen=True, eq=False)
class Ground:
    """A mesh made ready to be looked at.

    Attributes
    ----------
    origin : (3,) metres, what all coordinates are counted from: single precision is then enough for them.
    vertices, normals : (n, 3) float64, from there on.
    around : (n,) the area around each vertex, m².
    edge : metres, the median of the mesh.
    probes : vertices that stand for those around them.
    space : around the mesh, unknown before a frame is added.
    """

    origin: Floats
    vertices: Floats
    normals: Floats
    around: Floats
    edge: float
    probes: Probes
    space: Space

    @classmethod
    def of(cls, mesh: Mesh, spacing: float | None) -> Ground:
        """Make a mesh ready; `spacing` is that of space, metres, None for what the mesh tells."""
        origin = np.asarray(mesh.vertices.mean(axis=0))
        vertices, normals = mesh.vertices - origin, vertex_normals(mesh)
        ends = vertices[mesh.triangles[:, :2]]
        edge = float(np.median(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)))
        around = vertex_areas(mesh)
        cell = spacing or _CELL_EDGES * edge
        probes = probes_of(vertices, normals, edge, float(around.sum()))
        space = Space(_samples(vertices, mesh, cell / 2), cell)
        return cls(origin, vertices, normals, around, edge, probes, space)


@dataclass(frozen=True, eq=False)
class Seen:
    """What frames have told: of the ground's probes, and of themselves."""

    evidence: Evidence
    frames: list[Remembered]
    skipped: list[SkippedFrame]


def look(ground: Ground, frames: Sequence[Frame], where: Path | None, progress: Progress) -> Seen:
    """Read all frames; what they tell of space is added to the ground's.

    Parameters
    ----------
    where : the scan's folder, for messages.

    Raises
    ------
    InputError
        If none can be used, or none measured the mesh.
    """

    def prepared(frame: Frame) -> tuple[View, Measured] | SkippedFrame:
        try:
            view = read_view(frame, ground.origin)
        except InputError as error:
            return SkippedFrame(frame.name, str(error))
        return view, measured_by(view, ground.probes, ground.origin)

    seen = Seen(Evidence.none(len(ground.probes.points)), [], [])
    threads = workers()
    for number, one in enumerate(read_ahead(prepared, frames, threads=threads, ahead=threads + 1)):
        if isinstance(one, SkippedFrame):
            seen.skipped.append(one)
        else:
            view, measured = one
            seen.evidence.add(measured, view.camera.fx)
            ground.space.see(view)
            seen.frames.append(Remembered.of(number, view))
        progress(number + 1, len(frames))
    if not seen.frames:
        first = f" The first, {seen.skipped[0].name}: {seen.skipped[0].reason}" if seen.skipped else ""
        raise InputError(f"none of the {len(frames)} frames has a camera pose and depth.{first}", where)
    if not seen.evidence.frames.any():
        raise InputError(
            f"none of the {len(seen.frames)} frames measured the mesh: do poses and mesh belong together?",
            where,
        )
    return seen


def _samples(vertices: Floats, mesh: Mesh, spacing: float) -> Floats:
    """Return points all over a mesh, about as close as `spacing`: more than one in large triangles."""
    corners = vertices[mesh.triangles]
    counts = np.ceil(2 * areas(mesh.vertices, mesh.triangles) / spacing**2).astype(np.int64)
    large = np.repeat(np.flatnonzero(counts > 1), counts[counts > 1])
    # Chosen by chance, but the same each time.
    shares = np.random.default_rng(0).dirichlet((1, 1, 1), len(large))
    spread = np.einsum("kc,kcx->kx", shares, corners[large])
    return np.concatenate([vertices[np.unique(mesh.triangles)], corners.mean(axis=1), spread])
