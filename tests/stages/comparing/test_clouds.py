"""Point clouds compared with surfaces and clouds, checked against formulas and brute-force searches."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from clouds import make_cloud
from coloured_sheet import make_bumpy_body
from hypothesis import given, settings
from hypothesis import strategies as st

from scanloom import Mesh, align, changes, compare, deviations
from scanloom.stages.diagnostics.errors import InputError, MeshError

Floats = np.ndarray
SEEDS = st.integers(0, 10_000)


def make_box(half: Floats, offset: Floats, color: tuple[int, int, int] | None = None) -> Mesh:
    made = trimesh.creation.box(extents=2 * half)
    colors = None if color is None else np.tile(np.array(color, np.uint8), (8, 1))
    return Mesh(np.array(made.vertices) + offset, np.array(made.faces, np.int32), colors)


def compute_box_distances(points: Floats, half: Floats) -> Floats:
    """Compute signed distances from a box at the origin by formula."""
    beyond = np.abs(points) - half
    return np.linalg.norm(np.maximum(beyond, 0), axis=1) + np.minimum(beyond.max(axis=1), 0)


def find_nearest_points(points: Floats, others: Floats) -> tuple[Floats, np.ndarray]:
    """Compute distances and indices of the nearest points by brute force."""
    distances = np.linalg.norm(points[:, None] - others, axis=2)
    return distances.min(axis=1), distances.argmin(axis=1)


def make_sheet(count: int, height: float, rng: np.random.Generator, size: float = 1.0) -> Mesh:
    """Make random points of a level square with normals up."""
    points = np.column_stack([rng.uniform(-size, size, (count, 2)), np.full(count, height)])
    return make_cloud(points, normals=np.tile((0.0, 0.0, 1.0), (count, 1)))


FLOOR = Mesh(
    np.array([[-2, -2, 0], [2, -2, 0], [2, 2, 0], [-2, 2, 0.0]]), np.array([[0, 1, 2], [0, 2, 3]], np.int32)
)


@settings(max_examples=40, deadline=None)
@given(SEEDS)
def test_distances_from_a_box_agree_with_its_formula(seed: int) -> None:
    rng = np.random.default_rng(seed)
    half, offset = rng.uniform(0.2, 2, 3), rng.normal(size=3) * 10.0 ** rng.integers(0, 7)
    points = rng.uniform(-3, 3, (200, 3))
    wanted = compute_box_distances(points, half)
    found = deviations(make_box(half, offset), make_cloud(points + offset), tolerance=0.5)
    told = found.to_dict()
    # The precision of numbers so far from the origin.
    exact = 1e-6 + 4 * np.spacing(np.abs(offset).max())
    np.testing.assert_allclose(found.sample_distances, wanted, atol=exact)
    np.testing.assert_array_equal(found.vertex_distances, found.sample_distances)
    assert told["is_signed"]
    assert told["is_cloud"]
    assert told["samples"] == 200
    assert told["reference_spacing_m"] is None
    assert told["rms_m"] == pytest.approx(np.sqrt((wanted**2).mean()), abs=exact)
    assert told["mean_m"] == pytest.approx(wanted.mean(), abs=exact)
    assert told["absolute_percentiles_m"]["90"] == pytest.approx(np.percentile(np.abs(wanted), 90), abs=exact)
    assert told["worst"][0]["distance_m"] == pytest.approx(wanted[np.abs(wanted).argmax()], abs=exact)


@settings(max_examples=30, deadline=None)
@given(SEEDS)
def test_two_clouds_are_compared_point_by_point(seed: int) -> None:
    rng = np.random.default_rng(seed)
    clouds = []
    for count in rng.integers(2, 120, 2):
        colors = rng.integers(0, 256, (count, 3), np.uint8)
        clouds.append(make_cloud(rng.normal(size=(count, 3)), colors))
    a, b = clouds
    found = compare(a, b)
    squares = []
    for ours, one, other in ((found.a_to_b, a, b), (found.b_to_a, b, a)):
        distances, nearest = find_nearest_points(one.vertices, other.vertices)
        assert ours.maximum == pytest.approx(distances.max(), rel=2e-6)
        assert ours.mean == pytest.approx(distances.mean(), rel=2e-6)
        assert ours.rms == pytest.approx(np.sqrt((distances**2).mean()), rel=2e-6)
        squares.append((distances**2).mean())
        difference = one.colors.astype(float) - other.colors[nearest]
        color = found.color_a_to_b if one is a else found.color_b_to_a
        assert color.rmse == pytest.approx(np.sqrt((difference**2).mean()))
        assert color.maximum == np.abs(difference).max()
    # Both directions have the same weight, independent of the point counts.
    assert found.symmetric.rms == pytest.approx(np.sqrt(np.mean(squares)), rel=2e-6)
    assert found.symmetric.maximum == max(found.a_to_b.maximum, found.b_to_a.maximum)


@settings(max_examples=20, deadline=None)
@given(SEEDS, st.floats(-0.3, 0.3))
def test_points_above_a_floor_and_a_floor_below_points(seed: int, height: float) -> None:
    points = make_sheet(3000, height, np.random.default_rng(seed))
    found = deviations(FLOOR, points).to_dict()
    assert found["mean_m"] == pytest.approx(height, abs=1e-7)
    assert found["standard_deviation_m"] == pytest.approx(0, abs=1e-7)
    assert found["lowest_m"] == pytest.approx(found["highest_m"], abs=1e-7)
    # In the other direction, the floor is below the upward-facing points.
    small = FLOOR.with_(vertices=FLOOR.vertices * 0.4)
    back = deviations(points, small, signed_samples=5000)
    told = back.to_dict()
    assert told["is_signed"]
    assert not told["is_cloud"]
    assert np.abs(back.sample_distances).min() >= abs(height) - 1e-9
    assert np.sign(told["mean_m"]) == -np.sign(height) or abs(height) < 1e-6
    # Lateral distances to the nearest point are about the point spacing.
    spacing = told["reference_spacing_m"]
    aside = np.sqrt(back.sample_distances**2 - height**2 + 1e-12)
    assert 0.5 * spacing < np.median(aside) < 2.5 * spacing


def test_without_normals_there_are_no_signs() -> None:
    points = make_sheet(200, 0.1, np.random.default_rng(1))
    for normals in (None, np.zeros((200, 3))):
        told = deviations(points.with_(normals=normals), FLOOR, signed_samples=100).to_dict()
        assert not told["is_signed"]
        assert told["mean_m"] is told["lowest_m"] is None


def test_the_spacing_of_a_lattice_ignores_duplicate_points() -> None:
    lattice = np.stack(np.meshgrid(*[np.arange(12) * 0.25] * 3), axis=-1).reshape(-1, 3)
    points = make_cloud(np.concatenate([lattice, lattice[:700]]))
    found = compare(points, points)
    assert found.clouds[0].spacing_m == pytest.approx(0.25)
    assert found.to_dict()["clouds"]["b"] == {
        "points": len(points.vertices),
        "spacing_m": pytest.approx(0.25),
    }
    assert found.symmetric.maximum == 0
    assert "cloud of 2,428 points" in repr(found)
    assert "clouds" not in compare(FLOOR, FLOOR, samples=10).to_dict()


def test_colours_of_a_cloud_and_a_surface() -> None:
    rng = np.random.default_rng(4)
    half = np.full(3, 0.5)
    points = rng.uniform(-1, 1, (300, 3))
    red = np.tile(np.array((200, 30, 30), np.uint8), (300, 1))
    reference = make_box(half, np.zeros(3), (190, 30, 30))
    found = compare(reference, make_cloud(points, red), samples=500)
    assert found.color_a_to_b.rmse == pytest.approx(10 / np.sqrt(3))
    assert found.color_b_to_a.rmse == pytest.approx(10 / np.sqrt(3))
    told = deviations(reference, make_cloud(points, red))
    assert 1 < told.to_dict()["delta_e_2000"]["mean"] < 5
    assert told.painted_mesh.colors.shape == (300, 3)
    assert compare(reference, make_cloud(points), samples=10).color is None


def test_a_distant_cloud_takes_no_longer() -> None:
    rng = np.random.default_rng(5)
    floor = make_sheet(40_000, 0.0, rng)
    far = make_cloud(floor.vertices + np.array((4e5, 5.2e6, 310)))
    found = compare(floor, far)
    assert found.a_to_b.mean == pytest.approx(np.linalg.norm((4e5, 5.2e6, 310)), rel=1e-6)


@settings(max_examples=6, deadline=None)
@given(st.integers(0, 1000), st.booleans(), st.booleans())
def test_a_moved_cloud_is_aligned_with_its_surface_and_vice_versa(
    seed: int, onto_cloud: bool, has_normals: bool
) -> None:
    rng = np.random.default_rng(seed)
    away = np.array((4e5, 5.2e6, 300.0))
    body = make_bumpy_body()
    body = body.with_(vertices=body.vertices + away)
    points, of = trimesh.sample.sample_surface(
        trimesh.Trimesh(body.vertices, body.triangles, process=False), 20_000, seed=seed
    )
    normals = trimesh.Trimesh(body.vertices, body.triangles, process=False).face_normals[of]
    sampled = make_cloud(np.asarray(points), normals=np.asarray(normals) if has_normals else None)
    turn = trimesh.transformations.rotation_matrix(np.radians(4), rng.normal(size=3), away)
    shift = rng.uniform(-0.03, 0.03, 3)

    def moved(mesh: Mesh) -> Mesh:
        return mesh.with_(vertices=mesh.vertices @ turn[:3, :3].T + turn[:3, 3] + shift)

    given, reference = (body, sampled) if onto_cloud else (sampled, body)
    back, how = align(moved(given), reference)
    np.testing.assert_allclose(back.vertices, given.vertices, atol=4e-3)
    assert how.overlap_ratio > 0.99
    assert how.rms_m < 3e-3


def test_alignment_reports_point_to_plane_distances() -> None:
    """Independent samples of a surface are apart, but on the same planes."""
    body = make_bumpy_body()
    _, how = align(body, body)
    assert how.rms_m < 1e-3


def test_input_without_extent_or_area_is_refused() -> None:
    with pytest.raises(InputError, match="first mesh: it has no triangles, and all its points coincide"):
        compare(make_cloud(np.ones((3, 3))), FLOOR)
    with pytest.raises(InputError, match=r"mesh: .*too large"):
        deviations(FLOOR, make_cloud(np.array([[1e200, 0, 0], [0, 0, 0]])))
    with pytest.raises(MeshError, match="later: it has no triangles"):
        changes(FLOOR, make_cloud(np.eye(3)))
