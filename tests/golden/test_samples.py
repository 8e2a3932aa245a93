"""The whole pipeline on both sample scans, against golden files.

Of an accepted run, `rgbd.json` holds the figures and `rgbd.ply` points of the final mesh. After a change that
is meant, look at its pictures, and update them:

    pytest tests/golden --update-golden
"""

import json
from pathlib import Path

import numpy as np
import pytest

from scanloom.pipeline.config import Config
from scanloom.pipeline.evaluation.params import ReportParams
from scanloom.pipeline.run.run import run
from scanloom.stages.comparing.compare import CompareParams, compare
from scanloom.stages.surface.formats.ply import read_ply, write_ply_cloud
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import RaycastingSurface, compute_bounding_box, interpolate_values
from scanloom.stages.surface.topology import topology

pytestmark = pytest.mark.slow

SAMPLES = Path(__file__).resolve().parents[2] / "samples"
GOLDEN = Path(__file__).resolve().parent
POINTS = 3000
COMPARED = CompareParams(samples=100_000)

# How far a figure may be from the golden one: relative, absolute. Wide enough for another version of OpenCV
# or Open3D, whose matcher or surface extraction rounds differently; test_damage_is_told_from_the_golden_mesh
# shows that real damage is far outside.
TOLERANCES = {
    "frames_used": (0, 0),
    "voxel_size_m": (0.02, 0),
    "vertices": (0.02, 0),
    "triangles": (0.02, 0),
    "area_m2": (0.005, 0),
    "volume_m3": (0.005, 0),
    "extent_x_m": (0, 0.01),
    "extent_y_m": (0, 0.01),
    "extent_z_m": (0, 0.01),
    "euler": (0.1, 15),
    "boundary_loops": (0.1, 15),
    "components": (0.1, 3),
    "nonmanifold": (0.1, 15),
    "manifold": (0, 0),
    "truth_distance_mean_m": (0.04, 0.00003),
    "truth_distance_rms_m": (0.04, 0.00005),
    "truth_coverage_mean_m": (0.05, 0.00003),
    "truth_color_rmse_levels": (0.03, 0.2),
    "edge_length_mean_m": (0.015, 0),
    "edge_length_deviation_m": (0.03, 0),
    "fused_distance_rms_m": (0.05, 0.00001),
    "fused_distance_maximum_m": (0.25, 0.0005),
    "fused_color_rmse_levels": (0.04, 0.1),
    "largest_shape_change_m": (0.05, 0),
    "largest_color_change_levels": (0.05, 0),
}
# Of nine golden points in ten, the distance to the new mesh in metres, and the colour difference in levels.
POINTS_DISTANCE, POINTS_COLOR = 0.0006, 4.0

# What any version has to reach, whatever the golden files say.
LIMITS = {
    "rgbd": {"truth_distance_rms_m": 0.0013, "truth_color_rmse_levels": 15.0},
    "stereo": {"truth_distance_rms_m": 0.0025, "truth_color_rmse_levels": 15.0},
}


@pytest.fixture(scope="module")
def truth() -> Mesh:
    return read_ply(SAMPLES / "truth.ply")


@pytest.mark.parametrize("sample", ["rgbd", "stereo"])
def test_a_sample_scan_gives_the_golden_meshes(sample, truth, tmp_path, update_golden):
    config = Config(compare=COMPARED, report=ReportParams(viewpoints=2, width=160, page=False))
    report = json.loads(json.dumps(run(SAMPLES / sample, tmp_path, config).report))
    final = read_ply(tmp_path / "simplified.ply")
    metrics = {name: mesh_metrics(read_ply(tmp_path / f"{name}.ply"), truth) for name in ("fused", "clean")}
    metrics["simplified"] = mesh_metrics(final, truth)
    metrics["report"] = report_metrics(report)

    for name, limit in LIMITS[sample].items():
        assert metrics["simplified"][name] < limit, name
    assert metrics["clean"]["manifold"]
    assert metrics["simplified"]["manifold"]
    assert metrics["simplified"]["vertices"] < 0.5 * metrics["clean"]["vertices"]

    if update_golden:
        (GOLDEN / f"{sample}.json").write_text(json.dumps(metrics, indent=1) + "\n")
        chosen = np.random.default_rng(0).choice(len(final.vertices), POINTS, replace=False)
        points = final.vertices[chosen].astype(np.float32)
        write_ply_cloud(GOLDEN / f"{sample}.ply", points, final.colors[chosen])

    golden = json.loads((GOLDEN / f"{sample}.json").read_text())
    assert deviations(metrics, golden) == []
    distance, color = from_points(read_ply(GOLDEN / f"{sample}.ply"), final)
    assert distance < POINTS_DISTANCE
    assert color < POINTS_COLOR
    assert report["mesh"]["vertices"] == len(final.vertices)
    assert report["mesh"]["manifold"] is True
    # Four meshes from two viewpoints, the triangles, which photo counts most where, and filled holes.
    assert len(report["pictures"]) == 2 * 4 + 3
    for picture in report["pictures"]:
        assert next(tmp_path.rglob(Path(picture).name)).stat().st_size > 1000


def mesh_metrics(mesh: Mesh, truth: Mesh) -> dict:
    """What is known of one mesh. Distances to the truth go from the mesh; coverage goes to it."""
    found, measured = topology(mesh), compare(truth, mesh, COMPARED)
    corners = mesh.vertices[mesh.triangles] - compute_bounding_box(truth).mean(axis=0)
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    extent = np.ptp(compute_bounding_box(mesh), axis=0)
    return {
        "vertices": len(mesh.vertices),
        "triangles": len(mesh.triangles),
        "area_m2": float(np.linalg.norm(cross, axis=1).sum() / 2),
        # Of the cones from the middle of the scene: its sign is the surface's orientation.
        "volume_m3": float(np.einsum("kx,kx->", cross, corners[:, 0]) / 6),
        **{f"extent_{axis}_m": float(extent[i]) for i, axis in enumerate("xyz")},
        "euler": found.euler,
        "boundary_loops": found.boundary_loops,
        "components": found.components,
        "nonmanifold": found.nonmanifold_edges + found.nonmanifold_vertices,
        "manifold": found.is_manifold and found.is_oriented,
        "truth_distance_mean_m": measured.b_to_a.mean,
        "truth_distance_rms_m": measured.b_to_a.rms,
        "truth_coverage_mean_m": measured.a_to_b.mean,
        "truth_color_rmse_levels": measured.color_b_to_a.rmse,
    }


def report_metrics(report: dict) -> dict:
    """What report.json says of the stages, and of the final mesh against the fused one."""
    fuse, simplify = report["stages"]["fuse"]["metrics"], report["stages"]["simplify"]["metrics"]
    final = report["mesh"]
    distance = final["to_fused"]["distance"]["b_to_a"]
    return {
        "frames_used": fuse["frames_used"],
        "voxel_size_m": fuse["voxel_size_m"],
        "largest_shape_change_m": simplify["details"]["largest_shape_change_m"],
        "largest_color_change_levels": simplify["details"]["largest_color_change_levels"],
        "edge_length_mean_m": final["edges"]["length_mean_m"],
        "edge_length_deviation_m": final["edges"]["length_std_m"],
        "fused_distance_rms_m": distance["rms_m"],
        "fused_distance_maximum_m": distance["maximum_m"],
        "fused_color_rmse_levels": final["to_fused"]["color"]["b_to_a"]["rmse_levels"],
    }


def deviations(metrics: dict, golden: dict) -> list[str]:
    """Every figure outside its tolerance, in words."""
    assert {k: set(v) for k, v in metrics.items()} == {k: set(v) for k, v in golden.items()}
    found = []
    for part, values in golden.items():
        for name, wanted in values.items():
            relative, absolute = TOLERANCES[name]
            if abs(metrics[part][name] - wanted) > max(relative * abs(wanted), absolute):
                found.append(f"{part} {name}: {metrics[part][name]:.6g}, golden {wanted:.6g}")
    return found


def from_points(points: Mesh, mesh: Mesh) -> tuple[float, float]:
    """Distance and colour difference from golden points to the mesh, reached or undercut by nine in ten.

    The rest may lie where a frayed border has moved.
    """
    nearest = RaycastingSurface(mesh).find_closest_points(points.vertices)
    colors = np.abs(interpolate_values(mesh.colors, mesh, nearest) - points.colors).mean(axis=1)
    return float(np.quantile(nearest.distances, 0.9)), float(np.quantile(colors, 0.9))


def _recolored(change):
    return lambda mesh: mesh.with_(colors=change(mesh.colors.astype(float)).clip(0, 255).astype(np.uint8))


def _moved(change):
    return lambda mesh: mesh.with_(vertices=change(mesh.vertices))


DAMAGE = {
    "scaled by 1 %": _moved(lambda v: v * 1.01),
    "shifted by 3 mm": _moved(lambda v: v + 0.0017),
    "noise of 1 mm": _moved(lambda v: v + np.random.default_rng(0).normal(0, 0.001, v.shape)),
    "mirrored": _moved(lambda v: v * (-1, 1, 1)),
    "inside out": lambda mesh: mesh.with_(triangles=mesh.triangles[:, ::-1]),
    "red and blue swapped": _recolored(lambda c: c[:, ::-1]),
    "darker by 10 %": _recolored(lambda c: c * 0.9),
    "grey": _recolored(lambda c: np.repeat(c.mean(axis=1, keepdims=True), 3, axis=1)),
    "2 % of the triangles lost": lambda mesh: mesh.with_(
        triangles=mesh.triangles[np.random.default_rng(0).random(len(mesh.triangles)) > 0.02]
    ),
    "a corner cut off": lambda mesh: mesh.with_(
        triangles=mesh.triangles[mesh.vertices[mesh.triangles[:, 0], 0] < 0.42]
    ),
}


@pytest.fixture(scope="module")
def scanned(truth) -> Mesh:
    """The true mesh with the errors of a good scan, so that tolerances relative to them make sense."""
    rng = np.random.default_rng(1)
    noisy = truth.colors + rng.normal(0, 12, truth.colors.shape)
    return truth.with_(
        vertices=truth.vertices + rng.normal(0, 0.0007, truth.vertices.shape),
        colors=noisy.clip(0, 255).astype(np.uint8),
    )


@pytest.fixture(scope="module")
def of_scanned(truth, scanned) -> dict:
    return {"simplified": mesh_metrics(scanned, truth)}


@pytest.mark.parametrize("damage", DAMAGE)
def test_damage_is_told_from_the_golden_mesh(damage, truth, scanned, of_scanned):
    assert deviations({"simplified": mesh_metrics(DAMAGE[damage](scanned), truth)}, of_scanned) != []
