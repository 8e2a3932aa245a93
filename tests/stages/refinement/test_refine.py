"""Refinement of a ball in front of a board, fused from noisy depth maps."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from scanloom.stages import (
    Frame,
    InputError,
    Mesh,
    RefinementResult,
    Scan,
    clean,
    fuse,
    read_scan,
    refine,
    to_trimesh,
    topology,
)
from scanloom.stages.scans.model.threads import THREADS_VARIABLE
from scanloom.stages.surface.edges import build_edges
from scanloom.stages.surface.mesh import Triangles, Vertices
from tests.made.chunked_sample import write_partial_sample
from tests.made.posed_scene import BOARD_Z, CAMERA, RADIUS, make_posed_scan

NOISE = 0.0015  # standard deviation of depth, metres


@pytest.fixture(scope="module")
def scan() -> Scan:
    views, depths = make_posed_scan()
    rng = np.random.default_rng(1)
    return Scan.from_frames(
        [
            Frame.from_arrays(
                np.asarray(view.color),
                np.where(depth > 0, depth + NOISE * rng.standard_normal(depth.shape), 0).astype(np.float32),
                CAMERA,
                view.world_from_camera,
            )
            for view, depth in zip(views.frames, depths, strict=True)
        ]
    )


@pytest.fixture(scope="module")
def fused(scan: Scan) -> Mesh:
    return clean(fuse(scan, voxel_size=0.006).mesh).mesh


@pytest.fixture(scope="module")
def refined(fused: Mesh, scan: Scan) -> RefinementResult:
    return refine(fused, scan)


def _measure(mesh: Mesh) -> dict[str, float]:
    """Compute RMS heights over ball and board in metres, and the tilt of the board's normals in degrees."""
    centroids, normals, areas = _describe_triangles(mesh.vertices, mesh.triangles)
    distance = np.linalg.norm(centroids, axis=1)
    is_ball = distance < RADIUS + 0.01
    is_board = (np.abs(centroids[:, 2] - BOARD_Z) < 0.01) & (distance > RADIUS + 0.05)
    tilt = np.degrees(np.arccos(np.abs(normals[is_board, 2]).clip(0, 1)))
    return {
        "ball": float(np.sqrt(np.average((distance - RADIUS)[is_ball] ** 2, weights=areas[is_ball]))),
        "ball_mean": float(np.average((distance - RADIUS)[is_ball], weights=areas[is_ball])),
        "board": float(np.sqrt(np.average((centroids[is_board, 2] - BOARD_Z) ** 2, weights=areas[is_board]))),
        "tilt": float(np.median(tilt)),
    }


def _describe_triangles(
    vertices: Vertices, triangles: Triangles
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1)
    return (a + b + c) / 3, normals / np.maximum(lengths, 1e-30)[:, None], lengths


def test_refinement_reduces_the_distance_to_the_true_surface(fused: Mesh, refined: RefinementResult) -> None:
    before, after = _measure(fused), _measure(refined.mesh)
    assert after["ball"] < 0.6 * before["ball"]
    assert abs(after["ball_mean"]) < NOISE / 10
    assert after["board"] < 0.3 * before["board"]
    assert after["tilt"] < 0.1 < 1.0 < before["tilt"]


def test_a_plane_is_found_on_the_board_and_not_on_the_ball(refined: RefinementResult) -> None:
    vertices = refined.mesh.vertices
    is_ball = np.linalg.norm(vertices, axis=1) < RADIUS + 0.01
    is_board = (np.abs(vertices[:, 2] - BOARD_Z) < 0.005) & ~is_ball
    assert (refined.plane_ids[is_board] >= 0).mean() > 0.9
    assert (refined.plane_ids[is_ball] >= 0).mean() < 0.02


def test_no_vertex_moves_farther_than_its_deviation_allows(fused: Mesh, refined: RefinementResult) -> None:
    edges = to_trimesh(Mesh(fused.vertices, fused.triangles)).edges_unique_length
    largest = 3 * np.sqrt(refined.deviations.max() ** 2 + (1.2 * edges.mean()) ** 2 / 12)
    metrics = refined.to_dict()
    assert 0 < metrics["move_rms_m"] < metrics["move_max_m"] <= largest
    assert len(refined.deviations) == len(refined.plane_ids) == len(refined.mesh.vertices)
    assert NOISE / 4 < np.median(refined.deviations) < NOISE


def test_the_result_is_an_oriented_manifold_with_colours(fused: Mesh, refined: RefinementResult) -> None:
    found = topology(refined.mesh)
    assert found.is_manifold
    assert found.is_oriented
    assert refined.mesh.colors is not None
    assert fused.colors is not None
    assert refined.mesh.colors.mean() == pytest.approx(fused.colors.mean(), abs=3)


def test_no_triangle_is_folded_over_its_neighbour(fused: Mesh, refined: RefinementResult) -> None:
    assert count_folds(refined.mesh) <= count_folds(fused)


def count_folds(mesh: Mesh) -> int:
    """Count edges whose two triangles face in nearly opposite directions."""
    whole = to_trimesh(Mesh(mesh.vertices, mesh.triangles))
    first, second = whole.face_normals[whole.face_adjacency].transpose(1, 0, 2)
    return int(np.count_nonzero(np.einsum("ki,ki->k", first, second) < -0.9))


def test_a_second_refinement_gives_the_same_bits(fused: Mesh, scan: Scan, refined: RefinementResult) -> None:
    again = refine(fused, scan.frames)
    assert np.array_equal(again.mesh.vertices, refined.mesh.vertices)
    assert np.array_equal(again.mesh.triangles, refined.mesh.triangles)


def test_every_thread_count_gives_the_same_bits(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sample = read_scan(write_partial_sample(tmp_path / "scan", list(range(0, 24, 6))))
    mesh = clean(fuse(sample, voxel_size=0.015).mesh).mesh
    found = []
    for threads in ("1", "2", "4"):
        monkeypatch.setenv(THREADS_VARIABLE, threads)
        found.append(refine(mesh, sample))
    first = found[0]
    # Flaps, skirts and filled holes are part of the comparison.
    assert first.removed_triangles > 0
    assert first.is_filled.any()
    for other in found[1:]:
        for name in ("deviations", "plane_ids", "moves", "is_filled"):
            assert np.array_equal(getattr(first, name), getattr(other, name)), name
        for name in ("vertices", "triangles", "colors"):
            assert np.array_equal(getattr(first.mesh, name), getattr(other.mesh, name)), name


def test_measured_outlines_move_the_boundaries(tmp_path: Path) -> None:
    sample = read_scan(write_partial_sample(tmp_path / "scan", list(range(0, 24, 6))))
    mesh = clean(fuse(sample, voxel_size=0.015).mesh).mesh
    aligned, smoothed = (
        refine(mesh, sample, fill_holes=0, has_matched_depth=matched).mesh for matched in (False, True)
    )
    assert np.array_equal(aligned.triangles, smoothed.triangles)
    edges = build_edges(aligned.triangles, len(aligned.vertices))
    is_rim = np.zeros(len(aligned.vertices), bool)
    is_rim[edges.ends[edges.triangle_count == 1]] = True
    moved = np.linalg.norm(aligned.vertices - smoothed.vertices, axis=1)
    # Only neighbours of the boundary move, where triangles would fold.
    assert (moved[~is_rim] > 0).mean() < 0.1
    assert np.median(moved[is_rim]) > 0.001


def test_strength_0_returns_the_input(fused: Mesh, scan: Scan) -> None:
    kept = refine(fused, scan, strength=0)
    assert np.array_equal(kept.mesh.vertices, fused.vertices)
    assert kept.to_dict()["move_max_m"] == 0


def test_a_smaller_strength_moves_less(fused: Mesh, scan: Scan, refined: RefinementResult) -> None:
    weak = refine(fused, scan, strength=0.1)
    assert weak.moves.max() < 0.5 * refined.moves.max()


def test_without_planes_no_vertex_belongs_to_a_plane(fused: Mesh, scan: Scan) -> None:
    curved = refine(fused, scan, planes=False)
    assert curved.plane_count == 0
    assert (curved.plane_ids == -1).all()
    assert _measure(curved.mesh)["tilt"] < 1.5


def test_a_single_frame_does_not_change_the_mesh(fused: Mesh, scan: Scan) -> None:
    kept = refine(fused, scan.frames[:1])
    assert np.array_equal(kept.mesh.vertices, fused.vertices)
    assert "do not overlap enough" in kept.reason
    assert not kept.diagnostics


def test_a_mesh_in_other_coordinates_is_unchanged(fused: Mesh, scan: Scan) -> None:
    kept = refine(fused.with_(vertices=fused.vertices + np.array((10.0, 0, 0))), scan)
    assert np.array_equal(kept.mesh.triangles, fused.triangles)
    assert "no frame has measured this mesh" in kept.reason


def test_frames_without_depth_are_refused(fused: Mesh, scan: Scan) -> None:
    with pytest.raises(InputError, match="no frame has a depth map"):
        refine(fused, [replace(frame, depth=None) for frame in scan.frames])


def test_normals_are_left_out_with_a_warning(fused: Mesh, scan: Scan) -> None:
    up = np.tile((0.0, 0.0, 1.0), (len(fused.vertices), 1))
    found = refine(fused.with_(normals=up), scan)
    assert found.mesh.normals is None
    assert [one.code for one in found.diagnostics] == ["refine.data-left-out"]
