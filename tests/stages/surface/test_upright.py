"""What is up is found from the surface, where a floor is to be seen."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stages.surface.mesh import Mesh
from stages.surface.upright import up_of_surface


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
    found = up_of_surface(mesh, turn @ tilt @ (0, 0, 1))
    assert found is not None
    assert np.degrees(np.arccos(found @ turn[:, 2])) < 1


def _direction(random: np.random.Generator) -> tuple[float, float]:
    angle = random.uniform(0, 2 * np.pi)
    return np.cos(angle), np.sin(angle)


def test_walls_alone_do_not_tell() -> None:
    mesh = room(0.0)
    walls = Mesh(mesh.vertices, mesh.triangles[800:])
    assert up_of_surface(walls, np.array((0.0, 0.0, 1.0))) is None
    assert (
        up_of_surface(Mesh(np.zeros((3, 3)), np.array([[0, 1, 2]], np.int32)), np.array((0.0, 0, 1))) is None
    )
