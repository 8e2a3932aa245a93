"""No mesh writer writes non-finite coordinates or leaves a file when it refuses."""

import dataclasses
import re
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from coloured_meshes import ball, sheet

from scanloom.stages.diagnostics.errors import MeshError
from scanloom.stages.exporting.export import EXPORT_SUFFIXES, export
from scanloom.stages.exporting.usd import write_usd
from scanloom.stages.lod.build import build
from scanloom.stages.lod.slod import write_slod
from scanloom.stages.lod.tiles import write_tiles
from scanloom.stages.normal_meshes.remesh import remesh
from scanloom.stages.surface.chunked_ply import WrittenChunk, write_ply_in_chunks
from scanloom.stages.surface.formats.gltf_writer import write_gltf
from scanloom.stages.surface.formats.obj import write_obj
from scanloom.stages.surface.formats.ply import write_ply
from scanloom.stages.surface.mesh import Image, Material, Mesh, Texture, validate_mesh
from scanloom.stages.surface.mesh_files import MESH_EXTENSIONS, read_mesh, write_mesh

Writer = Callable[[Path, Mesh], object]

WRITERS: dict[str, Writer] = {
    **{f"mesh{extension}": write_mesh for extension in MESH_EXTENSIONS},
    "direct.ply": write_ply,
    "direct.obj": write_obj,
    "direct.glb": write_gltf,
    "small.glb": lambda path, mesh: write_gltf(path, mesh, compress="meshopt"),
    "direct.usda": write_usd,
    "direct.usdz": write_usd,
    **{f"export{extension}": lambda path, mesh: export(mesh, path) for extension in EXPORT_SUFFIXES},
}
FIELDS = ("vertices", "normals", "corner_normals", "uvs")
SINGLE = (".3mf", ".glb", ".gltf", ".stl", ".usda", ".usdz")


def make_complete_mesh() -> Mesh:
    """Make a square of two triangles with every attribute of a mesh."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    image = Image(given=np.full((4, 4, 3), 99, np.uint8))
    return Mesh(
        vertices=vertices,
        triangles=np.array([[0, 1, 2], [0, 2, 3]], np.int32),
        colors=np.full((4, 3), 7, np.uint8),
        normals=np.tile([0.0, 0.0, 1.0], (4, 1)),
        texture=Texture(np.full((2, 3, 2), 0.25), np.zeros(2, np.int32), (Material(image=image),)),
        corner_normals=np.tile([0.0, 0.0, 1.0], (2, 3, 1)),
    )


def replace_value(mesh: Mesh, field: str, value: float) -> Mesh:
    """Replace one number of a field."""
    if field == "uvs":
        uvs = mesh.texture.uvs.copy()
        uvs.flat[-1] = value
        return mesh.with_(texture=dataclasses.replace(mesh.texture, uvs=uvs))
    array = getattr(mesh, field).copy()
    array.flat[-1] = value
    return mesh.with_(**{field: array})


def read_vertices(path: Path) -> np.ndarray:
    """Read the vertices (n, 3) of a mesh, also of a 3MF file."""
    if path.suffix != ".3mf":
        return read_mesh(path).vertices
    with zipfile.ZipFile(path) as archive:
        model = archive.read("3D/3dmodel.model").decode()
    rows = re.findall(r'<vertex x="(\S+)" y="(\S+)" z="(\S+)"', model)
    assert len(rows) == 4
    return np.array(rows, float)


def skip_without_usd(name: str) -> None:
    if Path(name).suffix in (".usda", ".usdz"):
        pytest.importorskip("pxr")


@pytest.mark.parametrize("name", WRITERS)
def test_a_complete_mesh_is_written(tmp_path, name):
    skip_without_usd(name)
    WRITERS[name](tmp_path / name, make_complete_mesh())
    assert (tmp_path / name).stat().st_size > 0


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("field", FIELDS)
@pytest.mark.parametrize("name", WRITERS)
def test_values_that_are_not_finite_are_not_written(tmp_path, name, field, value):
    skip_without_usd(name)
    with pytest.raises(MeshError, match="not finite"):
        WRITERS[name](tmp_path / name, replace_value(make_complete_mesh(), field, value))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("field", FIELDS)
@pytest.mark.parametrize("name", WRITERS)
def test_numbers_beyond_single_precision_do_not_become_infinite(tmp_path, name, field):
    skip_without_usd(name)
    mesh = replace_value(make_complete_mesh(), field, 1e200)
    if Path(name).suffix in SINGLE and field != "uvs":
        with pytest.raises(MeshError, match="beyond single precision"):
            WRITERS[name](tmp_path / name, mesh)
    else:
        WRITERS[name](tmp_path / name, mesh)
        assert name.endswith((".usda", ".usdz")) or np.isfinite(read_vertices(tmp_path / name)).all()


def test_the_message_names_the_file_and_the_vertex(tmp_path):
    with pytest.raises(MeshError) as caught:
        write_mesh(tmp_path / "a.ply", replace_value(make_complete_mesh(), "vertices", np.nan))
    assert str(caught.value) == (
        f"{tmp_path / 'a.ply'}: vertex 3 is [0.0, 1.0, nan], not finite (1 such); nothing is written. "
        "Remove or repair these first."
    )


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_levels_and_tiles_refuse_non_finite_values(tmp_path, value):
    hierarchy = build(sheet(12))
    write_slod(tmp_path / "good.slod", hierarchy)
    vertices = hierarchy.vertices.copy()
    vertices[-1, 1] = value
    bad = dataclasses.replace(hierarchy, vertices=vertices)
    with pytest.raises(MeshError, match="not finite"):
        write_slod(tmp_path / "bad.slod", bad)
    with pytest.raises(MeshError, match="not finite"):
        write_tiles(bad, tmp_path / "tiles")
    assert [path.name for path in tmp_path.iterdir()] == ["good.slod"]


def test_normal_meshes_refuse_non_finite_values(tmp_path):
    made = remesh(ball(), levels=1)
    made.save(tmp_path / "good.snm")
    bad = dataclasses.replace(
        made, levels=(*made.levels[:-1], replace_value(made.levels[-1], "vertices", np.nan))
    )
    for write in (bad.save, lambda path: bad.write(path.with_suffix(".ply"))):
        with pytest.raises(MeshError, match="not finite"):
            write(tmp_path / "bad.snm")
    assert [path.name for path in tmp_path.iterdir()] == ["good.snm"]


def test_chunks_refuse_non_finite_values(tmp_path):
    piece = WrittenChunk(np.array([[0, 0, np.nan]]), None, np.zeros((0, 3), np.int32))
    with pytest.raises(MeshError, match="not finite"):
        write_ply_in_chunks(tmp_path / "a.ply", 1, 0, [piece], has_colors=False)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("field", FIELDS)
def test_validation_refuses_non_finite_values(field):
    with pytest.raises(MeshError, match="not finite"):
        validate_mesh(replace_value(make_complete_mesh(), field, np.nan))
