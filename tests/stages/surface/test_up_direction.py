"""What is up is found from the surface, where a floor is to be seen."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from scanloom.stages.diagnostics.collector import collecting
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.up_direction import estimate_up_from_surface, estimate_up_of_scene


def room(floor: float, *, noise: float = 0.0) -> Mesh:
    """Return a floor with z up, and two larger walls, each of a grid."""
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
def test_a_floor_is_found_from_a_guess_that_is_far_off_however_it_is_turned(seed: int) -> None:
    random = np.random.default_rng(seed)
    turn = Rotation.random(random_state=seed).as_matrix()
    mesh = room(0.8, noise=0.001)
    mesh = mesh.with_(vertices=mesh.vertices @ turn.T)
    # 30° off, away from the walls' own normals or towards them.
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
    mesh = room(0.12, noise=0.0002)
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
    mesh = room(0.12)
    # The first 441 vertices are those of the floor.
    vertices = mesh.vertices.copy()
    vertices[:441, 2] = 0.5
    assert estimate_up_from_surface(mesh.with_(vertices=vertices), np.array((0.0, 0.0, 1.0))) is None


def test_walls_alone_do_not_tell() -> None:
    mesh = room(0.0)
    walls = Mesh(mesh.vertices, mesh.triangles[800:])
    assert estimate_up_from_surface(walls, np.array((0.0, 0.0, 1.0))) is None
    assert (
        estimate_up_from_surface(
            Mesh(np.zeros((3, 3)), np.array([[0, 1, 2]], np.int32)), np.array((0.0, 0, 1))
        )
        is None
    )


def looking(*, roll: float = 0.0, level: float = 20.0, across: float = 90.0, count: int = 8) -> np.ndarray:
    """Poses of a world with z up that look about, some degrees down, held at a roll."""
    poses = np.tile(np.eye(4), (count, 1, 1))
    for pose, azimuth in zip(poses, np.radians(np.linspace(-across / 2, across / 2, count)), strict=True):
        down = np.radians(level)
        z = np.array((np.cos(azimuth) * np.cos(down), np.sin(azimuth) * np.cos(down), -np.sin(down)))
        x = np.cross(z, (0, 0, 1))
        x /= np.linalg.norm(x)
        pose[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
        pose[:3, :3] = pose[:3, :3] @ Rotation.from_euler("z", roll, degrees=True).as_matrix()
    return poses


def test_what_is_known_is_taken_where_the_scan_agrees() -> None:
    tilt = Rotation.from_euler("xyz", (0, 4, 0), degrees=True).apply((0, 0, 1))
    found = estimate_up_of_scene(room(0.8), looking(), (tilt, "gravity of the IMU"))
    np.testing.assert_array_equal(found.direction, tilt)
    assert found.source == "gravity of the IMU"
    # An axis that is within a degree is meant.
    near = Rotation.from_euler("xyz", (0.5, 0.5, 0), degrees=True).apply((0, 0, 1))
    np.testing.assert_array_equal(
        estimate_up_of_scene(room(0.8), looking(), (near, "known")).direction, (0, 0, 1)
    )


@pytest.mark.parametrize("known", [(0.0, 1.0, 0.0), (0.0, 0.0, -1.0), (1.0, 0.0, 0.0)])
def test_what_is_known_is_taken_and_doubted_where_nothing_agrees(known: tuple[float, float, float]) -> None:
    # Turned about by more than a half, so that no side of the images always looks one way.
    with collecting() as diagnostics:
        found = estimate_up_of_scene(room(0.8), looking(across=300), (known, "layout other: wrong"))
    np.testing.assert_array_equal(found.direction, known)
    (doubt,) = diagnostics
    off = 180 if known[2] else 90
    assert str(doubt) == (
        f"the up direction from layout other: wrong differs by {off}° from the cameras' up direction "
        f"and by {off}° from the main direction of the surface; set upright.up=AXIS if it is wrong"
    )


@pytest.mark.parametrize("roll", [90, -90])
def test_a_phone_held_in_portrait_is_no_doubt(roll: float) -> None:
    with collecting() as diagnostics:
        estimate_up_of_scene(room(0.8), looking(roll=roll), ((0.0, 0.0, 1.0), "layout polycam: y up"))
    assert diagnostics == []
    # Without that knowledge its side is up.
    assert estimate_up_of_scene(room(0.8), looking(roll=roll)).direction @ (0, 0, 1) < 0.5


@pytest.mark.parametrize("turned", [(0,), (0, 5, 6, 11)])
def test_cameras_on_their_side_around_a_thing_stand_on_its_axis(turned: tuple[int, ...]) -> None:
    """Some of them on the other side, as of an arm that turns over."""
    poses = looking(roll=90, across=330, count=12)
    for k in turned:
        poses[k, :3, :2] *= -1
    place = Mesh(np.zeros((3, 3)), np.array([[0, 1, 2]], np.int32))
    found = estimate_up_of_scene(place, poses)
    assert found.source == "cameras"
    assert found.direction @ (0, 0, 1) > 0.99


def test_cameras_on_their_feet_stay_so() -> None:
    place = Mesh(np.zeros((3, 3)), np.array([[0, 1, 2]], np.int32))
    for level in (-40.0, 0.0, 60.0):
        found = estimate_up_of_scene(place, looking(level=level, across=330, count=12))
        assert found.direction @ (0, 0, 1) > 0.99
