"""Comparison of rendered images of two meshes: PSNR and SSIM by formula, over pixels that both cover."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from scipy.ndimage import binary_erosion, gaussian_filter
from seamed_meshes import wrapped_ball

from scanloom import Mesh, compare_views
from scanloom.stages.comparing.mesh_rendering import render_from_pose
from scanloom.stages.diagnostics.errors import MeshError, UsageError
from scanloom.stages.rendering.image_comparison import _upscale_camera
from scanloom.stages.rendering.viewpoints import viewpoints
from scanloom.stages.surface.raycasting import RaycastingSurface

WIDTH = 96


def ball(color: int | None, subdivisions: int = 3, radius: float = 1.0) -> Mesh:
    made = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    colors = None if color is None else np.full((len(made.vertices), 3), color, np.uint8)
    return Mesh(np.array(made.vertices), np.array(made.faces, np.int32), colors)


def test_equal_meshes_have_equal_images() -> None:
    for mesh in (ball(90), ball(None), wrapped_ball()):
        told = compare_views(mesh, mesh, views=3, view_width=WIDTH).to_dict()
        assert told["psnr_db"] is None
        assert told["ssim"] == pytest.approx(1)
        assert told["silhouette_iou"] == 1
        assert [one["viewpoint"] for one in told["each"]] == ["view1", "view2", "view3"]
        assert told["pixels_compared"] > 1000


def test_two_greys_differ_by_the_formulas() -> None:
    found = compare_views(ball(100), ball(110), views=2, view_width=WIDTH)
    told = found.to_dict()
    assert told["compared"] == "colors"
    assert told["psnr_db"] == pytest.approx(20 * np.log10(255 / 10), abs=1e-3)
    # For constant images, only the first factor of SSIM differs from 1.
    small = (0.01 * 255) ** 2
    assert told["ssim"] == pytest.approx((2 * 100 * 110 + small) / (100**2 + 110**2 + small), abs=1e-5)
    assert told["silhouette_iou"] == 1


def compute_ssim(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Compute SSIM around each pixel (Wang et al.), weighted by a Gaussian of 1.5 pixels."""

    def mean(values: np.ndarray) -> np.ndarray:
        return gaussian_filter(values, 1.5, truncate=3.5)

    c1, c2 = (0.01 * 255) ** 2, (0.03 * 255) ** 2
    ma, mb = mean(a), mean(b)
    va, vb, both = mean(a * a) - ma**2, mean(b * b) - mb**2, mean(a * b) - ma * mb
    return (2 * ma * mb + c1) * (2 * both + c2) / ((ma**2 + mb**2 + c1) * (va + vb + c2))


def test_psnr_and_ssim_of_noise_follow_the_formulas_over_common_pixels() -> None:
    rng = np.random.default_rng(3)
    noise = ball(100, 5)
    colors = rng.integers(0, 256, noise.colors.shape, np.uint8)
    noise = noise.with_(colors=colors)
    less = noise.with_(colors=(128 + 0.5 * (colors.astype(float) - 128)).astype(np.uint8))
    found = compare_views(noise, less, views=1, view_width=WIDTH)
    (view,) = viewpoints(noise, 1, width=WIDTH)
    seen = render_from_pose(RaycastingSurface(noise), _upscale_camera(view.camera), view.world_from_camera)
    covered = seen.hit_mask.reshape(72, 2, WIDTH, 2).all(axis=(1, 3))
    assert found.scores[0].pixels == covered.sum()
    picture = found.scores[0].image.astype(np.float64)
    a, b = picture[:, :WIDTH], picture[:, WIDTH : 2 * WIDTH]
    mse = ((a - b)[covered] ** 2).mean()
    assert found.to_dict()["psnr_db"] == pytest.approx(10 * np.log10(255**2 / mse), abs=0.02)
    whole = binary_erosion(covered, np.ones((11, 11)))
    assert whole.sum() > 500
    wanted = np.mean([compute_ssim(a[..., k], b[..., k])[whole].mean() for k in range(3)])
    assert found.to_dict()["ssim"] == pytest.approx(wanted, abs=2e-3)
    assert 0.2 < wanted < 0.95


def test_pixels_of_one_mesh_only_affect_the_silhouette() -> None:
    found = compare_views(ball(100), ball(100, radius=0.8), views=2, view_width=160)
    told = found.to_dict()
    assert told["psnr_db"] is None
    # Approximately by area: the silhouette of a ball in perspective is slightly larger than its disc.
    assert told["silhouette_iou"] == pytest.approx(0.64, abs=0.04)
    picture = found.worst.image
    assert picture.shape == (120, 480, 3)
    difference = picture[:, 320:].reshape(-1, 3)
    red = (difference == (200, 60, 40)).all(axis=1).sum()
    assert red == pytest.approx(found.worst.either_pixels - found.worst.both_pixels, abs=2)
    assert not (difference == (45, 160, 70)).all(axis=1).any()


def test_without_colours_shading_is_compared() -> None:
    told = compare_views(ball(None), ball(50, 1), views=2, view_width=WIDTH).to_dict()
    assert told["compared"] == "shape"
    assert 10 < told["psnr_db"] < 40
    assert told["ssim"] < 0.996
    closer = compare_views(ball(None), ball(50, 2), views=2, view_width=WIDTH).to_dict()
    assert closer["psnr_db"] > told["psnr_db"]
    assert closer["ssim"] > told["ssim"]


def test_the_worst_view_has_the_lowest_psnr() -> None:
    painted = ball(100)
    colors = painted.colors.copy()
    colors[painted.vertices[:, 2] > 0.4] = 180
    found = compare_views(painted, painted.with_(colors=colors), views=4, view_width=WIDTH)
    each = [one["psnr_db"] for one in found.to_dict()["each"]]
    finite = [np.inf if value is None else value for value in each]
    assert found.to_dict()["worst"] == f"view{int(np.argmin(finite)) + 1}"
    assert max(finite) - min(finite) > 3


def test_invalid_parameters_and_clouds_are_refused() -> None:
    with pytest.raises(UsageError, match="views is -1"):
        compare_views(ball(1), ball(1), views=-1)
    with pytest.raises(MeshError, match="second mesh: it has no triangles"):
        compare_views(ball(1), Mesh(np.eye(3), np.zeros((0, 3), np.int32)))
