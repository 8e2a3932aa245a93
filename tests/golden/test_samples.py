"""The whole pipeline on both sample scans, compared with golden files.

`rgbd.json` and `stereo.json` hold the metrics of an accepted run; the PLY files hold points of its textured
mesh. After an intended change, inspect the pictures of the run, then update the files:

pytest tests/golden --update-golden

"""

import json
from pathlib import Path

import numpy as np
import pytest

from scanloom.pipeline.artifacts.file_names import FILLED_PROPERTY
from scanloom.pipeline.config import Config
from scanloom.pipeline.evaluation.params import ReportParams
from scanloom.pipeline.run.run import run
from scanloom.stages.comparing.compare import CompareParams, compare
from scanloom.stages.comparing.surface_sampling import sample_stratified
from scanloom.stages.surface.formats.ply import read_ply, read_vertex_values, write_ply_cloud
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.mesh_files import read_mesh
from scanloom.stages.surface.raycasting import RaycastingSurface, compute_bounding_box
from scanloom.stages.surface.surface_color import compute_surface_colors
from scanloom.stages.surface.topology import compute_areas, topology

pytestmark = pytest.mark.slow

SAMPLES = Path(__file__).resolve().parents[2] / "samples"
GOLDEN = Path(__file__).resolve().parent
POINTS = 3000
COMPARED = CompareParams(samples=100_000)

# Tolerances of metrics: relative, absolute. They allow for other versions of OpenCV or Open3D, whose matcher
# or surface extraction rounds differently. test_damage_is_outside_the_tolerances shows that they detect real
# damage.
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
    "proven_shape_m": (0.05, 0),
}
# Limits of the 90th percentile over golden points: distance to the new mesh in metres, colour difference in
# levels.
POINTS_DISTANCE, POINTS_COLOR = 0.0006, 4.0

# Limits for every version, independent of the golden files.
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
    metrics = {
        name: compute_mesh_metrics(read_ply(tmp_path / f"{name}.ply"), truth) for name in ("fused", "clean")
    }
    metrics["simplified"] = compute_mesh_metrics(final, truth)
    # Evaluate colours of the texture: the simplified vertices are too far apart.
    textured = read_mesh(tmp_path / "textured.glb")
    compared = compare(truth, textured, COMPARED)
    assert compared.color_b_to_a is not None
    metrics["textured"] = {"truth_color_rmse_levels": compared.color_b_to_a.rmse}
    metrics["report"] = extract_report_metrics(report)

    for name, limit in LIMITS[sample].items():
        part = "textured" if name in metrics["textured"] else "simplified"
        assert metrics[part][name] < limit, name
    assert metrics["clean"]["manifold"]
    assert metrics["simplified"]["manifold"]
    assert metrics["simplified"]["vertices"] < 0.5 * metrics["clean"]["vertices"]

    if update_golden:
        (GOLDEN / f"{sample}.json").write_text(json.dumps(metrics, indent=1) + "\n")
        areas = np.cumsum(compute_areas(textured.vertices, textured.triangles))
        found = sample_stratified(areas, slice(0, POINTS), POINTS, np.random.default_rng(0))
        corners = textured.vertices[textured.triangles[found.triangles]]
        points = np.einsum("kc,kcx->kx", found.weights, corners).astype(np.float32)
        colors = compute_surface_colors(textured, found.triangles, found.weights)
        write_ply_cloud(GOLDEN / f"{sample}.ply", points, np.rint(colors).astype(np.uint8))

    golden = json.loads((GOLDEN / f"{sample}.json").read_text())
    assert find_deviations(metrics, golden) == []
    distance, color = measure_from_points(read_ply(GOLDEN / f"{sample}.ply"), textured)
    assert distance < POINTS_DISTANCE
    assert color < POINTS_COLOR
    assert report["mesh"]["vertices"] == len(final.vertices)
    assert report["mesh"]["manifold"] is True
    # Four meshes from two viewpoints, plus wireframe, dominant photos, and filled holes with inner vertices.
    has_filled_vertices = bool(read_vertex_values(tmp_path / "refined.ply", FILLED_PROPERTY).any())
    assert len(report["pictures"]) == 2 * 4 + 2 + has_filled_vertices
    for picture in report["pictures"]:
        assert next(tmp_path.rglob(Path(picture).name)).stat().st_size > 1000


def compute_mesh_metrics(mesh: Mesh, truth: Mesh) -> dict:
    """Compute the metrics of a mesh.

    Distances are measured from the mesh to the truth, coverage from the truth to the mesh.
    """
    found, measured = topology(mesh), compare(truth, mesh, COMPARED)
    corners = mesh.vertices[mesh.triangles] - compute_bounding_box(truth).mean(axis=0)
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    extent = np.ptp(compute_bounding_box(mesh), axis=0)
    return {
        "vertices": len(mesh.vertices),
        "triangles": len(mesh.triangles),
        "area_m2": float(np.linalg.norm(cross, axis=1).sum() / 2),
        # Sum of signed cones from the centre of the scene; its sign shows the orientation of the surface.
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


def extract_report_metrics(report: dict) -> dict:
    """Extract metrics of the stages, and of the final mesh against the fused mesh, from report.json."""
    fuse, simplify = report["stages"]["fuse"]["metrics"], report["stages"]["simplify"]["metrics"]
    final = report["mesh"]
    distance = final["to_fused"]["distance"]["b_to_a"]
    return {
        "frames_used": fuse["frames_used"],
        "voxel_size_m": fuse["voxel_size_m"],
        "proven_shape_m": simplify["details"]["shape_bound_m"],
        "edge_length_mean_m": final["edges"]["length_mean_m"],
        "edge_length_deviation_m": final["edges"]["length_std_m"],
        "fused_distance_rms_m": distance["rms_m"],
        "fused_distance_maximum_m": distance["maximum_m"],
        "fused_color_rmse_levels": final["to_fused"]["color"]["b_to_a"]["rmse_levels"],
    }


def find_deviations(metrics: dict, golden: dict) -> list[str]:
    """Describe every metric outside its tolerance."""
    assert {k: set(v) for k, v in metrics.items()} == {k: set(v) for k, v in golden.items()}
    found = []
    for part, values in golden.items():
        for name, wanted in values.items():
            relative, absolute = TOLERANCES[name]
            if abs(metrics[part][name] - wanted) > max(relative * abs(wanted), absolute):
                found.append(f"{part} {name}: {metrics[part][name]:.6g}, golden {wanted:.6g}")
    return found


def measure_from_points(points: Mesh, mesh: Mesh) -> tuple[float, float]:
    """Compute 90th percentiles of distance and colour difference from golden points to a mesh.

    The other 10 % of the points may be at a ragged border that has moved.
    """
    nearest = RaycastingSurface(mesh).find_closest_points(points.vertices)
    colors = compute_surface_colors(mesh, nearest.triangles, nearest.weights)
    colors = np.abs(colors - points.colors).mean(axis=1)
    return float(np.quantile(nearest.distances, 0.9)), float(np.quantile(colors, 0.9))


def _change_colors(change):
    return lambda mesh: mesh.with_(colors=change(mesh.colors.astype(float)).clip(0, 255).astype(np.uint8))


def _change_vertices(change):
    return lambda mesh: mesh.with_(vertices=change(mesh.vertices))


DAMAGE = {
    "scaled by 1 %": _change_vertices(lambda v: v * 1.01),
    "shifted by 3 mm": _change_vertices(lambda v: v + 0.0017),
    "noise of 1 mm": _change_vertices(lambda v: v + np.random.default_rng(0).normal(0, 0.001, v.shape)),
    "mirrored": _change_vertices(lambda v: v * (-1, 1, 1)),
    "inside out": lambda mesh: mesh.with_(triangles=mesh.triangles[:, ::-1]),
    "red and blue swapped": _change_colors(lambda c: c[:, ::-1]),
    "darker by 10 %": _change_colors(lambda c: c * 0.9),
    "grey": _change_colors(lambda c: np.repeat(c.mean(axis=1, keepdims=True), 3, axis=1)),
    "2 % of the triangles lost": lambda mesh: mesh.with_(
        triangles=mesh.triangles[np.random.default_rng(0).random(len(mesh.triangles)) > 0.02]
    ),
    "a corner cut off": lambda mesh: mesh.with_(
        triangles=mesh.triangles[mesh.vertices[mesh.triangles[:, 0], 0] < 0.42]
    ),
}


@pytest.fixture(scope="module")
def scanned(truth) -> Mesh:
    """Add errors of a good scan to the true mesh, so that relative tolerances are realistic."""
    rng = np.random.default_rng(1)
    noisy = truth.colors + rng.normal(0, 12, truth.colors.shape)
    return truth.with_(
        vertices=truth.vertices + rng.normal(0, 0.0007, truth.vertices.shape),
        colors=noisy.clip(0, 255).astype(np.uint8),
    )


@pytest.fixture(scope="module")
def of_scanned(truth, scanned) -> dict:
    return {"simplified": compute_mesh_metrics(scanned, truth)}


@pytest.mark.parametrize("damage", DAMAGE)
def test_damage_is_outside_the_tolerances(damage, truth, scanned, of_scanned):
    assert (
        find_deviations({"simplified": compute_mesh_metrics(DAMAGE[damage](scanned), truth)}, of_scanned)
        != []
    )
