"""Single pass over all frames for surface evidence and space carving."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.inspecting.codes import COVERAGE_MESH_UNMEASURED
from scanloom.stages.inspecting.coverage.evidence import Evidence, Measured, measured_by
from scanloom.stages.inspecting.coverage.nearest import Remembered
from scanloom.stages.inspecting.coverage.probes import Probes, probes_of
from scanloom.stages.inspecting.coverage.space import Space
from scanloom.stages.inspecting.coverage.views import Floats, View, read_view
from scanloom.stages.progress import Progress
from scanloom.stages.scans.model.prefetch import read_ahead, workers
from scanloom.stages.scans.model.scan import Frame, SkippedFrame
from scanloom.stages.surface.piecewise import OnePiece, Piecewise
from scanloom.stages.surface.raycasting import is_used
from scanloom.stages.surface.topology import areas

# Default cell size of the space grid, in mesh edges.
_CELL_EDGES = 4.0
# Approximate number of triangles sampled for the median edge length.
_EDGES = 500_000


@dataclass(frozen=True, eq=False)
class Ground:
    """Surface prepared for the coverage analysis.

    Attributes
    ----------
    origin : (3,) metres. Coordinates relative to the origin fit single precision.
    edge : median edge length of the mesh, metres.
    probes : vertices that represent their neighbourhoods.
    space : grid around the mesh; unknown until frames are added.
    """

    origin: Floats
    edge: float
    probes: Probes
    space: Space

    @classmethod
    def of(cls, surface: Piecewise | OnePiece, spacing: float | None) -> Ground:
        """Prepare a surface.

        `spacing` is the cell size of the space grid in metres; None derives it from the mesh.
        """
        origin = surface.box.mean(axis=0)
        edge = _edge_of(surface)
        cell = spacing or _CELL_EDGES * edge
        space = Space(surface.box - origin, _samples(surface, origin, cell / 2), cell)
        return cls(origin, edge, probes_of(surface, origin, edge), space)


@dataclass(frozen=True, eq=False)
class Seen:
    """Observations of all frames.

    Attributes
    ----------
    evidence : one row per probe, plus an empty last row for vertices without a probe.
    frames : summaries of the frames that were used.
    skipped : frames that could not be used.
    """

    evidence: Evidence
    frames: list[Remembered]
    skipped: list[SkippedFrame]


def look(ground: Ground, frames: Sequence[Frame], where: Path | None, progress: Progress) -> Seen:
    """Read all frames, collect evidence, and carve the space of `ground`.

    Parameters
    ----------
    ground : prepared surface; its space is updated.
    frames : frames with depth and poses.
    where : folder of the scan, for messages.
    progress : called after each frame.

    Raises
    ------
    InputError
        If no frame can be used, or no frame measured the mesh.
    """

    def prepared(frame: Frame) -> tuple[View, Measured] | SkippedFrame:
        try:
            view = read_view(frame, ground.origin)
        except InputError as error:
            return SkippedFrame(frame.name, error.diagnostic.within(frame=None))
        return view, measured_by(view, ground.probes, ground.origin, ground.edge)

    seen = Seen(Evidence.none(len(ground.probes.points) + 1), [], [])
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
        first = f" The first, frame {seen.skipped[0].name}: {seen.skipped[0].reason}" if seen.skipped else ""
        raise InputError(
            COVERAGE_MESH_UNMEASURED,
            "none of the {frames_count} frames has a camera pose and depth.{first}",
            where,
            frames_count=len(frames),
            first=first,
        )
    if not seen.evidence.frames.any():
        raise InputError(
            COVERAGE_MESH_UNMEASURED,
            "none of the {frames_count} frames measured the mesh; check that poses and mesh are in the same "
            "coordinate system.",
            where,
            frames_count=len(seen.frames),
        )
    return seen


def _edge_of(surface: Piecewise | OnePiece) -> float:
    """Estimate the median edge length in metres from evenly sampled triangles."""
    step, before, lengths = 1 + surface.triangle_count // _EDGES, 0, []
    for piece in surface.pieces():
        ends = piece.mesh.vertices[piece.mesh.triangles[-before % step :: step, :2]]
        lengths.append(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1))
        before += len(piece.mesh.triangles)
    return float(np.median(np.concatenate(lengths)))


def _samples(surface: Piecewise | OnePiece, origin: Floats, spacing: float) -> Iterator[Floats]:
    """Yield points that cover a surface, about `spacing` metres apart.

    Large triangles get additional random points.
    """
    # A fixed seed makes the result reproducible.
    rng = np.random.default_rng(0)
    for piece in surface.pieces():
        mesh = piece.mesh
        vertices = mesh.vertices - origin
        corners = vertices[mesh.triangles]
        counts = np.ceil(2 * areas(mesh.vertices, mesh.triangles) / spacing**2).astype(np.int64)
        large = np.repeat(np.flatnonzero(counts > 1), counts[counts > 1])
        shares = rng.dirichlet((1, 1, 1), len(large))
        spread = np.einsum("kc,kcx->kx", shares, corners[large])
        yield from (vertices[is_used(mesh)], corners.mean(axis=1), spread)
