"""Textured tiles, read back from files: the same surface, in the colours of the model."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from coloured_meshes import assert_same_topology, sheet
from numpy.typing import NDArray
from seamed_meshes import wrapped_ball
from tile_reader import Tile, read_tiles

from scanloom.stages import Mesh, clean, lod, simplify
from scanloom.stages.diagnostics.errors import MeshError
from scanloom.stages.files.image_bytes import decode_image
from scanloom.stages.lod.hierarchy import Hierarchy
from scanloom.stages.lod.tile_texture import TileMesh, paint_tile_images, prepare_color_source
from scanloom.stages.surface.mesh_files import read_mesh
from scanloom.stages.surface.raycasting import RaycastingSurface
from scanloom.stages.surface.surface_color import compute_surface_colors, sample_bilinear
from scanloom.stages.surface.texture import Image, Material, Texture
from tests.stages.lod.test_tiles import choose_random_cut, get_finest_mesh, read_contents, weld_tiles

SMALL: dict[str, Any] = {"cell_triangles": 300, "root_triangles": 100, "ratio": 2.5, "threads": 1}


def make_waves(width: int, height: int, turns: float) -> Image:
    """Make smooth colours that are periodic from left to right."""
    x, y = np.meshgrid(np.linspace(0, 1, width, endpoint=False), np.linspace(0, 1, height))
    channels = [np.cos(2 * np.pi * turns * x), np.sin(2 * np.pi * turns * x) * np.sin(3 * y), np.cos(4 * y)]
    return Image(given=np.rint(128 + 100 * np.stack(channels, axis=2)).astype(np.uint8))


def make_textured_ball() -> Mesh:
    """Make a ball with a UV seam from pole to pole.

    The image is continuous across the seam and smooth at the poles.
    """
    mesh = wrapped_ball(20, 32)
    assert mesh.texture is not None
    across, down = ((np.arange(count) + 0.5) / count for count in (256, 128))
    around, polar = np.meshgrid(2 * np.pi * across, np.pi * down)
    wide = np.sin(polar) ** 2
    channels = [wide * np.cos(2 * around), wide * np.sin(2 * around), np.cos(2 * polar)]
    pixels = np.rint(128 + 100 * np.stack(channels, axis=2)).astype(np.uint8)
    material = Material(image=Image(given=pixels), wrap=("repeat", "clamp"))
    return mesh.with_(texture=replace(mesh.texture, materials=(material,), material_ids=make_zeros(mesh)))


def make_patchwork() -> Mesh:
    """Make a sheet of two images and an untextured material, which meet along straight lines."""
    mesh = sheet(24, noise=0.0)
    places = mesh.vertices[mesh.triangles][:, :, :2]
    ids = np.minimum((places[:, :, 0].mean(axis=1) * 3).astype(np.int32), 2)
    materials = (
        Material(image=make_waves(192, 192, 1)),
        Material(image=make_waves(192, 96, 3)),
        Material(base_color=(0.2, 0.5, 0.8, 1.0)),
    )
    return Mesh(mesh.vertices, mesh.triangles, texture=Texture(places.copy(), ids, materials))


def make_zeros(mesh: Mesh) -> NDArray[np.int32]:
    return np.zeros(len(mesh.triangles), np.int32)


MODELS = {"ball": make_textured_ball, "patchwork": make_patchwork}


@pytest.fixture(scope="module")
def models() -> dict[str, Mesh]:
    return {name: make() for name, make in MODELS.items()}


@pytest.fixture(scope="module")
def hierarchies(models: dict[str, Mesh]) -> dict[str, Hierarchy]:
    # The stored model is removed, because tiles with and without images are compared.
    return {name: replace(lod.build(mesh, **SMALL), model_glb=None) for name, mesh in models.items()}


@pytest.fixture(scope="module")
def folders(
    models: dict[str, Mesh], hierarchies: dict[str, Hierarchy], tmp_path_factory: pytest.TempPathFactory
) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("textured")
    for name, hierarchy in hierarchies.items():
        lod.write_tiles(hierarchy, folder / name, texture=models[name])
        lod.write_tiles(hierarchy, folder / f"{name}-plain")
    return {path.name: path for path in folder.iterdir()}


def pair_tiles(folders: dict[str, Path], name: str) -> list[tuple[Tile, Tile]]:
    tiles, plain = (list(read_tiles(folders[which]).all()) for which in (name, f"{name}-plain"))
    return list(zip(tiles, plain, strict=True))


@pytest.mark.parametrize("name", MODELS)
def test_shape_and_errors_equal_those_without_images(folders: dict[str, Path], name: str) -> None:
    for tile, plain in pair_tiles(folders, name):
        assert (tile.vertices[tile.triangles] == plain.vertices[plain.triangles]).all()
        assert tile.gltf["nodes"] == plain.gltf["nodes"]
        for what in ("boundingVolume", "geometricError"):
            assert tile.tree[what] == plain.tree[what]
        assert tile.tree["content"]["uri"] == plain.tree["content"]["uri"]


@pytest.mark.slow
@pytest.mark.parametrize("name", MODELS)
def test_mixed_cuts_have_no_cracks(
    folders: dict[str, Path], hierarchies: dict[str, Hierarchy], name: str
) -> None:
    root, original = read_tiles(folders[name]), get_finest_mesh(hierarchies[name])
    rng = np.random.default_rng(1)
    if name == "ball":
        # The seams could open.
        assert any(len(tile.vertices) > len(np.unique(tile.vertices, axis=0)) for tile in root.all())
    for _ in range(200):
        assert_same_topology(weld_tiles(choose_random_cut(root, rng)), original)


def sample_tile(tile: Tile, count: int, seed: int = 0) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Sample points of a tile, and the colours of its image there, levels."""
    assert tile.image is not None
    assert tile.uvs is not None
    pixels = decode_image(tile.image)
    assert pixels is not None
    rng = np.random.default_rng(seed)
    corners = tile.vertices[tile.triangles].astype(np.float64)
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    chosen, weights = rng.choice(len(area), count, p=area / area.sum()), rng.dirichlet((1, 1, 1), count)
    u, v = np.einsum("kc,kcx->xk", weights, tile.uvs[tile.triangles[chosen]] / 65535)
    colors = sample_bilinear(pixels, np.stack([u, 1 - v], axis=1), ("clamp", "clamp"))
    return np.einsum("kc,kcx->kx", weights, corners[chosen]), np.asarray(colors, np.float64)


def get_model_colors(model: Mesh, points: NDArray[np.float64]) -> NDArray[np.float64]:
    at = RaycastingSurface(model).find_closest_points(points)
    return np.asarray(compute_surface_colors(model, at.triangles, at.weights), np.float64)


def compute_rms(levels: NDArray[np.float64]) -> float:
    return float(np.sqrt((levels**2).mean()))


@pytest.mark.parametrize("name", MODELS)
def test_tiles_have_the_colours_of_the_model(
    folders: dict[str, Path], models: dict[str, Mesh], name: str
) -> None:
    for tile in read_tiles(folders[name]).all():
        points, colors = sample_tile(tile, 12_000)
        apart = colors - get_model_colors(models[name], points)
        extras = tile.tree["content"]["extras"]
        # Another sampling confirms the stored statistics.
        assert compute_rms(apart) == pytest.approx(extras["color_rms_levels_sampled"], rel=0.3, abs=0.2)
        within = (np.abs(apart).max(axis=1) <= extras["color_95_levels_sampled"] + 0.5).mean()
        assert within > 0.9
        assert extras["color_95_levels_sampled"] <= extras["color_max_levels_sampled"]
        assert set(extras) == {
            "shape_bound_m",
            "texel_size_m",
            "color_rms_levels_sampled",
            "color_95_levels_sampled",
            "color_max_levels_sampled",
        }
        if name == "patchwork":
            # At the boundary between two images, a texel mixes both.
            apart = apart[(np.abs(points[:, :1] - (1 / 3, 2 / 3)) > 0.08).all(axis=1)]
        assert compute_rms(apart) < (2.5 if not tile.children else 6)


@pytest.mark.parametrize("name", MODELS)
def test_adjacent_tiles_have_equal_colours_at_their_boundary(folders: dict[str, Path], name: str) -> None:
    leaves = list(read_tiles(folders[name]).leaves())
    found: dict[bytes, list[NDArray[np.float64]]] = {}
    for tile in leaves:
        # At the boundary between two images, the patchwork has two colours at the same point.
        meets = (np.abs(tile.vertices[:, :1] - (1 / 3, 2 / 3)) < 0.08).any(axis=1) & (name == "patchwork")
        assert tile.image is not None
        assert tile.uvs is not None
        pixels = decode_image(tile.image)
        assert pixels is not None
        uvs = tile.uvs / 65535
        colors = sample_bilinear(pixels, np.stack([uvs[:, 0], 1 - uvs[:, 1]], axis=1), ("clamp", "clamp"))
        for place, color in zip(tile.vertices[~meets], colors[~meets], strict=True):
            found.setdefault(place.tobytes(), []).append(np.asarray(color, np.float64))
    several = [np.ptp(np.array(colors), axis=0) for colors in found.values() if len(colors) > 1]
    assert len(several) > 30
    assert np.median(np.array(several).max(axis=1)) < 3
    assert np.quantile(np.array(several).max(axis=1), 0.95) < 10


def test_texel_size_follows_from_the_error_and_the_model(
    models: dict[str, Mesh], hierarchies: dict[str, Hierarchy], tmp_path: Path
) -> None:
    model, hierarchy = models["ball"], hierarchies["ball"]
    coarse, fine, narrow = (
        lod.write_tiles(
            hierarchy, tmp_path / name, texture=model, images=lod.TileImageParams(**changes)
        ).images
        for name, changes in {
            "coarse": {"texels_per_error": 1.0},
            "fine": {"texels_per_error": 50.0},
            "narrow": {"image_side": 128},
        }.items()
    )
    extras, own = (
        [tile.tree["content"]["extras"] for tile in read_tiles(tmp_path / name).all()]
        for name in ("coarse", "fine")
    )
    for found, finest in zip(extras, own, strict=True):
        wanted = max(found["shape_bound_m"], finest["texel_size_m"])
        assert found["texel_size_m"] == pytest.approx(wanted, rel=0.1)
    # The image has fewer texels per metre around the equator than at the poles.
    assert max(image.texel_size for image in fine) < 1.5 * min(image.texel_size for image in fine)
    assert not any(image.is_coarser_than_requested for image in (*coarse, *fine))
    assert any(image.is_coarser_than_requested for image in narrow)
    assert max(max(image.size) for image in narrow) <= 128
    assert max(image.texel_size for image in narrow) > 1.5 * max(image.texel_size for image in fine)


@pytest.mark.slow
def test_tiles_have_finer_texels_where_the_model_has(tmp_path: Path) -> None:
    mesh = sheet(40, noise=0.0)
    places = mesh.vertices[mesh.triangles][:, :, :2]
    ids = (places[:, :, 0].mean(axis=1) > 0.5).astype(np.int32)
    materials = (Material(image=make_waves(512, 512, 1)), Material(image=make_waves(64, 64, 1)))
    model = Mesh(mesh.vertices, mesh.triangles, texture=Texture(places.copy(), ids, materials))
    hierarchy = lod.build(model, cell_triangles=200, root_triangles=100, threads=1)
    lod.write_tiles(hierarchy, tmp_path / "out", texture=model)
    found: dict[bool, list[float]] = {False: [], True: []}
    for tile in read_tiles(tmp_path / "out").leaves():
        x = tile.vertices[:, 0]
        if x.max() < 0.5 or x.min() > 0.5:
            found[bool(x.min() > 0.5)].append(tile.tree["content"]["extras"]["texel_size_m"])
    assert len(found[False]) > 1
    assert len(found[True]) > 1
    # The surface is slightly larger than its region of the image.
    assert found[False] == pytest.approx([1 / 512] * len(found[False]), rel=0.3)
    assert found[True] == pytest.approx([1 / 64] * len(found[True]), rel=0.3)


@pytest.mark.parametrize(
    ("kind", "begins", "uses"),
    [
        ("jpeg", b"\xff\xd8\xff", []),
        ("png", b"\x89PNG", []),
        ("webp", b"RIFF", ["EXT_texture_webp"]),
    ],
)
def test_images_are_written_in_each_format(
    models: dict[str, Mesh],
    hierarchies: dict[str, Hierarchy],
    tmp_path: Path,
    kind: str,
    begins: bytes,
    uses: list[str],
) -> None:
    images = lod.TileImageParams(image_format=kind)
    lod.write_tiles(hierarchies["ball"], tmp_path / "out", texture=models["ball"], images=images)
    tile = read_tiles(tmp_path / "out")
    assert tile.image is not None
    assert tile.image.startswith(begins)
    assert tile.gltf["extensionsRequired"] == ["KHR_mesh_quantization", *uses]
    assert tile.gltf["extensionsUsed"] == ["KHR_mesh_quantization", *uses, "KHR_materials_unlit"]
    (sampler,) = tile.gltf["samplers"]
    assert (sampler["wrapS"], sampler["wrapT"], sampler["minFilter"]) == (33071, 33071, 9987)
    assert tile.colors is None


def test_other_readers_get_the_same_tiles(folders: dict[str, Path], models: dict[str, Mesh]) -> None:
    import trimesh

    folder = folders["ball"]
    for tile in read_tiles(folder).all():
        path = folder / tile.tree["content"]["uri"]
        ours = read_mesh(path)
        x, y, z = tile.vertices.T
        corners = np.stack([x, z, -y], axis=1)[tile.triangles]
        assert (ours.vertices[ours.triangles] == corners).all()
        assert ours.texture is not None
        assert tile.image is not None
        (image,) = ours.texture.images
        assert image.file_bytes == tile.image
        (theirs,) = trimesh.load_scene(io.BytesIO(path.read_bytes()), file_type="glb").geometry.values()
        # Colours at triangle centres from trimesh. trimesh ignores that 16-bit coordinates are normalised,
        # and its origin is the lower left corner.
        u, v = theirs.visual.uv[theirs.faces].mean(axis=1).T
        uvs = np.stack([u / 65535, 1 - (1 - v) / 65535], axis=1)
        colors = theirs.visual.material.to_color(uvs)[:, :3].astype(np.float64)
        middles = tile.vertices[tile.triangles].mean(axis=1).astype(np.float64)
        assert compute_rms(colors - get_model_colors(models["ball"], middles)) < 12


def test_vertex_colours_become_images(tmp_path: Path) -> None:
    fine = sheet(60, noise=0.0)
    light = simplify(fine, method="quadric", ratio=0.05).mesh
    hierarchy = lod.build(light, **SMALL)
    lod.write_tiles(hierarchy, tmp_path / "out", texture=fine)
    for tile in read_tiles(tmp_path / "out").leaves():
        points, colors = sample_tile(tile, 2000)
        assert compute_rms(colors - get_model_colors(fine, points)) < 6


def test_models_far_from_the_origin_are_matched_to_their_levels(
    models: dict[str, Mesh], hierarchies: dict[str, Hierarchy], folders: dict[str, Path], tmp_path: Path
) -> None:
    move = np.array([4096.0, -8192.0, 0.0])
    far = replace(hierarchies["ball"], vertices=hierarchies["ball"].vertices + move)
    model = models["ball"].with_(vertices=models["ball"].vertices + move)
    written = lod.write_tiles(far, tmp_path / "out", texture=model)
    assert written.grid.origin.any()
    near = [tile.tree["content"]["extras"] for tile in read_tiles(folders["ball"]).all()]
    for tile, extras in zip(read_tiles(tmp_path / "out").all(), near, strict=True):
        found = tile.tree["content"]["extras"]["color_rms_levels_sampled"]
        assert found == pytest.approx(extras["color_rms_levels_sampled"], rel=0.3, abs=0.3)


def test_the_bytes_do_not_depend_on_the_thread_count(
    models: dict[str, Mesh],
    hierarchies: dict[str, Hierarchy],
    folders: dict[str, Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("scanloom.stages.lod.tile_texture.get_worker_count", lambda: 1)
    lod.write_tiles(hierarchies["patchwork"], tmp_path / "out", texture=models["patchwork"])
    assert read_contents(tmp_path / "out") == read_contents(folders["patchwork"])
    monkeypatch.setattr("scanloom.stages.lod.tile_texture.get_worker_count", lambda: 5)
    lod.write_tiles(hierarchies["patchwork"], tmp_path / "out", texture=models["patchwork"])
    assert read_contents(tmp_path / "out") == read_contents(folders["patchwork"])


def remove_texture(model: Mesh) -> Mesh:
    return Mesh(model.vertices, model.triangles)


def remove_image(model: Mesh) -> Mesh:
    assert model.texture is not None
    return model.with_(texture=replace(model.texture, materials=(Material(name="lost"),)))


def move_away(model: Mesh) -> Mesh:
    return model.with_(vertices=np.add(model.vertices, (0.0, 0.0, 3.0)))


def scale_to_millimetres(model: Mesh) -> Mesh:
    return model.with_(vertices=1000 * model.vertices)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (remove_texture, "neither an image nor vertex colours"),
        (remove_image, "neither an image nor vertex colours"),
        (
            move_away,
            "model: does not match the levels, which are .* m large: half of their vertices are more than",
        ),
        (scale_to_millimetres, "does not match the levels"),
    ],
)
def test_unusable_models_are_reported(
    models: dict[str, Mesh], hierarchies: dict[str, Hierarchy], tmp_path: Path, change: Any, message: str
) -> None:
    with pytest.raises(MeshError, match=message):
        lod.write_tiles(hierarchies["ball"], tmp_path / "out", texture=change(models["ball"]))
    assert list(tmp_path.iterdir()) == []


def test_dropped_transparency_is_reported(
    models: dict[str, Mesh], hierarchies: dict[str, Hierarchy], tmp_path: Path
) -> None:
    texture = models["ball"].texture
    assert texture is not None
    pixels = texture.images[0].pixels
    seen = np.dstack([pixels, np.full(pixels.shape[:2], 100, np.uint8)])
    glass = replace(texture, materials=(Material(image=Image(given=seen)),))
    written = lod.write_tiles(
        hierarchies["ball"], tmp_path / "out", texture=models["ball"].with_(texture=glass)
    )
    assert [str(one) for one in written.diagnostics] == ["tiles drop the transparency of the model's images."]
    assert lod.write_tiles(hierarchies["ball"], tmp_path / "out", texture=models["ball"]).diagnostics == ()


def test_too_many_charts_for_a_tile_image_are_reported(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    vertices = (rng.uniform(0, 1, (900, 1, 3)) + 0.02 * rng.uniform(-1, 1, (900, 3, 3))).reshape(-1, 3)
    crumbs = Mesh(
        vertices,
        np.arange(2700, dtype=np.int32).reshape(-1, 3),
        colors=np.full((2700, 3), 90, np.uint8),
    )
    hierarchy = lod.build(crumbs, threads=1)
    with pytest.raises(MeshError, match="too many charts for an image of 64 × 64 texels"):
        lod.write_tiles(
            hierarchy, tmp_path / "out", texture=crumbs, images=lod.TileImageParams(image_side=64)
        )
    assert list(tmp_path.iterdir()) == []
    written = lod.write_tiles(hierarchy, tmp_path / "out", texture=crumbs)
    assert all(image.color_max <= 2 for image in written.images)


def test_a_tile_without_area_is_reported(models: dict[str, Mesh]) -> None:
    line = Mesh(np.array([[0.0, 0, 1], [0, 0, 1], [0, 0, 1]]), np.array([[0, 1, 2]], np.int32))
    model = prepare_color_source(models["ball"], models["ball"], np.zeros(3))
    with pytest.raises(MeshError, match="tile"):
        list(paint_tile_images([TileMesh(line, 0.1, ())], model, lod.TileImageParams()))


def test_a_model_without_triangles_is_reported(hierarchies: dict[str, Hierarchy], tmp_path: Path) -> None:
    empty = Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32))
    with pytest.raises(MeshError, match="model"):
        lod.write_tiles(hierarchies["ball"], tmp_path / "out", texture=empty)
    assert list(tmp_path.iterdir()) == []


def test_metrics_contain_the_size_of_images(
    models: dict[str, Mesh], hierarchies: dict[str, Hierarchy], tmp_path: Path
) -> None:
    written = lod.write_tiles(hierarchies["ball"], tmp_path / "out", texture=models["ball"])
    root = read_tiles(tmp_path / "out")
    sizes = [len(tile.image) for tile in root.all() if tile.image is not None]
    metrics = written.to_dict()["images"]
    assert root.image is not None
    assert (metrics["total_bytes"], metrics["root_bytes"]) == (sum(sizes), len(root.image))
    assert len(written.images) == len(sizes) == written.to_dict()["tiles"]
    assert lod.write_tiles(hierarchies["ball"], tmp_path / "out").to_dict()["images"] is None


@pytest.mark.slow
@pytest.mark.parametrize("name", ["meshes/spot/spot_triangulated.obj", "meshes/Duck.glb"])
def test_tiles_of_real_models_are_sound(shared_data: Path, tmp_path: Path, name: str) -> None:
    model = clean(read_mesh(shared_data / name)).mesh.with_(normals=None, corner_normals=None)
    assert model.texture is not None
    if not model.texture.images:
        pixels = decode_image((shared_data / "meshes" / "spot" / "spot_texture.png").read_bytes())
        texture = replace(
            model.texture, materials=(Material(image=Image(given=pixels)),), material_ids=make_zeros(model)
        )
        model = model.with_(texture=texture)
    hierarchy = lod.build(model, cell_triangles=2000, threads=2)
    lod.write_tiles(hierarchy, tmp_path / "out", texture=model, up="+y")
    root, rng, original = read_tiles(tmp_path / "out"), np.random.default_rng(4), get_finest_mesh(hierarchy)
    for _ in range(30):
        assert_same_topology(weld_tiles(choose_random_cut(root, rng)), original)
    for tile in root.leaves():
        points, colors = sample_tile(tile, 2000)
        assert compute_rms(colors - get_model_colors(model, points)) < 6
