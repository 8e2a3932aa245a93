"""Estimation of the up direction from the surface of a floor."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from scanloom.stages.diagnostics.collector import collecting
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.up_direction import estimate_up_from_surface, estimate_up_of_scene


def make_room(floor: float, *, noise: float = 0.0) -> Mesh:
    """Make a floor with z up, and two larger walls, each as a grid."""
    u, v = (a.reshape(-1) for a in np.meshgrid(*2 * (np.linspace(0, 1, 21),)))
    zero = 0 * u
    parts = [
        np.stack([floor * u, floor * v, zero], axis=1),
        np.stack([zero, u, v], axis=1),
        np.stack([v, zero, u], axis=1),
    ]
    cell = np.arange(20) + 21 * np.arange(20)[:, None]
    square = np.concatenate(
        [np.stack([cell, cell + 1, cell + 22], 2), np.stack([cell, cell + 22, cell + 21], 2)]
    )
    triangles = np.concatenate([square.reshape(-1, 3) + 441 * i for i in range(3)])
    vertices = np.concatenate(parts)
    vertices += noise * np.random.default_rng(0).normal(size=vertices.shape)
    return Mesh(vertices, triangles.astype(np.int32))


@pytest.mark.parametrize("seed", range(8))
def test_a_floor_is_found_from_a_poor_guess_in_any_orientation(seed: int) -> None:
    random = np.random.default_rng(seed)
    turn = Rotation.random(random_state=seed).as_matrix()
    mesh = make_room(0.8, noise=0.001)
    mesh = mesh.with_(vertices=mesh.vertices @ turn.T)
    # A guess with an error of 30°, towards the wall normals or away from them.
    tilt = Rotation.from_rotvec(np.radians(30) * np.array([*_direction(random), 0])).as_matrix()
    found = estimate_up_from_surface(mesh, turn @ tilt @ (0, 0, 1))
    assert found is not None
    assert np.degrees(np.arccos(found @ turn[:, 2])) < 1


def _direction(random: np.random.Generator) -> tuple[float, float]:
    angle = random.uniform(0, 2 * np.pi)
    return np.cos(angle), np.sin(angle)


@pytest.mark.parametrize("seed", range(4))
def test_a_small_floor_is_better_than_cameras(seed: int) -> None:
    # 0.7 % of the surface, as in a room with few frames of its floor.
    turn = Rotation.random(random_state=seed).as_matrix()
    mesh = make_room(0.12, noise=0.0002)
    mesh = mesh.with_(vertices=mesh.vertices @ turn.T)
    tilt = Rotation.from_euler("x", 20 + seed, degrees=True).as_matrix()
    poses = np.tile(np.eye(4), (3, 1, 1))
    # Level cameras that look along three horizontal axes of a world that is tilted by 20°.
    for pose, angle in zip(poses, (0, 40, 80), strict=True):
        level = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])
        pose[:3, :3] = turn @ tilt @ Rotation.from_euler("z", angle, degrees=True).as_matrix() @ level
    found = estimate_up_of_scene(mesh, poses)
    assert found.source == "surface"
    assert np.degrees(np.arccos(found.direction @ turn[:, 2])) < 1.5


def test_a_small_shelf_is_no_floor() -> None:
    mesh = make_room(0.12)
    # The first 441 vertices are on the floor.
    vertices = mesh.vertices.copy()
    vertices[:441, 2] = 0.5
    assert estimate_up_from_surface(mesh.with_(vertices=vertices), np.array((0.0, 0.0, 1.0))) is None


def test_walls_without_floor_give_no_up_direction() -> None:
    mesh = make_room(0.0)
    walls = Mesh(mesh.vertices, mesh.triangles[800:])
    assert estimate_up_from_surface(walls, np.array((0.0, 0.0, 1.0))) is None
    assert (
        estimate_up_from_surface(
            Mesh(np.zeros((3, 3)), np.array([[0, 1, 2]], np.int32)), np.array((0.0, 0, 1))
        )
        is None
    )


def make_poses(*, roll: float = 0.0, level: float = 20.0, across: float = 90.0, count: int = 8) -> np.ndarray:
    """Make poses in a world with z up: tilted down by `level` degrees and rolled by `roll` degrees."""
    poses = np.tile(np.eye(4), (count, 1, 1))
    for pose, azimuth in zip(poses, np.radians(np.linspace(-across / 2, across / 2, count)), strict=True):
        down = np.radians(level)
        z = np.array((np.cos(azimuth) * np.cos(down), np.sin(azimuth) * np.cos(down), -np.sin(down)))
        x = np.cross(z, (0, 0, 1))
        x /= np.linalg.norm(x)
        pose[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
        pose[:3, :3] = pose[:3, :3] @ Rotation.from_euler("z", roll, degrees=True).as_matrix()
    return poses


def test_a_known_direction_consistent_with_the_scan_is_used() -> None:
    tilt = Rotation.from_euler("xyz", (0, 4, 0), degrees=True).apply((0, 0, 1))
    found = estimate_up_of_scene(make_room(0.8), make_poses(), (tilt, "gravity of the IMU"))
    np.testing.assert_array_equal(found.direction, tilt)
    assert found.source == "gravity of the IMU"
    # A direction within one degree of an axis is snapped to the axis.
    near = Rotation.from_euler("xyz", (0.5, 0.5, 0), degrees=True).apply((0, 0, 1))
    np.testing.assert_array_equal(
        estimate_up_of_scene(make_room(0.8), make_poses(), (near, "known")).direction, (0, 0, 1)
    )


@pytest.mark.parametrize("known", [(0.0, 1.0, 0.0), (0.0, 0.0, -1.0), (1.0, 0.0, 0.0)])
def test_a_known_direction_contradicting_the_scan_is_used_with_a_warning(
    known: tuple[float, float, float],
) -> None:
    # Rotated by more than 180° in total, so that no side of the images has a constant direction.
    with collecting() as diagnostics:
        found = estimate_up_of_scene(make_room(0.8), make_poses(across=300), (known, "layout other: wrong"))
    np.testing.assert_array_equal(found.direction, known)
    (doubt,) = diagnostics
    off = 180 if known[2] else 90
    assert str(doubt) == (
        f"the up direction from layout other: wrong differs by {off}° from the cameras' up direction "
        f"and by {off}° from the main direction of the surface; set upright.up=AXIS if it is wrong"
    )


@pytest.mark.parametrize("roll", [90, -90])
def test_a_phone_in_portrait_orientation_gives_no_warning(roll: float) -> None:
    with collecting() as diagnostics:
        estimate_up_of_scene(make_room(0.8), make_poses(roll=roll), ((0.0, 0.0, 1.0), "layout polycam: y up"))
    assert diagnostics == []
    # Without that information, the side of the images would be up.
    assert estimate_up_of_scene(make_room(0.8), make_poses(roll=roll)).direction @ (0, 0, 1) < 0.5


@pytest.mark.parametrize("turned", [(0,), (0, 5, 6, 11)])
def test_rolled_cameras_around_an_object_give_the_axis_as_up(turned: tuple[int, ...]) -> None:
    """Some cameras are on the other side, like an arm that turns over."""
    poses = make_poses(roll=90, across=330, count=12)
    for k in turned:
        poses[k, :3, :2] *= -1
    place = Mesh(np.zeros((3, 3)), np.array([[0, 1, 2]], np.int32))
    found = estimate_up_of_scene(place, poses)
    assert found.source == "cameras"
    assert found.direction @ (0, 0, 1) > 0.99


def test_upright_cameras_give_their_up_direction() -> None:
    place = Mesh(np.zeros((3, 3)), np.array([[0, 1, 2]], np.int32))
    for level in (-40.0, 0.0, 60.0):
        found = estimate_up_of_scene(place, make_poses(level=level, across=330, count=12))
        assert found.direction @ (0, 0, 1) > 0.99
