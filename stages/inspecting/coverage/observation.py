"""Single pass over all frames for surface evidence and space carving."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.inspecting.codes import COVERAGE_MESH_UNMEASURED
from scanloom.stages.inspecting.coverage.carved_space import CarvedSpace
from scanloom.stages.inspecting.coverage.depth_view import DepthView, Floats, read_view
from scanloom.stages.inspecting.coverage.frame_ranking import FrameSummary
from scanloom.stages.inspecting.coverage.measurement_evidence import (
    Evidence,
    ProbeMeasurements,
    measure_probes,
)
from scanloom.stages.inspecting.coverage.probes import Probes, choose_probes
from scanloom.stages.progress import Progress
from scanloom.stages.scans.model.prefetch import get_worker_count, map_ordered
from scanloom.stages.scans.model.scan import Frame, SkippedFrame
from scanloom.stages.surface.chunked_mesh import ChunkedMesh, SingleChunkMesh
from scanloom.stages.surface.raycasting import mask_used_vertices
from scanloom.stages.surface.topology import compute_areas

# Default cell size of the space grid, in mesh edges.
_CELL_EDGES = 4.0
# Approximate number of triangles sampled for the median edge length.
_SAMPLED_EDGES = 500_000


@dataclass(frozen=True, eq=False)
class PreparedSurface:
    """Surface prepared for the coverage analysis.

    Attributes
    ----------
    origin : (3,) metres. Coordinates relative to the origin fit single precision.
    median_edge : median edge length of the mesh, metres.
    probes : vertices that represent their neighbourhoods.
    space : grid around the mesh; unknown until frames are added.
    """

    origin: Floats
    median_edge: float
    probes: Probes
    space: CarvedSpace

    @classmethod
    def from_surface(cls, surface: ChunkedMesh | SingleChunkMesh, spacing: float | None) -> PreparedSurface:
        """Prepare a surface.

        `spacing` is the cell size of the space grid in metres; None derives it from the mesh.
        """
        origin = surface.box.mean(axis=0)
        edge = _estimate_median_edge(surface)
        cell = spacing or _CELL_EDGES * edge
        space = CarvedSpace(surface.box - origin, _iterate_surface_points(surface, origin, cell / 2), cell)
        return cls(origin, edge, choose_probes(surface, origin, edge), space)


@dataclass(frozen=True, eq=False)
class Observations:
    """Observations of all frames.

    Attributes
    ----------
    evidence : one row per probe, plus an empty last row for vertices without a probe.
    frame_summaries : summaries of the frames that were used.
    skipped : frames that could not be used.
    """

    evidence: Evidence
    frame_summaries: list[FrameSummary]
    skipped: list[SkippedFrame]


def observe_frames(
    prepared_surface: PreparedSurface, frames: Sequence[Frame], folder: Path | None, progress: Progress
) -> Observations:
    """Read all frames, collect evidence, and carve the space of `prepared_surface`.

    Parameters
    ----------
    prepared_surface : prepared surface; its space is updated.
    frames : frames with depth and poses.
    folder : folder of the scan, for messages.
    progress : called after each frame.

    Raises
    ------
    InputError
        If no frame can be used, or no frame measured the mesh.
    """

    def prepare_frame(frame: Frame) -> tuple[DepthView, ProbeMeasurements] | SkippedFrame:
        try:
            view = read_view(frame, prepared_surface.origin)
        except InputError as error:
            return SkippedFrame(frame.name, error.diagnostic.replace_location_fields(frame=None))
        return view, measure_probes(
            view, prepared_surface.probes, prepared_surface.origin, prepared_surface.median_edge
        )

    observations = Observations(Evidence.make_empty(len(prepared_surface.probes.points) + 1), [], [])
    threads = get_worker_count()
    for number, one in enumerate(
        map_ordered(prepare_frame, frames, threads=threads, max_pending=threads + 1)
    ):
        if isinstance(one, SkippedFrame):
            observations.skipped.append(one)
        else:
            view, measured = one
            observations.evidence.add(measured, view.camera.fx)
            prepared_surface.space.add_view(view)
            observations.frame_summaries.append(FrameSummary.from_view(number, view))
        progress(number + 1, len(frames))
    if not observations.frame_summaries:
        first = (
            f" The first, frame {observations.skipped[0].name}: {observations.skipped[0].reason}"
            if observations.skipped
            else ""
        )
        raise InputError(
            COVERAGE_MESH_UNMEASURED,
            "none of the {frames_count} frames has a camera pose and depth.{first}",
            folder,
            frames_count=len(frames),
            first=first,
        )
    if not observations.evidence.frame_counts.any():
        raise InputError(
            COVERAGE_MESH_UNMEASURED,
            "none of the {frames_count} frames measured the mesh; check that poses and mesh are in the same "
            "coordinate system.",
            folder,
            frames_count=len(observations.frame_summaries),
        )
    return observations


def _estimate_median_edge(surface: ChunkedMesh | SingleChunkMesh) -> float:
    """Estimate the median edge length in metres from evenly sampled triangles."""
    step, before, lengths = 1 + surface.triangle_count // _SAMPLED_EDGES, 0, []
    for piece in surface.iterate_batches():
        ends = piece.mesh.vertices[piece.mesh.triangles[-before % step :: step, :2]]
        lengths.append(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1))
        before += len(piece.mesh.triangles)
    return float(np.median(np.concatenate(lengths)))


def _iterate_surface_points(
    surface: ChunkedMesh | SingleChunkMesh, origin: Floats, spacing: float
) -> Iterator[Floats]:
    """Yield points that cover a surface, about `spacing` metres apart.

    Large triangles get additional random points.
    """
    # A fixed seed makes the result reproducible.
    rng = np.random.default_rng(0)
    for piece in surface.iterate_batches():
        mesh = piece.mesh
        vertices = mesh.vertices - origin
        corners = vertices[mesh.triangles]
        counts = np.ceil(2 * compute_areas(mesh.vertices, mesh.triangles) / spacing**2).astype(np.int64)
        large = np.repeat(np.flatnonzero(counts > 1), counts[counts > 1])
        shares = rng.dirichlet((1, 1, 1), len(large))
        spread = np.einsum("kc,kcx->kx", shares, corners[large])
        yield from (vertices[mask_used_vertices(mesh)], corners.mean(axis=1), spread)
