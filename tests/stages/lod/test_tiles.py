"""3D Tiles of a hierarchy, read back from files: sound, without cracks, within their bounds."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
from browsers import PAGE, run_node
from coloured_meshes import assert_same_topology, color_trimesh, sheet
from numpy.typing import NDArray
from tile_reader import Tile, read_glb_chunks, read_tiles

from scanloom.stages import __version__, _kernels, bake, clean, lod, simplify
from scanloom.stages.diagnostics.codes import MACHINE_BUG
from scanloom.stages.diagnostics.errors import InputError, StageError, UsageError
from scanloom.stages.lod.hierarchy import Hierarchy
from scanloom.stages.lod.position_grid import snap_to_grid
from scanloom.stages.lod.tile_glb import encode_tile_glb
from scanloom.stages.surface.formats.color_conversion import convert_linear_to_srgb
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.mesh_files import read_mesh
from scanloom.stages.surface.raycasting import RaycastingSurface

CUTS = 1000
NAMES = ("closed", "open")
UNPACK = Path(__file__).resolve().parents[2] / "made" / "unpack_tiles.mjs"
VALIDATE = Path(__file__).resolve().parents[2] / "made" / "validate_glb.cjs"


def make_closed_mesh() -> Mesh:
    import trimesh

    return color_trimesh(trimesh.creation.torus(1.0, 0.4, major_sections=30, minor_sections=15))


def make_open_mesh() -> Mesh:
    return sheet(18)


@pytest.fixture(scope="module")
def hierarchies() -> dict[str, Hierarchy]:
    made = {"closed": make_closed_mesh(), "open": make_open_mesh()}
    return {
        name: lod.build(mesh, cell_triangles=128, root_triangles=40, ratio=2.0, threads=1)
        for name, mesh in made.items()
    }


@pytest.fixture(scope="module")
def folders(hierarchies: dict[str, Hierarchy], tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("tiles")
    for name, hierarchy in hierarchies.items():
        lod.write_tiles(hierarchy, folder / name)
    return {name: folder / name for name in hierarchies}


def get_finest_mesh(hierarchy: Hierarchy, below: int = 0) -> Mesh:
    """Get the finest mesh below a node."""
    todo, leaves = [below], []
    while todo:
        node = todo.pop()
        children = hierarchy.children[node].tolist()
        todo += children
        leaves += [] if children else [node]
    return hierarchy.mesh(leaves, hierarchy.splits[leaves])


def weld_tiles(tiles: list[Tile]) -> Mesh:
    """Merge tiles into one mesh; vertices with equal positions are welded."""
    first = np.cumsum([0, *(len(tile.vertices) for tile in tiles)])
    vertices, index = np.unique(np.vstack([t.vertices for t in tiles]), axis=0, return_inverse=True)
    triangles = np.vstack([t.triangles + at for t, at in zip(tiles, first, strict=False)])
    return Mesh(vertices.astype(np.float64), index.reshape(-1)[triangles].astype(np.int32))


def choose_random_cut(root: Tile, rng: np.random.Generator) -> list[Tile]:
    """Choose tiles of mixed levels that cover the surface."""
    cut, todo, share = [], [root], rng.random()
    while todo:
        tile = todo.pop()
        if tile.children and rng.random() < share:
            todo += tile.children
        else:
            cut.append(tile)
    return cut


@pytest.mark.slow
@pytest.mark.parametrize("single", [False, True])
@pytest.mark.parametrize("name", NAMES)
def test_mixed_cuts_have_no_cracks_and_no_edge_with_three_triangles(
    hierarchies: dict[str, Hierarchy], tmp_path: Path, name: str, single: bool
) -> None:
    hierarchy = hierarchies[name]
    if single:
        # The bounds are too small for 16-bit positions.
        hierarchy = replace(hierarchy, shape_bound=1e-6 * hierarchy.shape_bound)
    written = lod.write_tiles(hierarchy, tmp_path / "out")
    assert written.grid.in_16_bits is not single
    root, rng, original = read_tiles(tmp_path / "out"), np.random.default_rng(5), get_finest_mesh(hierarchy)
    sizes = set()
    for _ in range(CUTS if not single else 50):
        cut = choose_random_cut(root, rng)
        sizes.add(len(cut))
        assert_same_topology(weld_tiles(cut), original)
    assert len(sizes) > 5


def test_tiles_of_real_meshes_fit_together(shared_data: Path, tmp_path: Path) -> None:
    original = clean(read_mesh(shared_data / "meshes" / "stanford-bunny.obj")).mesh
    light = simplify(original, ratio=0.1).mesh
    hierarchy = lod.build(light, cell_triangles=1000, root_triangles=300, ratio=4.0, threads=2)
    lod.write_tiles(hierarchy, tmp_path / "out", up="+y")
    root, rng = read_tiles(tmp_path / "out"), np.random.default_rng(2)
    for _ in range(100):
        assert_same_topology(weld_tiles(choose_random_cut(root, rng)), light)


def test_a_large_base_mesh_is_split_into_parts_that_fit(
    hierarchies: dict[str, Hierarchy], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    limit = 2500
    monkeypatch.setattr("scanloom.stages.lod.tiles._MAX_BASE_BYTES", limit)
    hierarchy = hierarchies["closed"]
    written = lod.write_tiles(hierarchy, tmp_path / "out")
    root, rng, original = read_tiles(tmp_path / "out"), np.random.default_rng(5), get_finest_mesh(hierarchy)
    parts = [tile for tile in root.all() if not tile.children]
    assert len(parts) > len([node for node in hierarchy.children if not len(node)])
    sizes = [(tmp_path / "out" / tile.tree["content"]["uri"]).stat().st_size for tile in parts]
    assert limit / 2 < np.median(sizes) <= max(sizes) <= limit
    assert len(written.sizes) == len(list(root.all()))
    assert_same_topology(weld_tiles(parts), original)
    for _ in range(50):
        assert_same_topology(weld_tiles(choose_random_cut(root, rng)), original)
    boxes = [np.reshape(tile.tree["boundingVolume"]["box"], (4, 3)) for tile in parts]
    for tile, (center, *axes) in zip(parts, boxes, strict=True):
        assert (np.abs(tile.vertices - center) <= np.sum(axes, axis=0)).all()
    # The parts of a leaf have tight boxes of their own.
    assert len({tuple(box[0]) for box in boxes}) == len(boxes)


def test_a_tile_moved_by_one_grid_step_is_detected_as_a_crack(folders: dict[str, Path]) -> None:
    root = read_tiles(folders["closed"])
    cut = [tile for tile in root.all() if not tile.children]
    cut[0].vertices += np.float32(cut[0].gltf["nodes"][0]["scale"][0])
    with pytest.raises(AssertionError):
        assert_same_topology(weld_tiles(cut), make_closed_mesh())


def sample_surface(mesh: Mesh, count: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Sample points of a mesh, plus its vertices and triangle centres."""
    corners = mesh.vertices[mesh.triangles]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    chosen = rng.choice(len(corners), count, p=area / area.sum())
    weights = rng.dirichlet((1, 1, 1), count)
    return np.vstack([mesh.vertices, corners.mean(axis=1), np.einsum("kc,kcx->kx", weights, corners[chosen])])


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_no_sampled_point_exceeds_the_geometric_error_of_a_tile(
    hierarchies: dict[str, Hierarchy], folders: dict[str, Path], name: str
) -> None:
    hierarchy, root, rng = hierarchies[name], read_tiles(folders[name]), np.random.default_rng(3)
    found = []
    for tile in root.all():
        stem = Path(tile.tree["content"]["uri"]).stem
        part = get_finest_mesh(hierarchy, int(stem.removesuffix("-base")))
        mesh = Mesh(tile.vertices.astype(np.float64), tile.triangles.astype(np.int32))
        away = max(
            RaycastingSurface(a).find_closest_points(sample_surface(b, 3000, rng)).distances.max()
            for a, b in ((mesh, part), (part, mesh))
        )
        bound = tile.tree["content"]["extras"]["shape_bound_m"]
        assert away <= bound <= tile.tree["geometricError"]
        found.append(away / bound)
    # The bounds are tight, so the sampling is a real test.
    assert np.median(found) > 0.5


def test_a_surface_seen_from_one_side_stores_its_facing(folders: dict[str, Path]) -> None:
    about = {
        name: json.loads((folders[name] / "tileset.json").read_text())["asset"]["extras"] for name in NAMES
    }
    assert "facing" not in about["closed"]
    assert np.linalg.norm(about["open"]["facing"]) == pytest.approx(1, abs=1e-3)


@pytest.mark.parametrize("name", NAMES)
def test_tiles_store_their_proven_bound_including_grid_displacement(
    hierarchies: dict[str, Hierarchy], folders: dict[str, Path], name: str
) -> None:
    hierarchy, root = hierarchies[name], read_tiles(folders[name])
    share = snap_to_grid(hierarchy)[1].max_displacement_m
    for tile in root.all():
        stem = Path(tile.tree["content"]["uri"]).stem
        node, is_base = int(stem.removesuffix("-base")), stem.endswith("-base")
        extras = tile.tree["content"]["extras"]
        bound = 0.0 if is_base else hierarchy.shape_bound[node]
        assert bound + share < extras["shape_bound_m"] < (bound + share) * (1 + 1e-4)
        assert extras["color_bound_levels"] == (0.0 if is_base else hierarchy.color_bound[node])
        assert is_base is not bool(tile.children)


def test_a_tile_with_one_child_has_far_fewer_triangles(
    folders: dict[str, Path], hierarchies: dict[str, Hierarchy]
) -> None:
    total = 0
    for name, folder in folders.items():
        tiles = list(read_tiles(folder).all())
        for tile in tiles:
            if len(tile.children) == 1:
                assert len(tile.triangles) <= 0.8 * len(tile.children[0].triangles)
        # Similar parents are omitted, and their children take their position.
        hierarchy = hierarchies[name]
        alone = np.array([len(children) < 2 for children in hierarchy.children])
        left_out = int((alone & (hierarchy.coarse > 0.8 * hierarchy.full)).sum())
        assert len(tiles) == hierarchy.nodes + sum(len(c) == 0 for c in hierarchy.children) - left_out
        total += left_out
    assert total > 0


def test_the_finest_tiles_equal_the_mesh(hierarchies: dict[str, Hierarchy], folders: dict[str, Path]) -> None:
    for name, mesh in {"closed": make_closed_mesh(), "open": make_open_mesh()}.items():
        grid = snap_to_grid(hierarchies[name])[1]
        tiles = list(read_tiles(folders[name]).leaves())
        corners, colors = [], []
        for tile in tiles:
            assert tile.colors is not None
            corners.append(tile.vertices[tile.triangles])
            displayed = np.rint(255 * convert_linear_to_srgb(tile.colors[:, :3] / 65535)).astype(np.uint8)
            colors.append(displayed[tile.triangles])
            assert (tile.colors[:, 3] == 65535).all()
        back, shown = np.vstack(corners).astype(np.float64), np.vstack(colors)
        was = mesh.vertices[mesh.triangles]
        assert mesh.colors is not None
        # Match triangles by their centres, at any starting corner.
        from scipy.spatial import cKDTree

        _, of = cKDTree(was.mean(axis=1)).query(back.mean(axis=1))
        assert sorted(of.tolist()) == list(range(len(was)))
        same = [np.linalg.norm(np.roll(was[of], k, axis=1) - back, axis=2).max(axis=1) for k in range(3)]
        assert np.min(same, axis=0).max() <= grid.max_displacement_m
        turned = np.argmin(same, axis=0)
        before = mesh.colors[mesh.triangles][of]
        for k in range(3):
            assert (np.roll(before, k, axis=1)[turned == k] == shown[turned == k]).all()


BOX = {"type": "array", "items": {"type": "number"}, "minItems": 12, "maxItems": 12}
ABOUT = {
    "type": "object",
    "properties": {
        "scanloom": {"const": __version__},
        "facing": {"type": "array", "items": {"type": "number"}, "minItems": 3, "maxItems": 3},
    },
    "required": ["scanloom"],
    "additionalProperties": False,
}
EXTRAS = {
    "type": "object",
    "properties": {
        "shape_bound_m": {"type": "number", "exclusiveMinimum": 0},
        "color_bound_levels": {"type": "number"},
    },
    "required": ["shape_bound_m"],
    "additionalProperties": False,
}
TILE = {
    "type": "object",
    "properties": {
        "transform": {"type": "array", "items": {"type": "number"}, "minItems": 16, "maxItems": 16},
        "refine": {"const": "REPLACE"},
        "boundingVolume": {
            "type": "object",
            "properties": {"box": BOX},
            "required": ["box"],
            "additionalProperties": False,
        },
        "geometricError": {"type": "number", "exclusiveMinimum": 0},
        "content": {
            "type": "object",
            "properties": {
                "uri": {"type": "string", "pattern": "^tiles/[0-9]+(-base(-[0-9]+)?)?[.]glb$"},
                "extras": EXTRAS,
            },
            "required": ["uri", "extras"],
            "additionalProperties": False,
        },
        "children": {"type": "array", "items": {"$ref": "#/$defs/tile"}, "minItems": 1},
    },
    "required": ["boundingVolume", "geometricError", "content"],
    "additionalProperties": False,
}
TILESET = {
    "$defs": {"tile": TILE},
    "type": "object",
    "properties": {
        "asset": {
            "type": "object",
            "properties": {"version": {"const": "1.1"}, "extras": ABOUT},
            "required": ["version", "extras"],
            "additionalProperties": False,
        },
        "geometricError": {"type": "number", "minimum": 0},
        "root": {"allOf": [{"$ref": "#/$defs/tile"}, {"required": ["refine"]}]},
    },
    "required": ["asset", "geometricError", "root"],
    "additionalProperties": False,
}


@pytest.mark.parametrize("name", NAMES)
def test_the_tileset_follows_the_schema(folders: dict[str, Path], name: str) -> None:
    tree = json.loads((folders[name] / "tileset.json").read_bytes())
    jsonschema.validate(tree, TILESET, cls=jsonschema.Draft202012Validator)
    assert tree["geometricError"] >= tree["root"]["geometricError"]
    files = {
        path.relative_to(folders[name]).as_posix() for path in folders[name].rglob("*") if path.is_file()
    }
    named = [tile.tree["content"]["uri"] for tile in read_tiles(folders[name]).all()]
    assert sorted(files) == sorted(["tileset.json", *named])


def get_box(tile: Tile) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    box = np.array(tile.tree["boundingVolume"]["box"])
    half = box[3:].reshape(3, 3)
    assert (half == np.diag(half.diagonal())).all()
    assert (half.diagonal() > 0).all()
    return box[:3] - half.diagonal(), box[:3] + half.diagonal()


@pytest.mark.parametrize("name", NAMES)
def test_boxes_contain_their_content_and_errors_decrease_towards_leaves(
    folders: dict[str, Path], name: str
) -> None:
    for tile in read_tiles(folders[name]).all():
        low, high = get_box(tile)
        assert (low < tile.vertices.min(axis=0)).all()
        assert (tile.vertices.max(axis=0) < high).all()
        for child in tile.children:
            lower, higher = get_box(child)
            assert (low <= lower).all()
            assert (higher <= high).all()
            assert child.tree["geometricError"] <= tile.tree["geometricError"]


def test_a_tile_is_valid_gltf(folders: dict[str, Path]) -> None:
    tile = read_tiles(folders["closed"])
    assert tile.gltf["extensionsUsed"] == ["KHR_mesh_quantization", "KHR_materials_unlit"]
    assert tile.gltf["extensionsRequired"] == ["KHR_mesh_quantization"]
    (node,) = tile.gltf["nodes"]
    step = node["scale"][0]
    assert node["scale"] == [step] * 3
    assert np.frexp(step)[0] == 0.5
    # All decoded values are exact in single precision.
    assert (np.array(node["translation"], np.float32) == node["translation"]).all()
    assert (np.rint(tile.vertices / step) * step == tile.vertices).all()
    assert tile.triangles.max() == len(tile.vertices) - 1
    assert len(np.unique(tile.triangles)) == len(tile.vertices)


def test_other_readers_get_the_same_tiles(folders: dict[str, Path]) -> None:
    for tile in read_tiles(folders["open"]).all():
        mesh = read_mesh(folders["open"] / tile.tree["content"]["uri"])
        x, y, z = tile.vertices.T
        assert (mesh.vertices == np.stack([x, z, -y], axis=1)).all()
        assert (mesh.triangles == tile.triangles).all()
        assert mesh.colors is not None


def test_tiles_without_colours_are_shaded(hierarchies: dict[str, Hierarchy], tmp_path: Path) -> None:
    lod.write_tiles(replace(hierarchies["open"], colors=None), tmp_path / "out")
    for tile in read_tiles(tmp_path / "out").all():
        assert tile.colors is None
        assert tile.gltf["extensionsUsed"] == ["KHR_mesh_quantization"]
        assert list(tile.tree["content"]["extras"]) == ["shape_bound_m"]


def test_many_vertices_use_32_bit_indices(hierarchies: dict[str, Hierarchy]) -> None:
    count = 65_536
    vertices = np.stack([np.arange(count), np.arange(count) % 7, np.zeros(count)], axis=1)
    triangles = np.stack([np.arange(count - 2) + k for k in range(3)], axis=1).astype(np.int32)
    grid = replace(snap_to_grid(hierarchies["open"])[1], step=1.0)
    for number, kind in ((count, 5125), (count - 2, 5123)):
        mesh = Mesh(vertices[:number], triangles[: number - 2])
        gltf, binary = read_glb_chunks(encode_tile_glb(mesh, grid))
        index = gltf["accessors"][gltf["meshes"][0]["primitives"][0]["indices"]]
        view = gltf["bufferViews"][index["bufferView"]]
        assert index["componentType"] == kind
        read = np.frombuffer(binary, {5125: "<u4", 5123: "<u2"}[kind], index["count"], view["byteOffset"])
        assert (read == mesh.triangles.reshape(-1)).all()


@pytest.mark.parametrize("seed", range(5))
def test_different_vertices_get_different_grid_positions(
    hierarchies: dict[str, Hierarchy], seed: int
) -> None:
    rng, hierarchy = np.random.default_rng(seed), hierarchies["open"]
    step = snap_to_grid(hierarchy)[1].step
    vertices = hierarchy.vertices.copy()
    # Many vertices within one step of another vertex, and copies that must stay together.
    crowd, copies = rng.choice(np.arange(10, len(vertices)), (2, 60), replace=False)
    vertices[crowd] = vertices[:6].repeat(10, axis=0) + rng.uniform(-0.3, 0.3, (60, 3)) * step
    vertices[copies] = vertices[crowd]
    placed, grid = snap_to_grid(replace(hierarchy, vertices=vertices))
    _, before = np.unique(vertices, axis=0, return_inverse=True)
    _, after = np.unique(placed.vertices, axis=0, return_inverse=True)
    pairs = np.unique(np.stack([before.reshape(-1), after.reshape(-1)]), axis=1)
    assert pairs.shape[1] == before.max() + 1 == after.max() + 1
    away = np.linalg.norm(placed.vertices - vertices, axis=1).max()
    assert 0.9 * step < away <= grid.max_displacement_m < 4 * step


def test_too_many_vertices_at_one_position_are_reported(hierarchies: dict[str, Hierarchy]) -> None:
    hierarchy = hierarchies["open"]
    rng = np.random.default_rng(0)
    count = 9**3 + 1
    vertices = np.vstack([hierarchy.vertices, 0.5 + 1e-9 * rng.random((count, 3))])
    with pytest.raises(InputError, match="too close to each other"):
        snap_to_grid(replace(hierarchy, vertices=vertices))


def test_grid_steps_are_as_fine_as_16_bits_allow(hierarchies: dict[str, Hierarchy]) -> None:
    for hierarchy in hierarchies.values():
        _, grid = snap_to_grid(hierarchy)
        size = np.ptp(hierarchy.vertices, axis=0).max()
        assert 2**15 - 20 < size / grid.step <= 2**16 - 1
        assert grid.step <= 0.25 * hierarchy.shape_bound.min()
        assert not grid.origin.any()


@pytest.mark.parametrize("single", [False, True])
def test_models_far_from_the_origin_are_moved_by_the_root_transform(
    hierarchies: dict[str, Hierarchy], tmp_path: Path, single: bool
) -> None:
    hierarchy = hierarchies["open"]
    if single:
        hierarchy = replace(hierarchy, shape_bound=1e-6 * hierarchy.shape_bound)
    far = replace(hierarchy, vertices=np.add(hierarchy.vertices, (4e5, -5e6, 90)))
    written = lod.write_tiles(far, tmp_path / "out", up="-y")
    tree = json.loads((tmp_path / "out" / "tileset.json").read_bytes())
    transform = np.array(tree["root"]["transform"]).reshape(4, 4).T
    points = np.vstack([tile.vertices for tile in read_tiles(tmp_path / "out").leaves()]).astype(np.float64)
    assert abs(points).max() < 1
    x, y, z = (points @ transform[:3, :3].T + transform[:3, 3]).T
    back, was = np.stack([x, -z, y], axis=1), get_finest_mesh(far).vertices
    from scipy.spatial import cKDTree

    assert cKDTree(was).query(back)[0].max() <= written.grid.max_displacement_m
    assert cKDTree(back).query(was)[0].max() <= written.grid.max_displacement_m


@pytest.mark.parametrize("up", ["+x", "-x", "+y", "-y", "+z", "-z"])
def test_the_root_transform_turns_the_up_axis_to_z(
    hierarchies: dict[str, Hierarchy], tmp_path: Path, up: str
) -> None:
    lod.write_tiles(hierarchies["open"], tmp_path / "out", up=up)
    root = json.loads((tmp_path / "out" / "tileset.json").read_bytes())["root"]
    transform = np.array(root.get("transform", np.eye(4).tolist()), float).reshape(4, 4).T
    axis = {"+": 1, "-": -1}[up[0]] * np.eye(4)["xyz".index(up[1])]
    assert (transform @ axis == (0, 0, 1, 0)).all()
    assert np.linalg.det(transform[:3, :3]) == pytest.approx(1)
    assert (transform @ transform.T == np.eye(4)).all()
    assert ("transform" in root) is (up != "+z")


def test_up_none_writes_no_transform(hierarchies: dict[str, Hierarchy], tmp_path: Path) -> None:
    lod.write_tiles(hierarchies["open"], tmp_path / "out", up="none")
    assert "transform" not in json.loads((tmp_path / "out" / "tileset.json").read_bytes())["root"]


def test_the_up_axis_comes_from_the_option_the_levels_or_the_model(
    hierarchies: dict[str, Hierarchy], tmp_path: Path
) -> None:
    plain, upright = hierarchies["open"], replace(hierarchies["open"], up=(0.0, 0.0, 1.0))
    model = plain.cut(max_shape=0).mesh.with_(up=(1.0, 0.0, 0.0))
    model = model.with_(colors=np.full((len(model.vertices), 3), 99, np.uint8))

    def write_and_get_up(hierarchy: Hierarchy, **words: Any) -> tuple[float, float, float] | None:
        return lod.write_tiles(hierarchy, tmp_path / "out", **words).up

    assert write_and_get_up(plain) == (0, -1, 0)
    assert write_and_get_up(upright) == (0, 0, 1)
    assert write_and_get_up(plain, texture=model) == (1, 0, 0)
    assert write_and_get_up(upright, texture=model) == (0, 0, 1)
    assert write_and_get_up(upright, up="+y") == (0, 1, 0)
    assert write_and_get_up(upright, up="none") is None


def test_an_unknown_up_axis_is_refused(hierarchies: dict[str, Hierarchy], tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="up is 'y'; it must be one of"):
        lod.write_tiles(hierarchies["open"], tmp_path / "out", up="y")
    assert list(tmp_path.iterdir()) == []


def read_contents(folder: Path) -> dict[str, bytes]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()
    }


def test_tiles_are_deterministic_and_replace_older_tiles(
    hierarchies: dict[str, Hierarchy], folders: dict[str, Path], tmp_path: Path
) -> None:
    lod.write_tiles(hierarchies["closed"], tmp_path / "out")
    lod.write_tiles(hierarchies["open"], tmp_path / "out")
    assert read_contents(tmp_path / "out") == read_contents(folders["open"])
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def make_file(folder: Path) -> None:
    (folder / "out").write_text("mine")


def make_folder_with_notes(folder: Path) -> None:
    (folder / "out").mkdir()
    (folder / "out" / "notes.txt").write_text("mine")


def make_tileset_with_notes(folder: Path) -> None:
    (folder / "out" / "tiles").mkdir(parents=True)
    (folder / "out" / "tileset.json").write_text('{"asset": {"extras": {"scanloom": "0.1.0"}}}')
    (folder / "out" / "notes.txt").write_text("mine")


def make_foreign_tileset(folder: Path) -> None:
    (folder / "out" / "tiles").mkdir(parents=True)
    (folder / "out" / "tileset.json").write_text('{"asset": {"version": "1.1"}}')


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (make_file, "this is a file"),
        (make_folder_with_notes, "this folder is not empty and is not a tileset of scanloom"),
        (make_tileset_with_notes, "this folder is not empty"),
        (make_foreign_tileset, "this folder is not empty"),
    ],
)
def test_other_files_and_folders_are_not_replaced(
    hierarchies: dict[str, Hierarchy], tmp_path: Path, make: Callable[[Path], None], message: str
) -> None:
    make(tmp_path)
    before = read_contents(tmp_path)
    with pytest.raises(InputError, match=message):
        lod.write_tiles(hierarchies["open"], tmp_path / "out")
    assert read_contents(tmp_path) == before


def test_an_empty_folder_is_filled(hierarchies: dict[str, Hierarchy], tmp_path: Path) -> None:
    (tmp_path / "new" / "out").mkdir(parents=True)
    lod.write_tiles(hierarchies["open"], tmp_path / "new" / "out")
    assert (tmp_path / "new" / "out" / "tileset.json").is_file()


def test_a_failure_keeps_the_older_tiles(
    hierarchies: dict[str, Hierarchy], folders: dict[str, Path], tmp_path: Path
) -> None:
    def stop(done: int, _all: int) -> None:
        if done == 3:
            raise StageError(MACHINE_BUG, "stopped")

    with pytest.raises(StageError, match="stopped"):
        lod.write_tiles(hierarchies["open"], tmp_path / "out", progress=stop)
    assert list(tmp_path.iterdir()) == []
    lod.write_tiles(hierarchies["closed"], tmp_path / "out")
    with pytest.raises(StageError, match="stopped"):
        lod.write_tiles(hierarchies["open"], tmp_path / "out", progress=stop)
    assert read_contents(tmp_path / "out") == read_contents(folders["closed"])
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_a_truncated_file_gives_no_tiles(hierarchies: dict[str, Hierarchy], tmp_path: Path) -> None:
    path = tmp_path / "cut.slod"
    lod.write_slod(path, hierarchies["open"])
    data = path.read_bytes()
    for share in (0.4, 0.6, 0.8, 0.95):
        path.write_bytes(data[: int(share * len(data))])
        cut = lod.read_slod(path)
        assert cut.nodes < hierarchies["open"].nodes
        with pytest.raises(InputError, match="the finest levels are missing"):
            lod.write_tiles(cut, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_metrics_match_the_written_files(hierarchies: dict[str, Hierarchy], tmp_path: Path) -> None:
    written: Any = lod.write_tiles(hierarchies["open"], tmp_path / "out")
    files = sorted((tmp_path / "out" / "tiles").iterdir())
    metrics = written.to_dict()
    assert metrics["tiles"] == len(files)
    assert metrics["total_bytes"] == sum(path.stat().st_size for path in files)
    assert (
        metrics["root_bytes"]
        == (tmp_path / "out" / read_tiles(tmp_path / "out").tree["content"]["uri"]).stat().st_size
    )
    assert metrics["triangles"] == sum(len(tile.triangles) for tile in read_tiles(tmp_path / "out").all())
    assert metrics["positions"] == "16 bits"


@pytest.mark.slow
@pytest.mark.parametrize("single", [False, True])
@pytest.mark.parametrize("name", NAMES)
def test_the_gltf_validator_reports_no_issues(
    hierarchies: dict[str, Hierarchy], tmp_path: Path, name: str, single: bool
) -> None:
    hierarchy = hierarchies[name]
    if single:
        hierarchy = replace(hierarchy, shape_bound=1e-6 * hierarchy.shape_bound)
    lod.write_tiles(hierarchy, tmp_path / "out")
    issues = run_node(VALIDATE, PAGE, tmp_path / "out" / "tiles")
    assert len(issues) > 5
    assert not any(issues.values()), issues


def list_corner_values(tile: Tile) -> list[tuple[tuple[float, ...], ...]]:
    """List the triangles of a tile by their corner values, independent of the order in the file."""
    known = [tile.vertices, tile.colors, tile.uvs]
    rows = np.hstack([np.asarray(values, np.float64) for values in known if values is not None])
    found = []
    for triangle in rows[tile.triangles].tolist():
        at = [tuple(corner) for corner in triangle]
        first = at.index(min(at))
        found.append((at[first], at[(first + 1) % 3], at[(first + 2) % 3]))
    return sorted(found)


@pytest.mark.parametrize("kind", ["closed", "open", "image", "single"])
def test_compressed_tiles_have_the_same_content(
    hierarchies: dict[str, Hierarchy], tmp_path: Path, kind: str
) -> None:
    hierarchy, model = hierarchies["closed" if kind in ("closed", "single") else "open"], None
    if kind == "single":
        hierarchy = replace(hierarchy, shape_bound=1e-6 * hierarchy.shape_bound)
    if kind == "image":
        model = bake(make_open_mesh(), make_open_mesh()).mesh
    for name, compress in (("plain", "none"), ("packed", "meshopt"), ("again", "meshopt")):
        lod.write_tiles(hierarchy, tmp_path / name, texture=model, compress=compress)
    files = sorted((tmp_path / "plain" / "tiles").iterdir())
    for file in files:
        packed = (tmp_path / "packed" / "tiles" / file.name).read_bytes()
        assert packed == (tmp_path / "again" / "tiles" / file.name).read_bytes()
        assert len(packed) <= file.stat().st_size
    tileset = "tileset.json"
    assert (tmp_path / "packed" / tileset).read_bytes() == (tmp_path / "plain" / tileset).read_bytes()
    run_node(UNPACK, PAGE, tmp_path / "packed" / "tiles")
    pairs = zip(read_tiles(tmp_path / "plain").all(), read_tiles(tmp_path / "packed").all(), strict=True)
    for plain, packed_tile in pairs:
        assert list_corner_values(packed_tile) == list_corner_values(plain)
        assert packed_tile.image == plain.image
        assert packed_tile.gltf["nodes"] == plain.gltf["nodes"]
    assert not any(run_node(VALIDATE, PAGE, tmp_path / "packed" / "tiles").values())


def test_compressed_tiles_are_smaller(tmp_path: Path) -> None:
    hierarchy = lod.build(sheet(60), cell_triangles=2000, root_triangles=1000, ratio=4.0, threads=1)
    plain, packed = (
        lod.write_tiles(hierarchy, tmp_path / name, compress=name) for name in ("none", "meshopt")
    )
    assert packed.sizes.sum() < 0.7 * plain.sizes.sum()
    assert (packed.triangles == plain.triangles).all()


def test_buffers_that_cannot_be_encoded_are_errors() -> None:
    for rows in (np.zeros((5, 6), np.uint8), np.zeros((5, 0), np.uint8), np.zeros((5, 260), np.uint8)):
        with pytest.raises(ValueError, match="it must have a multiple of 4 up to 256"):
            _kernels.encode_rows(rows)
    for triangles in (np.array([[0, 1, 3]], np.int32), np.array([[0, 1, -1]], np.int32)):
        for call in (_kernels.optimize_strip_order, _kernels.encode_triangles):
            with pytest.raises(_kernels.InvalidMeshError, match="only 3 vertices"):
                call(triangles, 3)
    for call in (_kernels.optimize_strip_order, _kernels.encode_triangles):
        with pytest.raises(ValueError, match="triangles must be m × 3"):
            call(np.zeros((1, 2), np.int32), 3)
    assert _kernels.optimize_strip_order(np.zeros((0, 3), np.int32), 0).shape == (0, 3)


@pytest.mark.parametrize("size", [1e300, 1.7e308, float("inf")])
def test_the_grid_step_is_finite_for_any_size(size: float) -> None:
    from scanloom.stages.lod.position_grid import _choose_step

    assert _choose_step(size, 1) >= size
