"""Files for printers: 3MF read by lib3mf, hollow solids, base plates, and parts that fit the bed."""

import zipfile
from itertools import pairwise

import numpy as np
import pytest
import trimesh

from scanloom import check, export, preset, read_mesh
from scanloom.stages.diagnostics.errors import MeshError, UsageError
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.mesh_conversion import as_mesh
from scanloom.stages.surface.texture import Image, Material, Texture

lib3mf = pytest.importorskip("lib3mf")
manifold3d = pytest.importorskip("manifold3d")


def read_3mf(path):
    """Return the objects of a 3MF file as trimesh meshes, and the model."""
    model = lib3mf.get_wrapper().CreateModel()
    reader = model.QueryReader("3mf")
    reader.ReadFromFile(str(path))
    assert reader.GetWarningCount() == 0
    assert model.GetUnit() == lib3mf.ModelUnit.MilliMeter
    found, objects = [], model.GetMeshObjects()
    while objects.MoveNext():
        one = objects.GetCurrentMeshObject()
        assert one.IsManifoldAndOriented()
        points = [list(vertex.Coordinates) for vertex in one.GetVertices()]
        triangles = [list(triangle.Indices) for triangle in one.GetTriangleIndices()]
        found.append(trimesh.Trimesh(points, triangles, process=False))
    return found, model


def make_ball(radius: float = 0.05, center=(0.3, 0.2, 0.1)) -> Mesh:
    ball = trimesh.creation.icosphere(3, radius)
    return as_mesh(ball).with_(vertices=ball.vertices + np.array(center), up=(0.0, 1.0, 0.0))


def export_print(mesh, path, **changes):
    names = ("axes", "unit", "on_floor", "watertight")
    kept = {name: getattr(preset("print", path.suffix), name) for name in names}
    return export(mesh, path, **{**kept, **changes})


def test_a_3mf_file_is_in_millimetres_with_z_up(tmp_path):
    mesh = as_mesh(trimesh.creation.box((0.02, 0.05, 0.03))).with_(up=(0.0, 1.0, 0.0))
    written = export_print(mesh, tmp_path / "a.3mf")
    assert written.diagnostics == ()
    (found,), _ = read_3mf(tmp_path / "a.3mf")
    assert found.is_volume
    np.testing.assert_allclose(found.extents, (20, 30, 50), rtol=1e-6)
    np.testing.assert_allclose(found.bounds[0, 2], 0, atol=1e-5)
    first = (tmp_path / "a.3mf").read_bytes()
    export_print(mesh, tmp_path / "b.3mf")
    assert (tmp_path / "b.3mf").read_bytes() == first
    # The unit of the format, without the preset.
    export(mesh, tmp_path / "c.3mf")
    np.testing.assert_allclose(read_3mf(tmp_path / "c.3mf")[0][0].volume, found.volume, rtol=1e-6)


def test_triangles_with_two_equal_corners_are_left_out(tmp_path):
    box = trimesh.creation.box((0.02, 0.05, 0.03))
    vertices = np.vstack([box.vertices, box.vertices[:1]])
    triangles = np.vstack([box.faces, [[0, 8, 1], [0, 8, 0]]])
    parts = np.array([0] * 12 + [0, 1], np.int32)
    export(
        Mesh(vertices, triangles.astype(np.int32), part_ids=parts, part_names=("box", "none")),
        tmp_path / "a.3mf",
        up="none",
    )
    (found,), _ = read_3mf(tmp_path / "a.3mf")
    assert len(found.faces) == 12
    assert found.is_volume


def test_vertex_colours_are_a_colour_group(tmp_path):
    ball = make_ball()
    colors = np.where(ball.vertices[:, :1] < 0.3, (200, 30, 10), (10, 40, 220)).astype(np.uint8)
    export_print(ball.with_(colors=colors), tmp_path / "a.3mf")
    _, model = read_3mf(tmp_path / "a.3mf")
    groups = model.GetColorGroups()
    assert groups.MoveNext()
    group = groups.GetCurrentColorGroup()
    found = {(one.Red, one.Green, one.Blue) for one in map(group.GetColor, group.GetAllPropertyIDs())}
    assert found == {(200, 30, 10), (10, 40, 220)}


def test_a_texture_is_stored_with_its_coordinates(tmp_path):
    ball = make_ball()
    uvs = (ball.vertices[ball.triangles][:, :, :2] - (0.25, 0.15)) * 10
    image = Image(given=np.full((8, 8, 3), (120, 60, 200), np.uint8))
    texture = Texture(uvs, np.zeros(len(uvs), np.int32), (Material("skin", image, wrap=("clamp", "mirror")),))
    export_print(ball.with_(texture=texture), tmp_path / "a.3mf")
    _, model = read_3mf(tmp_path / "a.3mf")
    groups = model.GetTexture2DGroups()
    assert groups.MoveNext()
    group = groups.GetCurrentTexture2DGroup()
    found = np.array([(one.U, one.V) for one in map(group.GetTex2Coord, group.GetAllPropertyIDs())])
    np.testing.assert_allclose(
        np.unique(found.round(5), axis=0), np.unique(uvs.reshape(-1, 2).round(5), axis=0), atol=2e-5
    )
    with zipfile.ZipFile(tmp_path / "a.3mf") as archive:
        assert archive.read("3D/Textures/1.png") == image.file_bytes


def test_a_hollow_solid_has_walls_and_a_drain_hole(tmp_path):
    upright = make_ball().with_(up=(0.0, 0.0, 1.0))
    closed = export_print(upright, tmp_path / "closed.stl", hollow=0.004)
    assert closed.diagnostics == ()
    shell = read_mesh(tmp_path / "closed.stl")
    volume = trimesh.Trimesh(shell.vertices, shell.triangles).volume
    solid = trimesh.creation.icosphere(3, 50).volume
    assert solid - volume == pytest.approx(4 / 3 * np.pi * 46**3, rel=0.05)
    # The wall is never thinner than asked, from the cavity to the outside.
    distances = np.linalg.norm(shell.vertices - (0, 0, 50), axis=1)
    inner = shell.vertices[distances < 49] - (0, 0, 50)
    ball = trimesh.creation.icosphere(3, 50)
    depths = (ball.triangles_center * ball.face_normals).sum(axis=1) - inner @ ball.face_normals.T
    assert depths.min() >= 3.999
    drained = export_print(make_ball(), tmp_path / "open.stl", hollow=0.004, drain=0.006)
    assert drained.diagnostics == ()
    found = trimesh.load(tmp_path / "open.stl")
    assert found.is_volume
    # A tunnel joins the inside and the outside: one component, still a sphere.
    assert len(found.split(only_watertight=False)) == 1
    assert found.euler_number == 2
    assert found.volume < volume


def test_a_base_plate_is_below_the_object(tmp_path):
    export_print(make_ball(), tmp_path / "a.stl", plate=0.003)
    found = trimesh.load(tmp_path / "a.stl")
    assert found.is_volume
    assert found.bounds[0, 2] == pytest.approx(0, abs=1e-4)
    assert found.extents[2] == pytest.approx(100 + 3 * 0.75, abs=1e-3)
    bottom = found.vertices[found.vertices[:, 2] < 1e-3]
    # The foot is a circle of radius 30 mm; a margin of 3 mm is added.
    assert np.linalg.norm(bottom[:, :2], axis=1).max() == pytest.approx(33, abs=2)


def test_a_large_object_is_split_to_the_bed(tmp_path):
    mesh = as_mesh(trimesh.creation.box((0.25, 0.1, 0.12)).subdivide().subdivide())
    colors = np.full((len(mesh.vertices), 3), (10, 200, 90), np.uint8)
    written = export_print(
        mesh.with_(up=(0.0, 0.0, 1.0), colors=colors), tmp_path / "a.3mf", bed=(0.1, 0.1, 0.1)
    )
    assert written.diagnostics == ()
    found, _ = read_3mf(tmp_path / "a.3mf")
    assert len(found) == 6
    assert sum(one.volume for one in found) == pytest.approx(250 * 100 * 120, rel=1e-5)
    for one in found:
        assert one.is_volume
        assert (one.extents <= 100.001).all()
        assert one.bounds[0, 2] == pytest.approx(0, abs=1e-4)
    starts = sorted((one.bounds[0, 0], one.bounds[1, 0]) for one in found)
    assert all(left[1] < right[0] for left, right in pairwise(starts))


def test_unsuitable_requests_are_refused(tmp_path):
    ball = make_ball()
    opened = ball.with_triangles(ball.triangles[5:], np.arange(5, len(ball.triangles)))
    with pytest.raises(MeshError, match="not solid: it has edges with only one triangle"):
        export_print(opened, tmp_path / "a.stl", hollow=0.004)
    with pytest.raises(UsageError, match="bed does not apply"):
        export_print(ball, tmp_path / "a.stl", bed=(0.1, 0.1, 0.1))
    with pytest.raises(UsageError, match="positive"):
        export_print(ball, tmp_path / "a.3mf", bed=(0.1, 0.0, 0.1))
    with pytest.raises(UsageError, match="hollow"):
        export_print(ball, tmp_path / "a.stl", drain=0.004)
    with pytest.raises(UsageError, match="hollow"):
        export(ball, tmp_path / "a.glb", hollow=0.004)
    assert list(tmp_path.iterdir()) == []


def test_printable_names_every_reason_once():
    ball = make_ball()
    opened = ball.with_triangles(ball.triangles[5:], np.arange(5, len(ball.triangles)))
    found = check(opened, min_thickness=0.2).find_unmet(["printable"])
    assert [one.message.split(":")[0] for one in found] == [
        "it has edges with only one triangle",
        "it has triangles behind which the solid is thinner than min_thickness",
    ]
    assert check(ball).find_unmet(["printable"]) == []
