"""Measures of shape on meshes with known answers."""

import argparse
import dataclasses
import sys
from pathlib import Path

import numpy as np
import pytest
from small_scans import write_small_scan

import scanloom
from scanloom.stages.scans.model.scan import Camera, Frame
from scanloom.stages.surface.mesh import Mesh

sys.path.insert(0, str(Path(__file__).parents[2] / "benches"))
import shape
from peers.normal_filter import filter_mesh
from peers.regularised_fusion import REGULARISERS
from shape_measures import (
    SurfaceSamples,
    TruthSurface,
    estimate_similarity,
    find_planar_places,
    find_seen_points,
    measure_completeness,
    measure_planar_errors,
    measure_truth_errors,
    sample_sharp_edges,
    sample_surface,
    transform_mesh,
)

pytestmark = pytest.mark.thorough


def make_sheet(heights: np.ndarray, side: float = 1.0) -> Mesh:
    """Make a square sheet that faces up, from the heights of its rows of vertices."""
    count = len(heights)
    x, y = np.meshgrid(np.linspace(0, side, count), np.linspace(0, side, count), indexing="ij")
    z = heights if heights.ndim == 2 else np.broadcast_to(heights[:, None], x.shape)
    a = (np.arange(count - 1)[:, None] * count + np.arange(count - 1)).ravel()
    b, c, d = a + count, a + count + 1, a + 1
    triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return Mesh(np.stack([x, y, z], -1).reshape(-1, 3), triangles.astype(np.int32))


def move_mesh(mesh: Mesh, offset: tuple[float, float, float]) -> Mesh:
    return mesh.with_(vertices=mesh.vertices + np.array(offset))


def make_cube() -> Mesh:
    """Make a unit cube whose sides share no vertices."""
    sheet = make_sheet(np.zeros(11))
    lid = move_mesh(sheet, (0, 0, 1))
    sides = []
    for turn in (0, 1, 2):
        for side, order in ((sheet, (0, 2, 1)), (lid, (0, 1, 2))):
            sides.append((np.roll(side.vertices, turn, axis=1), side.triangles[:, order]))
    offsets = np.cumsum([0, *(len(vertices) for vertices, _ in sides)])[:-1]
    triangles = [t + offset for (_, t), offset in zip(sides, offsets, strict=True)]
    return Mesh(np.concatenate([v for v, _ in sides]), np.concatenate(triangles).astype(np.int32))


FLAT = make_sheet(np.zeros(21))


def test_all_distances_of_a_raised_sheet_equal_its_height():
    raised = move_mesh(FLAT, (0, 0, 0.003))

    errors = measure_truth_errors(raised, TruthSurface(FLAT), 5000)

    distances = (errors.mean_m, errors.rms_m, errors.p95_m, errors.sharp_rms_m)
    assert distances == pytest.approx((0.003,) * 4, rel=1e-6)
    assert errors.normal_p90_deg == pytest.approx(0, abs=1e-4)


def test_the_normal_error_of_a_zigzag_is_its_slope():
    slope = np.tan(np.radians(10)) * 0.05
    zigzag = make_sheet(slope * (np.arange(21) % 2))

    errors = measure_truth_errors(zigzag, TruthSurface(FLAT), 20_000)

    assert errors.normal_median_deg == pytest.approx(10, abs=1e-3)
    assert errors.normal_p90_deg == pytest.approx(10, abs=1e-3)
    # Heights are uniformly distributed between 0 and the top.
    assert errors.mean_m == pytest.approx(slope / 2, rel=0.01)
    assert errors.rms_m == pytest.approx(slope / 3**0.5, rel=0.01)
    assert errors.p95_m == pytest.approx(0.95 * slope, rel=0.01)


def test_sharp_edges_are_cube_edges_and_sheet_borders():
    points = sample_sharp_edges(make_cube())
    on_faces = (np.abs(points - 0.5) > 0.5 - 1e-9).sum(axis=1)
    assert on_faces.min() >= 2
    # Twelve edges of ten segments, each with 101 points at 1 mm spacing.
    assert len(points) == pytest.approx(12 * 10 * 101, abs=120)

    border = sample_sharp_edges(FLAT)
    assert (np.abs(border[:, :2] - 0.5).max(axis=1) > 0.5 - 1e-9).all()


def test_errors_near_edges_count_only_there():
    cube = make_cube()
    inner = (np.abs(cube.vertices - 0.5) < 0.49).sum(axis=1) == 2
    dented = cube.with_(vertices=np.where(inner[:, None], cube.vertices * 0.99 + 0.005, cube.vertices))

    errors = measure_truth_errors(dented, TruthSurface(cube), 50_000)

    # The dent grows linearly from 0 at the edge to 5 mm at the next vertices, 10 cm away.
    assert errors.rms_m > 0.004
    assert errors.sharp_rms_m < 0.0005


def test_half_a_sheet_is_half_complete():
    half = FLAT.with_triangles(*_select(FLAT, FLAT.vertices[FLAT.triangles, 0].max(axis=1) <= 0.5))

    assert measure_completeness(sample_surface(FLAT, 20_000).points, half) == pytest.approx(0.505, abs=0.005)
    assert measure_completeness(sample_surface(half, 1000).points, FLAT) == 1


def _select(mesh: Mesh, chosen: np.ndarray):
    return mesh.triangles[chosen], np.flatnonzero(chosen)


def test_a_point_is_visible_inside_the_image_and_from_its_front():
    # A small plate 0.5 m above the sheet occludes the middle for a camera 1 m above.
    plate = make_sheet(np.full(3, 0.5), 0.1)
    plate = move_mesh(plate, (0.45, 0.45, 0))
    both = Mesh(
        np.concatenate([FLAT.vertices, plate.vertices]),
        np.concatenate([FLAT.triangles, plate.triangles + len(FLAT.vertices)]),
    )
    pose = np.eye(4)
    pose[:3, :3] = np.diag((1, -1, -1))
    pose[:3, 3] = 0.5, 0.5, 1
    frame = Frame(
        "0",
        Camera(80, 80, 100.0, 100.0, 39.5, 39.5),
        depth=np.ones((80, 80), np.float32),
        world_from_camera=pose,
    )
    points = np.array([(0.5, 0.5, 0), (0.5, 0.5, 0.5), (0.65, 0.5, 0), (0.65, 0.5, 0), (0.95, 0.5, 0)])
    normals = np.array([(0, 0, 1), (0, 0, 1), (0, 0, 1), (0, 0, -1), (0, 0, 1)], float)

    seen = find_seen_points(SurfaceSamples(points, normals), TruthSurface(both), [frame])

    assert seen.tolist() == [False, True, True, False, False]
    samples = SurfaceSamples(points, normals)
    assert find_seen_points(samples, TruthSurface(both), [frame], 0.9).tolist() == [False, True, *[False] * 3]
    lost = dataclasses.replace(frame, world_from_camera=None)
    assert not find_seen_points(SurfaceSamples(points, normals), TruthSurface(both), [lost]).any()


def test_a_known_similarity_is_recovered():
    cube = make_cube()
    turn = np.radians(1.5)
    motion = np.eye(4)
    motion[:3, :3] = 1.02 * np.array(
        [(np.cos(turn), -np.sin(turn), 0), (np.sin(turn), np.cos(turn), 0), (0, 0, 1)]
    )
    motion[:3, 3] = 0.004, -0.006, 0.002

    found = estimate_similarity(transform_mesh(cube, motion), TruthSurface(cube))

    np.testing.assert_allclose(found @ motion, np.eye(4), atol=1e-5)


def test_planar_regions_are_found_on_sheets_and_not_on_spheres():
    slope = np.tan(np.radians(10)) * 0.01
    zigzag = make_sheet(slope * (np.arange(101) % 2))

    places = find_planar_places(zigzag, 200)
    errors = measure_planar_errors(zigzag, places)

    # Centres closer than 20 cm to the border do not have a full disc.
    assert 100 < len(places.centers) <= 200
    assert np.abs(places.normals[:, 2]).min() > 0.999
    assert errors.normal_median_deg == pytest.approx(10, abs=0.2)
    assert errors.normal_p90_deg == pytest.approx(10, abs=0.5)
    for rms in (errors.near_median_m, errors.far_median_m, errors.far_p90_m):
        assert rms == pytest.approx(slope / 12**0.5, rel=0.05)
    assert measure_planar_errors(FLAT, places).far_p90_m < 1e-9

    assert len(find_planar_places(_make_ball(0.15), 100).centers) == 0


def _make_ball(radius: float) -> Mesh:
    from scanloom.stages._open3d import import_open3d

    ball = import_open3d().geometry.TriangleMesh.create_sphere(radius, 30)
    return Mesh(np.asarray(ball.vertices), np.asarray(ball.triangles, np.int32))


def test_planar_regions_missing_from_a_mesh_are_ignored():
    places = find_planar_places(FLAT, 50)
    away = move_mesh(FLAT, (0, 0, 1))

    assert np.isnan(measure_planar_errors(away, places).far_p90_m)


def test_the_filter_removes_noise_and_keeps_a_crease():
    rng = np.random.default_rng(0)
    roof = 0.5 - np.abs(np.linspace(-0.5, 0.5, 51))
    noisy = make_sheet(roof[:, None] + rng.normal(0, 0.002, (51, 51)))
    truth = TruthSurface(make_sheet(roof))

    before, after = (measure_truth_errors(mesh, truth, 20_000) for mesh in (noisy, filter_mesh(noisy)))

    assert after.normal_median_deg < before.normal_median_deg / 4
    assert after.rms_m < 0.7 * before.rms_m
    assert np.ptp(filter_mesh(noisy).vertices[:, 2]) == pytest.approx(np.ptp(noisy.vertices[:, 2]), abs=0.01)


@pytest.mark.slow
@pytest.mark.filterwarnings("default")
def test_the_bench_prints_a_row_per_surface(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    scans = [write_small_scan(tmp_path / name, number) for number, name in enumerate(("made", "found"))]
    # The clean mesh serves as its own truth.
    clean = scanloom.clean(scanloom.fuse(scanloom.read_scan(scans[0])).mesh).mesh
    for name in ("truth.ply", "thin_parts.ply"):
        scanloom.write_mesh(scans[0] / name, clean)
    monkeypatch.setattr("sys.argv", ["shape.py", *map(str, scans), "--bounds", "0.02"])
    shape.main()

    checkout, of_truth, of_planes = capsys.readouterr().out.strip().split("\n\n")
    assert checkout == f"Checkout: {Path(__file__).resolve().parents[2].name}"
    for table, name in ((of_truth, "made"), (of_planes, "found")):
        head, _, *rows = (line.strip("| ").split(" | ") for line in table.splitlines())
        assert [row[:2] for row in rows][:3] == [[name, "clean"], [name, "Open3D"], [name, "normal filter"]]
        assert {len(row) for row in rows} == {len(head)}
    assert of_truth.splitlines()[2].split(" | ")[2:6] == [
        "0.00 / 0.00 / 0.00",
        "0.00° / 0.0°",
        "0.00",
        "100.0 % / 100.0 %",
    ]


def test_the_best_regularised_surface_is_chosen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    scan = scanloom.read_scan(write_small_scan(tmp_path / "made", 0))
    clean = scanloom.clean(scanloom.fuse(scan).mesh).mesh
    # The smallest weight leaves no surface; the second smooths the ball away.
    fast = [dataclasses.replace(regulariser, data_weights=(1e-6, 0.02, 10)) for regulariser in REGULARISERS]
    monkeypatch.setattr(shape, "REGULARISERS", fast)
    errors: list[float] = []

    def measure_error(mesh: Mesh) -> float:
        errors.append(1 - measure_completeness(clean.vertices, mesh))
        return errors[-1]

    surfaces = list(shape.make_regularised_surfaces(scan, measure_error))

    assert [surface.name for surface in surfaces] == [
        *("TV-L1, λ 10", "TGV-L1, λ 10", "TGV-L1, λ 10, refine", "TGV-L2, λ 10", "TGV-L2, λ 10, refine"),
    ]
    assert min(errors) < 0.05 < 0.1 < max(errors)
    assert all(surface.seconds > 0 for surface in surfaces)


def test_regularised_surfaces_need_truth_and_the_option(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    scan = scanloom.read_scan(write_small_scan(tmp_path / "made", 0))
    clean = scanloom.clean(scanloom.fuse(scan).mesh).mesh
    truth = shape.Truth(TruthSurface(clean), clean.vertices, clean.vertices)
    monkeypatch.setattr(shape, "make_regularised_surfaces", lambda _scan, measure: [measure(clean)])

    def count_surfaces(known: shape.Truth | None, *, regularised: bool) -> int:
        options = argparse.Namespace(regularised=regularised, similarity=False)
        return len(list(shape.make_all_surfaces(scan, known, options)))

    assert count_surfaces(truth, regularised=True) == count_surfaces(truth, regularised=False) + 1
    assert count_surfaces(None, regularised=True) == count_surfaces(None, regularised=False)


def test_the_truth_is_found_in_the_folder_or_by_option(tmp_path: Path):
    assert shape.find_truth(tmp_path, None) is None
    assert shape.find_truth(tmp_path, Path("other.ply")) == Path("other.ply")
    (tmp_path / "truth.ply").touch()
    assert shape.find_truth(tmp_path, Path("other.ply")) == tmp_path / "truth.ply"
