"""Atlas layouts of any surface: no overlapping texels, padding around charts, requested density."""

import numpy as np
import pytest
import trimesh
from coloured_meshes import color_trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from scanloom.stages import _kernels
from scanloom.stages.diagnostics.errors import MeshError
from scanloom.stages.progress import ignore_progress
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.rasterization import rasterize_triangles
from scanloom.stages.surface.texture import compute_signed_areas
from scanloom.stages.surface.topology import compute_areas
from scanloom.stages.texturing.atlas_layout import (
    AtlasLayout,
    lay_out_by_density,
    lay_out_smallest,
    rasterize_texels,
)

MESHES = {
    "box": color_trimesh(trimesh.creation.box()),
    "ball": color_trimesh(trimesh.creation.icosphere(subdivisions=4)),
    "torus": color_trimesh(trimesh.creation.torus(1.0, 0.3)),
    "capsule": color_trimesh(trimesh.creation.capsule()),
}


def make_soup(seed: int, count: int) -> Mesh:
    """Make triangles of any size and position, some connected, some without area."""
    rng = np.random.default_rng(seed)
    vertices = rng.uniform(-1, 1, (count, 3)) * rng.choice([0.01, 0.3, 2.0], (count, 1))
    return Mesh(vertices, rng.integers(0, count, (2 * count, 3)).astype(np.int32))


def lay_out(mesh: Mesh, density: float = 40.0, *, max_side: int = 512, padding: int = 3) -> AtlasLayout:
    wanted = np.full(len(mesh.triangles), density, np.float32)
    return lay_out_by_density(
        mesh,
        wanted,
        curve_positions=order_along_x(mesh),
        max_side=max_side,
        max_texels=1e7,
        padding=padding,
        progress=ignore_progress,
    )


def order_along_x(mesh: Mesh) -> np.ndarray:
    """Order triangles by slices along x."""
    x = mesh.vertices[mesh.triangles].mean(axis=1)[:, 0]
    return (100 * (x - x.min()) / max(np.ptp(x), 1e-9)).astype(np.uint32)


def assert_valid_layout(pages: AtlasLayout) -> None:
    has_area = pages.pages >= 0
    assert (pages.charts >= 0).tolist() == has_area.tolist()
    for page, (width, height) in enumerate(pages.sizes):
        here = np.flatnonzero(pages.pages == page)
        corners = pages.corners[here]
        room = pages.padding - 1e-6
        assert corners.min() >= room
        assert (corners.max(axis=(0, 1)) <= (width - room, height - room)).all()
        found = rasterize_triangles(corners, (0, height), width)
        texels = found.rows * width + found.columns
        assert len(np.unique(texels)) == len(texels), "a texel lies in two triangles"
        # Texels of different charts are at least twice the padding apart.
        owner = np.full((height, width), -1)
        owner.ravel()[texels] = pages.charts[here][found.triangles]
        reach = pages.padding
        for axis in (0, 1):
            for step in range(1, 2 * reach + 1):
                a, b = (np.take(owner, range(*ends), axis) for ends in _ends(owner.shape[axis], step))
                assert not ((a >= 0) & (b >= 0) & (a != b)).any(), f"charts {step} texels apart"


def _ends(size: int, step: int) -> tuple[tuple[int, int], tuple[int, int]]:
    return (0, size - step), (step, size)


@pytest.mark.parametrize("name", MESHES)
def test_layouts_of_surfaces_are_valid(name):
    mesh = MESHES[name]
    pages = lay_out(mesh)
    assert_valid_layout(pages)
    # In the projection of a chart, a triangle is shortened by at most 1 − cos 66° in one direction.
    share = np.abs(compute_signed_areas(pages.corners)) / (
        compute_areas(mesh.vertices, mesh.triangles) * 40.0**2
    )
    assert share.max() <= 1 + 1e-6
    assert share.min() >= 0.4 - 1e-6
    assert np.median(share) > 0.8
    # No triangle is flipped.
    assert len(np.unique(np.sign(compute_signed_areas(pages.corners)))) == 1


@given(st.integers(0, 2**32 - 1), st.integers(3, 60))
@settings(max_examples=25, deadline=None)
def test_layouts_of_any_triangles_are_valid(seed, count):
    mesh = make_soup(seed, count)
    if compute_areas(mesh.vertices, mesh.triangles).sum() > 0:
        assert_valid_layout(lay_out(mesh, 30.0))


def test_large_surfaces_need_several_images():
    mesh = MESHES["ball"]
    pages = lay_out(mesh, 60.0, max_side=128)
    assert len(pages.sizes) > 3
    assert_valid_layout(pages)
    # Each image covers a region of space.
    x = mesh.vertices[mesh.triangles].mean(axis=1)[:, 0]
    widths = [np.ptp(x[pages.pages == page]) for page in range(len(pages.sizes))]
    assert np.mean(widths) < 0.5 * np.ptp(x)


def test_images_are_ordered_by_regions_of_space():
    mesh = MESHES["ball"]
    pages, places = lay_out(mesh, 60.0, max_side=128), order_along_x(mesh)
    for page in range(len(pages.sizes)):
        texels = rasterize_texels(pages, page)
        parts = list(texels.split_by_location(places, 1000))
        assert len(parts) >= len(texels.pixels) / 1000
        assert all(0 < len(part.pixels) <= 1000 for part in parts)
        assert np.array_equal(
            np.sort(np.concatenate([part.pixels for part in parts])), np.sort(texels.pixels)
        )
        widths = [np.ptp(places[part.triangles].astype(int)) for part in parts]
        assert np.mean(widths) < 0.7 * np.ptp(places[texels.triangles].astype(int))


def test_triangles_with_equal_order_are_not_separated():
    mesh = MESHES["ball"]
    wanted = np.full(len(mesh.triangles), 60.0, np.float32)
    nowhere = np.zeros(len(mesh.triangles), np.uint32)
    room = {"max_side": 128, "max_texels": 1e7, "padding": 3, "progress": ignore_progress}
    found = _kernels.lay_out_atlas(
        mesh.vertices, mesh.triangles, wanted, side=128, padding=3, progress=ignore_progress
    )
    assert np.array_equal(
        lay_out_by_density(mesh, wanted, curve_positions=nowhere, **room).corners, found.corners
    )


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("padding", [None, 4])
def test_one_image_is_filled(name, padding):
    mesh = MESHES[name]
    area = compute_areas(mesh.vertices, mesh.triangles).sum()
    texel_size = np.sqrt(area / (0.4 * 256**2))
    pages = lay_out_smallest(
        mesh, texel_size, max_side=512, max_texels=1e6, padding=padding, progress=ignore_progress
    )
    assert_valid_layout(pages)
    assert pages.sizes == ((256, 256),)
    assert pages.padding == (padding or 2)
    assert np.abs(compute_signed_areas(pages.corners)).sum() > 0.4 * 256**2


def test_default_padding_is_reduced_without_space():
    mesh = make_soup(0, 400)
    wanted = {"max_side": 512, "max_texels": 2e5, "progress": ignore_progress}
    few, many = (lay_out_smallest(mesh, 0.05, padding=padding, **wanted) for padding in (None, 20))
    assert few.padding == 2
    assert len(many.sizes) > len(few.sizes)


def test_degenerate_triangles_are_placed_at_their_neighbours():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    triangles = np.array([[0, 1, 2], [0, 2, 3], [2, 2, 0], [1, 1, 1]], np.int32)
    pages = lay_out(Mesh(vertices, triangles))
    assert pages.pages.tolist() == [0, 0, -1, -1]
    assert pages.images.tolist() == [0, 0, 0, 0]
    assert (pages.corners[2] == pages.corners[0, 2]).all()
    assert (pages.corners[3] == pages.corners[0, 1]).all()


def test_small_charts_are_merged():
    # A sphere with a few texels per triangle is divided into far fewer charts than triangles.
    pages = lay_out(MESHES["ball"], 10.0)
    assert pages.charts.max() < 40


def test_the_same_mesh_gives_the_same_layout():
    first, second = (lay_out(MESHES["torus"]) for _ in range(2))
    assert np.array_equal(first.corners, second.corners)
    assert first.sizes == second.sizes


def test_texels_are_covered_by_triangles_or_adjacent():
    pages = lay_out(MESHES["capsule"])
    (size,) = pages.sizes
    found = rasterize_texels(pages, 0)
    inside = rasterize_triangles(pages.corners, (0, size[1]), size[0])
    expected = dict(
        zip((inside.rows * size[0] + inside.columns).tolist(), inside.triangles.tolist(), strict=True)
    )
    given_ = dict(zip(found.pixels.tolist(), found.triangles.tolist(), strict=True))
    assert {pixel: given_[pixel] for pixel in expected} == expected
    assert len(given_) == len(found.pixels) > len(expected)
    assert found.weights.min() >= 0
    assert found.weights.sum(axis=1) == pytest.approx(1, abs=1e-5)
    assert (np.diff(found.triangles.astype(np.int64)) >= 0).all()


def test_wrong_arrays_are_refused():
    mesh = MESHES["box"]
    with pytest.raises(ValueError, match="one value for each triangle"):
        _kernels.lay_out_atlas(
            mesh.vertices,
            mesh.triangles,
            np.ones(3, np.float32),
            side=64,
            padding=2,
            progress=ignore_progress,
        )
    with pytest.raises(ValueError, match="too small for the padding"):
        _kernels.lay_out_atlas(
            mesh.vertices,
            mesh.triangles,
            np.ones(12, np.float32),
            side=4,
            padding=2,
            progress=ignore_progress,
        )


def test_a_mesh_whose_charts_have_no_area_in_the_image_is_refused() -> None:
    vertices = 1e-30 * np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    tiny = Mesh(vertices, np.array([[0, 1, 2]], np.int32))
    with pytest.raises(MeshError, match="charts have no area"):
        lay_out_smallest(tiny, 1.0, max_side=64, max_texels=1e6, padding=None, progress=ignore_progress)
