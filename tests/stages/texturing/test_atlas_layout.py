"""Layouts of any surface: no texel twice, room around each chart, as fine as is wanted."""

import numpy as np
import pytest
import trimesh
from coloured_meshes import color_trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from scanloom.stages import _kernels
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


def soup(seed: int, count: int) -> Mesh:
    """Triangles of any size anywhere, some of them joined, some without area."""
    rng = np.random.default_rng(seed)
    vertices = rng.uniform(-1, 1, (count, 3)) * rng.choice([0.01, 0.3, 2.0], (count, 1))
    return Mesh(vertices, rng.integers(0, count, (2 * count, 3)).astype(np.int32))


def pages_of(mesh: Mesh, density: float = 40.0, *, max_side: int = 512, padding: int = 3) -> AtlasLayout:
    wanted = np.full(len(mesh.triangles), density, np.float32)
    return lay_out_by_density(
        mesh,
        wanted,
        curve_positions=along_x(mesh),
        max_side=max_side,
        max_texels=1e7,
        padding=padding,
        progress=ignore_progress,
    )


def along_x(mesh: Mesh) -> np.ndarray:
    """Return places of triangles in slices of the mesh."""
    x = mesh.vertices[mesh.triangles].mean(axis=1)[:, 0]
    return (100 * (x - x.min()) / max(np.ptp(x), 1e-9)).astype(np.uint32)


def require_sound(pages: AtlasLayout) -> None:
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
        # Between texels of two charts there is twice the padding.
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
def test_surfaces_are_laid_out_soundly(name):
    mesh = MESHES[name]
    pages = pages_of(mesh)
    require_sound(pages)
    # Seen along its normal a triangle loses at most 1 − cos 66° of its length in one direction.
    share = np.abs(compute_signed_areas(pages.corners)) / (
        compute_areas(mesh.vertices, mesh.triangles) * 40.0**2
    )
    assert share.max() <= 1 + 1e-6
    assert share.min() >= 0.4 - 1e-6
    assert np.median(share) > 0.8
    # No triangle is turned over.
    assert len(np.unique(np.sign(compute_signed_areas(pages.corners)))) == 1


@given(st.integers(0, 2**32 - 1), st.integers(3, 60))
@settings(max_examples=25, deadline=None)
def test_any_triangles_are_laid_out_soundly(seed, count):
    mesh = soup(seed, count)
    if compute_areas(mesh.vertices, mesh.triangles).sum() > 0:
        require_sound(pages_of(mesh, 30.0))


def test_large_surfaces_need_several_images():
    mesh = MESHES["ball"]
    pages = pages_of(mesh, 60.0, max_side=128)
    assert len(pages.sizes) > 3
    require_sound(pages)
    # Each shows a part of space.
    x = mesh.vertices[mesh.triangles].mean(axis=1)[:, 0]
    widths = [np.ptp(x[pages.pages == page]) for page in range(len(pages.sizes))]
    assert np.mean(widths) < 0.5 * np.ptp(x)


def test_texels_of_each_image_come_in_parts_of_space():
    mesh = MESHES["ball"]
    pages, places = pages_of(mesh, 60.0, max_side=128), along_x(mesh)
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


def test_what_lies_in_one_place_is_not_parted():
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
    require_sound(pages)
    assert pages.sizes == ((256, 256),)
    assert pages.padding == (padding or 2)
    assert np.abs(compute_signed_areas(pages.corners)).sum() > 0.4 * 256**2


def test_padding_of_its_own_makes_way_where_there_is_no_room():
    mesh = soup(0, 400)
    wanted = {"max_side": 512, "max_texels": 2e5, "progress": ignore_progress}
    few, many = (lay_out_smallest(mesh, 0.05, padding=padding, **wanted) for padding in (None, 20))
    assert few.padding == 2
    assert len(many.sizes) > len(few.sizes)


def test_triangles_without_area_lie_at_their_neighbours():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    triangles = np.array([[0, 1, 2], [0, 2, 3], [2, 2, 0], [1, 1, 1]], np.int32)
    pages = pages_of(Mesh(vertices, triangles))
    assert pages.pages.tolist() == [0, 0, -1, -1]
    assert pages.images.tolist() == [0, 0, 0, 0]
    assert (pages.corners[2] == pages.corners[0, 2]).all()
    assert (pages.corners[3] == pages.corners[0, 1]).all()


def test_small_charts_are_taken_up():
    # A ball of a few texels a triangle falls into far fewer charts than triangles.
    pages = pages_of(MESHES["ball"], 10.0)
    assert pages.charts.max() < 40


def test_the_same_mesh_gives_the_same_layout():
    first, second = (pages_of(MESHES["torus"]) for _ in range(2))
    assert np.array_equal(first.corners, second.corners)
    assert first.sizes == second.sizes


def test_texels_are_those_that_triangles_cover_and_those_beside():
    pages = pages_of(MESHES["capsule"])
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
