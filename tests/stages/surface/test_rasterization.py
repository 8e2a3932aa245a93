import numpy as np
import pytest

from scanloom.stages.surface.rasterization import rasterize_triangles


def make_fan(count: int = 9, seed: int = 0) -> np.ndarray:
    """Make triangles (m, 3, 2) around a point that fill a polygon within 64 × 64 pixels."""
    rng = np.random.default_rng(seed)
    angles = np.sort(rng.random(count)) * 2 * np.pi
    rim = 32 + 30 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return np.stack([np.full((count, 2), 32.0) + rng.random(2), rim, np.roll(rim, -1, axis=0)], axis=1)


def is_inside(corners: np.ndarray, points: np.ndarray) -> np.ndarray:
    a, b, c = corners

    def side(p, q):
        return (q[0] - p[0]) * (points[:, 1] - p[1]) - (q[1] - p[1]) * (points[:, 0] - p[0])

    sides = np.stack([side(a, b), side(b, c), side(c, a)])
    return (sides > 0).all(axis=0) | (sides < 0).all(axis=0)


def test_pixels_have_their_centres_inside():
    triangles = make_fan()
    found = rasterize_triangles(triangles, (0, 64), 64)
    y, x = np.mgrid[0:64, 0:64].reshape(2, -1)
    for number, corners in enumerate(triangles):
        mine = found.triangles == number
        expected = is_inside(corners, np.stack([x, y], axis=1) + 0.5)
        assert set(zip(found.rows[mine], found.columns[mine], strict=True)) == set(
            zip(y[expected], x[expected], strict=True)
        )


def test_weights_reproduce_the_pixel_centre():
    triangles = make_fan()
    found = rasterize_triangles(triangles, (0, 64), 64)
    places = np.einsum("kc,kcx->kx", found.weights, triangles[found.triangles])
    assert places == pytest.approx(np.stack([found.columns, found.rows], axis=1) + 0.5, abs=1e-9)
    assert found.weights.min() >= 0


@pytest.mark.parametrize("seed", range(5))
def test_neighbours_neither_share_nor_miss_pixels(seed):
    # All corners and edges pass through pixel centres, and each centre must belong to exactly one triangle.
    grid = np.stack(np.meshgrid(np.arange(9), np.arange(9)), axis=-1) * 4 + 0.5
    a, b, c, d = grid[:-1, :-1], grid[:-1, 1:], grid[1:, 1:], grid[1:, :-1]
    turned = np.random.default_rng(seed).random((8, 8, 1)) < 0.5
    first = np.where(turned[..., None], np.stack([a, b, c], axis=2), np.stack([a, b, d], axis=2))
    second = np.where(turned[..., None], np.stack([a, c, d], axis=2), np.stack([b, c, d], axis=2))
    triangles = np.concatenate([first, second]).reshape(-1, 3, 2)
    found = rasterize_triangles(triangles, (0, 40), 40)
    counts = np.bincount(found.rows * 40 + found.columns, minlength=1600).reshape(40, 40)
    assert (counts[:32, :32] == 1).all()
    assert counts.sum() == 32 * 32


def test_rasterizing_by_strips_equals_rasterizing_at_once():
    triangles = make_fan()
    whole = rasterize_triangles(triangles, (0, 64), 64)
    parts = [rasterize_triangles(triangles, rows, 64) for rows in ((0, 20), (20, 21), (21, 64))]
    pixels = {(r, c, t) for p in parts for r, c, t in zip(p.rows, p.columns, p.triangles, strict=True)}
    assert pixels == set(zip(whole.rows, whole.columns, whole.triangles, strict=True))
    assert sum(len(part.rows) for part in parts) == len(whole.rows)
