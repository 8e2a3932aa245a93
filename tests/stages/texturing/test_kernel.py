"""Texturing kernels, compared with independent implementations and across thread counts."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from coloured_meshes import ball, color_trimesh
from wall_photos import CAMERA, make_grazing_photo, paint, photos, pose, wall

from scanloom.stages import Mesh, _kernels
from scanloom.stages.progress import ignore_progress
from scanloom.stages.scans.model.poses import invert_pose
from scanloom.stages.surface.raycasting import RaycastingSurface
from scanloom.stages.surface.vertex_normals import compute_vertex_normals
from scanloom.stages.texturing.exposure import make_identity_exposure
from scanloom.stages.texturing.photo_sampling import prepare_render_mesh, sample_photos, to_kernel_camera
from scanloom.stages.texturing.photos import load_photos
from scanloom.stages.texturing.seam_visibility import SeamStatistics


def make_kernel_camera(place: np.ndarray) -> tuple:
    return to_kernel_camera(CAMERA, invert_pose(place))


@pytest.mark.parametrize("shape", ["ball", "room"])
def test_the_z_buffer_agrees_with_ray_casting(shape):
    # From outside a sphere, and from inside a room with walls behind the camera.
    mesh = ball() if shape == "ball" else color_trimesh(trimesh.creation.box((3, 2, 4)))
    place = pose(0.1, 0.05, z=-2.5) if shape == "ball" else pose(0.3, -0.2, z=0.4, turn=40)
    depth, triangles = _kernels.MeshRenderer(mesh.vertices, mesh.triangles).render_zbuffer(
        make_kernel_camera(place), near=1e-3
    )
    rows, columns = np.mgrid[: CAMERA.height, : CAMERA.width]
    x, y = (columns - CAMERA.cx) / CAMERA.fx, (rows - CAMERA.cy) / CAMERA.fy
    rays = np.stack([x, y, np.ones(x.shape)], axis=-1).reshape(-1, 3) @ place[:3, :3].T
    hits = RaycastingSurface(mesh).cast_rays(place[:3, 3], rays.astype(np.float32))
    expected = np.full(rows.size, np.inf)
    expected[hits.rays] = hits.distances
    seen = np.isfinite(depth.ravel())
    # Rounding may decide at the pixels of an outline.
    assert np.mean(seen != np.isfinite(expected)) < 2e-3
    both = seen & np.isfinite(expected)
    assert both.any()
    off = np.abs(depth.ravel()[both] - expected[both])
    assert np.quantile(off, 0.995) < 1e-4
    same = np.full(rows.size, -1)
    same[hits.rays] = hits.triangles
    assert np.mean(same[both] == triangles.ravel()[both]) > 0.99


@pytest.mark.parametrize("seed", range(3))
def test_the_z_buffer_keeps_the_nearest_of_many_parts(seed):
    # Hills of many parts in random order, most of them not in front of the camera.
    rng = np.random.default_rng(seed)
    x, y = np.meshgrid(np.arange(70.0), np.arange(70.0))
    hills = np.stack([x, y, 3 * np.sin(x / 5) * np.cos(y / 4)], -1).reshape(-1, 3) / 20
    at = (np.arange(69) + 70 * np.arange(69)[:, None]).ravel()
    faces = np.concatenate([np.stack([at, at + 1, at + 71], -1), np.stack([at, at + 71, at + 70], -1)])
    faces = rng.permutation(faces).astype(np.int32)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    place = np.eye(4)
    place[:3, :3], place[:3, 3] = turn * np.linalg.det(turn), rng.uniform((1, 1, -1), (2.5, 2.5, 1))
    mesh = _kernels.MeshRenderer(hills, faces)
    parts = mesh.triangle_clusters()
    assert len(np.unique(parts)) > 20
    depth, triangles = mesh.render_zbuffer(make_kernel_camera(place), near=1e-3)
    # Reference: each few triangles are rendered separately and combined by depth; ties go to the first.
    nearest, seen = np.full(depth.shape, np.float32(np.inf)), np.full(depth.shape, -1)
    for rows in np.array_split(np.arange(len(faces)), 97):
        alone, own = _kernels.MeshRenderer(hills, faces[rows]).render_zbuffer(
            make_kernel_camera(place), near=1e-3
        )
        is_nearer = alone < nearest
        nearest[is_nearer], seen[is_nearer] = alone[is_nearer], rows[own[is_nearer]]
    np.testing.assert_array_equal(depth, nearest)
    np.testing.assert_array_equal(triangles, seen)
    assert 0 < len(np.unique(parts[seen[seen >= 0]])) < len(np.unique(parts))


def test_results_do_not_depend_on_the_number_of_threads():
    mesh, frames = wall(), photos(5)
    of = np.repeat(np.arange(len(mesh.triangles), dtype=np.uint32), 100)
    shares = np.random.default_rng(0).dirichlet((1, 1, 1), len(of)).astype(np.float32)
    found = []
    for threads in (1, 2, 5):
        points = _kernels.SurfacePoints(
            mesh.vertices, compute_vertex_normals(mesh), mesh.triangles, of, shares, samples_per_point=3
        )
        one = load_photos(frames, ignore_progress)
        sample_photos(
            points, prepare_render_mesh(mesh), one, [make_identity_exposure()] * len(one), None, lambda: None
        )
        blended = points.blend(blurred=1, details=3, deviations=3, levels=12, wanted_threads=threads)
        found.append([*points.samples(), points.density(), *blended])
    for others in found[1:]:
        assert all(np.array_equal(a, b) for a, b in zip(found[0], others, strict=True))


def test_the_best_views_come_first_and_show_the_paint():
    mesh, frames = wall(), photos(8)
    of = np.arange(len(mesh.triangles), dtype=np.uint32)
    shares = np.full((len(of), 3), 1 / 3, np.float32)
    points = _kernels.SurfacePoints(
        mesh.vertices, compute_vertex_normals(mesh), mesh.triangles, of, shares, samples_per_point=4
    )
    one = load_photos(frames, ignore_progress)
    sample_photos(
        points, prepare_render_mesh(mesh), one, [make_identity_exposure()] * len(one), None, lambda: None
    )
    views, colors, scores = points.samples()
    assert (np.diff(scores, axis=1) <= 0).all()
    assert ((views >= 0) == (scores > 0)).all()
    middles = mesh.vertices[mesh.triangles].mean(axis=1)
    inner = (np.abs(middles[:, :2] - 0.5) < 0.3).all(axis=1)
    truth = paint(middles[:, 0], middles[:, 1])
    off = np.abs(colors[inner].astype(float) - truth[inner, None]).max(axis=2)
    assert np.median(off[views[inner] >= 0]) < 2
    density = points.density()
    assert np.median(density[inner]) == pytest.approx(CAMERA.fx / 0.8, rel=0.1)
    assert (views[inner, 0] >= 0).all()


def compute_seam_ratio(image: np.ndarray, labels: np.ndarray) -> float | None:
    sums = SeamStatistics()
    sums.add(image, labels)
    return sums.compute_ratio()


def test_a_seam_increases_the_ratio():
    rng = np.random.default_rng(1)
    image = (120 + 3 * rng.standard_normal((64, 64, 3))).astype(np.float32)
    labels = np.zeros((64, 64), np.int32)
    labels[:, 32:] = 1
    labels = np.tile(labels, (1, 4))
    image = np.tile(image, (1, 4, 1))
    assert compute_seam_ratio(image, labels) == pytest.approx(1, abs=0.1)
    stepped = image + 20 * (labels[..., None] == 1)
    assert compute_seam_ratio(stepped.astype(np.float32), labels) > 2
    assert compute_seam_ratio(image, np.zeros_like(labels)) is None


def sample_wall(frames: list, order: list[int]) -> _kernels.SurfacePoints:
    """Sample points all over the wall from some of the frames."""
    mesh = wall()
    of = np.repeat(np.arange(len(mesh.triangles), dtype=np.uint32), 20)
    shares = np.random.default_rng(0).dirichlet((1, 1, 1), len(of)).astype(np.float32)
    points = _kernels.SurfacePoints(
        mesh.vertices, compute_vertex_normals(mesh), mesh.triangles, of, shares, samples_per_point=3
    )
    one = load_photos([frames[number] for number in order], ignore_progress)
    # Relative sharpness needs consecutive photos, which these are not.
    one = replace(one, weights=np.ones(len(one)))
    sample_photos(
        points, prepare_render_mesh(mesh), one, [make_identity_exposure()] * len(one), None, lambda: None
    )
    return points


@pytest.mark.parametrize("order", [[0, 1, 2, 3], [3, 2, 1, 0], [1, 3, 0, 2]])
def test_an_oblique_photo_is_used_only_without_alternatives(order):
    frames = [*photos(3), make_grazing_photo(3)]
    without, flat = sample_wall(frames, [n for n in order if n != 3]), sample_wall(frames, order)
    named = [np.append(chosen, -1) for chosen in ([n for n in order if n != 3], order)]
    straight = without.samples()[0][:, 0] >= 0
    assert 0.5 < straight.mean() < 1
    np.testing.assert_array_equal(flat.grazing_mask(), ~straight & (flat.density() > 0))
    assert flat.grazing_mask().any()
    assert not without.grazing_mask().any()

    before, after = without.samples(), flat.samples()
    np.testing.assert_array_equal(named[0][before[0]][straight], named[1][after[0]][straight])
    for one, other in zip(before[1:], after[1:], strict=True):
        np.testing.assert_array_equal(one[straight], other[straight])
    np.testing.assert_array_equal(without.density()[straight], flat.density()[straight])
    only = named[1][after[0]][flat.grazing_mask()]
    assert (only[:, 0] == 3).all()
    assert (only[:, 1:] == -1).all()


def test_a_single_photo_may_be_more_oblique():
    # At 88° and more on the farther half.
    low = replace(make_grazing_photo(0, z=-0.03, turn=-85), depth=None)
    away = replace(low, name="away", world_from_camera=pose(9, 9))
    alone, beside = sample_wall([low], [0]), sample_wall([low, away], [0, 1])
    assert alone.grazing_mask().mean() > 0.5
    assert beside.grazing_mask().mean() < 0.2 * alone.grazing_mask().mean()


def test_an_oblique_photo_does_not_see_through_occluders():
    mesh, frame = wall(), replace(make_grazing_photo(0), depth=None)
    # A board perpendicular to the wall that hides the part farther from the camera.
    board = Mesh(
        np.array([(0.5, 0, 0), (0.5, 1, 0), (0.5, 1, -0.4), (0.5, 0, -0.4)]),
        np.array([(0, 1, 2), (0, 2, 3), (0, 2, 1), (0, 3, 2)], np.int32),
    )
    both = Mesh(
        np.concatenate([mesh.vertices, board.vertices]),
        np.concatenate([mesh.triangles, board.triangles + len(mesh.vertices)]).astype(np.int32),
    )
    of = np.arange(len(mesh.triangles), dtype=np.uint32)
    shares = np.full((len(of), 3), 1 / 3, np.float32)
    points = _kernels.SurfacePoints(
        both.vertices, compute_vertex_normals(both), both.triangles, of, shares, samples_per_point=1
    )
    one = load_photos([frame], ignore_progress)
    sample_photos(points, prepare_render_mesh(both), one, [make_identity_exposure()], None, lambda: None)
    x = mesh.vertices[mesh.triangles].mean(axis=1)[:, 0]
    seen = points.density() > 0
    # One pixel, a tenth of the distance here, may be wrong.
    assert not seen[x < 0.3].any()
    assert seen[(x > 0.55) & (x < 0.9)].mean() > 0.4
