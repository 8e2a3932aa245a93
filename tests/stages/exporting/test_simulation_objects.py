"""Simulation models with one body for each object of a scan."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as Xml

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from objects_on_table import (
    BOX_CENTER,
    BOX_SIZE,
    CAN_CENTER,
    CAN_HEIGHT,
    CAN_RADIUS,
    CAN_SIDES,
    make_box,
    make_default_table,
    scan_table,
)

from scanloom import Image, Material, Mesh, Texture, export_simulation
from scanloom.stages.diagnostics.collector import collecting
from scanloom.stages.exporting.simulation import decomposition
from scanloom.stages.exporting.simulation.body import Body, HalfSpace
from scanloom.stages.exporting.simulation.body_plan import lower_floor, plan_bodies
from scanloom.stages.exporting.simulation.clearance import clear_obstacles
from scanloom.stages.exporting.simulation.collision_proof import prove_collision
from scanloom.stages.exporting.simulation.convex_part import (
    ConvexPart,
    PartSet,
    build_box,
    build_part,
    find_separating_plane,
    fit_rectangle,
    measure_separation,
)
from scanloom.stages.exporting.simulation.decomposition import (
    MAX_CORNERS,
    decompose_solid,
    decompose_surface,
)
from scanloom.stages.exporting.simulation.export_simulation import SimulationResult
from scanloom.stages.exporting.simulation.object_splitting import DividedScan, divide_scan
from scanloom.stages.exporting.simulation.overlaps import find_overlaps
from scanloom.stages.exporting.simulation.plane_cut import cut_along_plane
from scanloom.stages.files.subprocess_reader import SubprocessDiedError, run_reader_subprocess
from scanloom.stages.surface.mesh_conversion import as_mesh
from scanloom.stages.surface.topology import compute_areas, topology

pytest.importorskip("coacd")
pytest.importorskip("pxr")
pytest.importorskip("manifold3d")


def add_texture(mesh: Mesh) -> Mesh:
    uvs = mesh.vertices[mesh.triangles][:, :, :2] + 0.5
    pixels = np.random.default_rng(3).integers(0, 256, (64, 64, 3)).astype(np.uint8)
    texture = Texture(uvs, np.zeros(len(uvs), np.int32), (Material("scan", Image("scan.png", given=pixels)),))
    return mesh.with_(texture=texture)


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, SimulationResult]:
    folder = tmp_path_factory.mktemp("written") / "table"
    return folder, export_simulation(add_texture(make_default_table()), folder, split="objects")


@pytest.fixture(scope="module")
def bodies(table: tuple[Path, SimulationResult]) -> dict[str, Body]:
    return {body.name: body for body in table[1].bodies}


def test_objects_are_bodies_in_order_of_volume(bodies: dict[str, Body]) -> None:
    assert list(bodies) == ["static", "object_1", "object_2"]
    assert [body.is_static for body in bodies.values()] == [True, False, False]
    assert bodies["object_1"].mass.mass_kg == pytest.approx(1000 * np.prod(BOX_SIZE), rel=1e-3)
    can = CAN_HEIGHT * CAN_SIDES / 2 * np.sin(2 * np.pi / CAN_SIDES) * CAN_RADIUS**2
    assert bodies["object_2"].mass.mass_kg == pytest.approx(1000 * can, rel=1e-3)
    np.testing.assert_allclose(bodies["object_1"].position, (*BOX_CENTER, 0), atol=1e-5)
    np.testing.assert_allclose(bodies["object_2"].position, (*CAN_CENTER, 0), atol=1e-5)
    np.testing.assert_allclose(bodies["object_1"].mass.center_m, (0, 0, BOX_SIZE[2] / 2), atol=1e-4)
    for name in ("object_1", "object_2"):
        found = topology(bodies[name].visual)
        # The texture has seams, so positions are compared.
        welded = trimesh.Trimesh(bodies[name].visual.vertices, bodies[name].visual.triangles)
        assert welded.is_watertight
        assert found.degenerate == 0
        assert bodies[name].proof.gap_m == 0
        assert max(len(part.vertices) for part in bodies[name].parts) <= MAX_CORNERS


def test_added_surface_has_its_own_material(bodies: dict[str, Body]) -> None:
    visual = bodies["object_1"].visual
    assert visual.texture is not None
    assert [one.name for one in visual.texture.materials] == ["scan", "added"]
    is_added = visual.texture.material_ids == 1
    heights = visual.vertices[visual.triangles[is_added]][:, :, 2]
    # The base, and the wall from the cut to the base.
    assert heights.max() < 0.003
    area = compute_areas(visual.vertices, visual.triangles)
    assert bodies["object_1"].added_ratio == pytest.approx(area[is_added].sum() / area.sum())
    assert area[is_added].sum() > BOX_SIZE[0] * BOX_SIZE[1]


def test_the_table_is_closed_below_objects(bodies: dict[str, Body]) -> None:
    rest = bodies["static"].visual
    normals = np.cross(*np.diff(rest.vertices[rest.triangles], axis=1).transpose(1, 0, 2))
    is_level = rest.vertices[rest.triangles][:, :, 2].max(axis=1) < 1e-9
    # One flat sheet without holes: its area is that of the table, without the crumb.
    assert normals[is_level][:, 2].sum() / 2 == pytest.approx(0.8 - 0.005**2, rel=1e-4)
    assert normals[is_level][:, 2].min() > 0


def test_messages_state_added_surface_and_crumbs(table: tuple[Path, SimulationResult]) -> None:
    messages = {one.code: one.message for one in table[1].diagnostics}
    assert set(messages) == {"export.not-split", "export.object-closed", "export.open-body"}
    assert "2 objects" in messages["export.not-split"]
    assert "1 too small" in messages["export.not-split"]


def test_bodies_do_not_overlap(table: tuple[Path, SimulationResult], bodies: dict[str, Body]) -> None:
    report = json.loads((table[0] / "simulation.json").read_text())
    assert report["overlaps"] == []
    assert [one["name"] for one in report["bodies"]] == list(bodies)
    # The test would find an overlap of 2 mm.
    x, y, z = bodies["object_1"].position
    lowered = replace(bodies["object_1"], position=(x, y, z - 0.002))
    (found,) = find_overlaps([bodies["static"], lowered])
    assert (found.first, found.second) == ("static", "object_1")
    assert 0.0019 < found.depth_m < 0.0021


def test_the_table_is_a_box_and_a_half_space(table: tuple[Path, SimulationResult]) -> None:
    from pxr import Usd, UsdPhysics

    folder, result = table
    static = result.bodies[0]
    assert static.floor is not None
    boxes = [part for part in static.parts if part.box is not None]
    assert len(boxes) == 1
    assert boxes[0].vertices[:, 2].max() == pytest.approx(0, abs=1e-9)
    np.testing.assert_allclose(np.ptp(boxes[0].vertices, axis=0)[:2], (1, 0.8))
    assert static.proof.gap_m == 0
    world = Xml.parse(folder / "model.xml").getroot().find("worldbody")
    assert world is not None
    shapes = [one.get("type") for one in world.findall("body[@name='static']/geom[@class='collision']")]
    assert shapes == ["plane", None]
    links = Xml.parse(folder / "static.urdf").getroot()
    assert len(links.findall(".//collision//box")) == 1
    models = Xml.parse(folder / "model.sdf").getroot().findall("world/model")
    assert [one.get("name") for one in models] == ["static", "object_1", "object_2"]
    normal = models[0].find(".//collision//plane/normal")
    assert normal is not None
    assert normal.text == "0.0 0.0 1.0"
    assert models[1].findtext("pose", "").split()[:2] == ["-0.2", "0"]
    stage = Usd.Stage.Open(str(folder / "model.usda"))
    kinds = {prim.GetTypeName() for prim in stage.Traverse() if prim.HasAPI(UsdPhysics.CollisionAPI)}
    assert kinds == {"Plane", "Mesh"}
    movable = [prim.GetName() for prim in stage.Traverse() if prim.HasAPI(UsdPhysics.RigidBodyAPI)]
    assert movable == ["object_1", "object_2"]


def read_corners(folder: Path, name: str) -> np.ndarray:
    files = sorted((folder / "meshes").glob(f"{name}_visual*.obj"))
    lines = [line for file in files for line in file.read_text().splitlines()]
    return np.array([line.split()[1:4] for line in lines if line.startswith("v ")], float)


def settle(mujoco: Any, spec: Any, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Drop a body from 1 cm; return its centre of mass and rotation at rest."""
    spec.option.timestep = 0.001
    model = spec.compile()
    data = mujoco.MjData(model)
    body = model.body(name).id
    data.qpos[model.jnt_qposadr[model.body_jntadr[body]] + 2] += 0.01
    mujoco.mj_step(model, data, nstep=3000)
    assert np.abs(data.qvel).max() < 0.01
    return data.xipos[body].copy(), data.xmat[body].reshape(3, 3).copy()


@pytest.mark.parametrize("name", ["object_1", "object_2"])
def test_objects_rest_where_their_mesh_does(table: tuple[Path, SimulationResult], name: str) -> None:
    mujoco = pytest.importorskip("mujoco")
    folder, _ = table
    path = str(folder / "model.xml")
    model = mujoco.MjModel.from_xml_path(path)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert all(contact.dist > 0 for contact in data.contact[: data.ncon])
    center, turn = settle(mujoco, mujoco.MjSpec.from_file(path), name)
    spec = mujoco.MjSpec.from_file(path)
    body = spec.body(name)
    for geom in list(body.geoms):
        if "collision" in (geom.meshname or ""):
            spec.delete(geom)
    mesh = spec.add_mesh()
    mesh.name, mesh.uservert = "hull", read_corners(folder, name).ravel()
    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
    geom = spec.body(name).add_geom()
    geom.type, geom.meshname = mujoco.mjtGeom.mjGEOM_MESH, "hull"
    expected, expected_turn = settle(mujoco, spec, name)
    cosine = (np.trace(turn.T @ expected_turn) - 1) / 2
    assert np.linalg.norm(center - expected) < 0.001
    assert np.degrees(np.arccos(np.clip(cosine, -1, 1))) < 1
    # The object is where it was scanned.
    assert np.linalg.norm(center - data.xipos[model.body(name).id]) < 0.001


def test_mujoco_reads_each_urdf(table: tuple[Path, SimulationResult]) -> None:
    mujoco = pytest.importorskip("mujoco")
    for body in table[1].bodies:
        model = mujoco.MjModel.from_xml_path(str(table[0] / f"{body.name}.urdf"))
        assert np.count_nonzero(model.geom_contype) == len(body.parts)


def divide(objects: list[Any]) -> DividedScan:
    return divide_scan(scan_table(objects))


def test_an_object_on_an_object_is_part_of_it() -> None:
    lower = make_box((0.2, 0.2, 0.11), (0, 0), -0.01)
    divided = divide([lower + make_box((0.06, 0.06, 0.11), (0, 0), 0.09)])
    assert [one.stacked for one in divided.objects] == [1]
    assert divided.objects[0].volume_m3 == pytest.approx(0.2 * 0.2 * 0.1 + 0.06 * 0.06 * 0.1, rel=1e-3)


def test_a_bowl_is_one_object_without_others_on_it() -> None:
    bowl = make_box((0.2, 0.2, 0.11), (0, 0), -0.01) - make_box((0.16, 0.16, 0.1), (0, 0), 0.03)
    divided = divide([bowl])
    assert [one.stacked for one in divided.objects] == [0]
    assert divided.objects[0].volume_m3 == pytest.approx(0.2 * 0.2 * 0.1 - 0.16 * 0.16 * 0.07, rel=1e-3)


def test_a_frame_keeps_its_hole() -> None:
    frame = make_box((0.2, 0.2, 0.11), (0, 0), -0.01) - make_box((0.1, 0.1, 0.2), (0, 0), -0.05)
    table = make_box((1.0, 0.8, 0.02), (0, 0), -0.02)
    divided = divide_scan(scan_table([frame + table]))
    assert [one.stacked for one in divided.objects] == [0]
    assert divided.objects[0].volume_m3 == pytest.approx((0.2**2 - 0.1**2) * 0.1, rel=1e-3)
    # The table is seen through the hole, and is one flat sheet afterwards.
    rest = divided.rest
    assert compute_areas(rest.vertices, rest.triangles).sum() == pytest.approx(0.8, rel=1e-4)


def test_an_object_that_is_seen_from_one_side_is_continued_to_the_table() -> None:
    mesh = scan_table([make_box((0.2, 0.14, 0.17), (0, 0), -0.01)], 0.02)
    noise = 0.0003 * np.random.default_rng(2).standard_normal(mesh.vertices.shape)
    mesh = mesh.with_(vertices=mesh.vertices + noise)
    # Neither the back of the box nor the table behind is seen.
    centers = mesh.vertices[mesh.triangles].mean(axis=1)
    kept = ~((centers[:, 1] > 0.068) & (np.abs(centers[:, 0]) < 0.12))
    divided = divide_scan(mesh.with_triangles(mesh.triangles[kept], kept))
    assert len(divided.objects) == 1
    assert divided.objects[0].volume_m3 == pytest.approx(0.2 * 0.14 * 0.16, rel=0.03)
    (found,) = divided.objects
    heights = found.plane.measure_heights(found.mesh.vertices)
    assert heights.min() == pytest.approx(found.bottom_m - found.plane.offset_m, abs=1e-9)


def add_sheet(mesh: Mesh, corner: tuple[float, float, float]) -> Mesh:
    """Add an upright sheet of 4 cm × 3 cm, 5 cm above the table."""
    sides = [(0, 0, 0), (0.04, 0, 0), (0.04, 0, 0.03), (0, 0, 0.03)]
    start = len(mesh.vertices)
    triangles = np.array([(0, 1, 2), (0, 2, 3)], np.int32) + start
    return mesh.with_(
        vertices=np.concatenate([mesh.vertices, np.add(corner, sides)]),
        triangles=np.concatenate([mesh.triangles, triangles]).astype(np.int32),
    )


@pytest.mark.parametrize(
    ("y", "torn"),
    [
        pytest.param(-0.05, 1, id="inside"),
        pytest.param(-0.08, 1, id="next to it"),
        pytest.param(-0.15, 0, id="apart"),
    ],
)
def test_torn_sheets_of_an_object_do_not_stay_static(y: float, torn: int) -> None:
    box = make_box((*BOX_SIZE[:2], BOX_SIZE[2] + 0.01), (0, 0), -0.01)
    divided = divide_scan(add_sheet(scan_table([box]), (0.0, y, 0.05)))
    assert len(divided.objects) == 1
    assert divided.torn == torn
    assert (divided.rest.vertices[:, 2].max() > 0.01) == (torn == 0)
    with collecting() as diagnostics:
        plan_bodies(add_sheet(scan_table([box]), (0.0, y, 0.05)))
    assert any("1 torn components" in one.message for one in diagnostics) == (torn == 1)


def test_a_wall_is_no_object() -> None:
    # A room corner, seen from inside.
    room = trimesh.creation.box((1, 1, 1)).subdivide().subdivide().subdivide()
    centers = room.triangles_center
    kept = (centers[:, 2] < 0.499) & (centers[:, 0] < 0.499)
    triangles = np.array(room.faces[kept][:, ::-1], np.int32)
    divided = divide_scan(Mesh(np.array(room.vertices), triangles, up=(0.0, 0.0, 1.0)))
    assert (len(divided.objects), divided.sheets) == (0, 1)


@pytest.mark.parametrize(
    ("make_mesh", "expected"),
    [
        pytest.param(lambda: tilt(scan_table([])), "no level floor or table", id="tilted"),
        pytest.param(lambda: scan_table([]), "nothing stands on the level planes", id="empty table"),
        pytest.param(
            lambda: scan_table([make_box((0.005, 0.005, 0.015), (0, 0), -0.01)]),
            "1 are too small",
            id="crumb",
        ),
        pytest.param(lambda: make_shelf(), "attached to other surfaces", id="shelf"),
    ],
)
def test_a_scan_without_objects_is_one_static_body(make_mesh: Callable[[], Mesh], expected: str) -> None:
    with collecting() as diagnostics:
        plans = plan_bodies(make_mesh())
    assert [(plan.name, plan.is_static, plan.floor) for plan in plans] == [("static", True, None)]
    (found,) = diagnostics
    assert found.code == "export.no-objects"
    assert expected in found.message


def tilt(mesh: Mesh) -> Mesh:
    angle = np.radians(40)
    turn = np.array([[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]])
    return mesh.with_(vertices=mesh.vertices @ turn.T)


def make_shelf() -> Mesh:
    """Make a table with a shelf that carries nothing, and reaches beyond the table."""
    leg = make_box((0.05, 0.05, 0.42), (0.4, 0), -0.01)
    return scan_table([leg + make_box((0.5, 0.8, 0.02), (0.5, 0), 0.4)])


def test_cut_triangles_share_vertices_and_keep_the_area() -> None:
    made = trimesh.creation.icosphere(subdivisions=2)
    vertices, triangles = np.array(made.vertices), np.array(made.faces, np.int32)
    # Some vertices are exactly on the plane.
    heights = vertices[:, 2] - vertices[np.abs(vertices[:, 2] - 0.3).argmin(), 2]
    cut = cut_along_plane(vertices, triangles, heights, np.ones(len(triangles), bool))
    assert len(cut.triangles) > len(triangles)
    result = trimesh.Trimesh(cut.vertices, cut.triangles, process=False)
    assert result.is_watertight
    assert result.is_winding_consistent
    assert result.area == pytest.approx(made.area)
    signs = np.sign(cut.heights)[cut.triangles]
    assert not ((signs.min(axis=1) < 0) & (signs.max(axis=1) > 0)).any()
    np.testing.assert_allclose(
        np.bincount(cut.parents, compute_areas(cut.vertices, cut.triangles)), made.area_faces
    )


def test_the_smallest_rectangle_has_the_size_of_a_turned_one() -> None:
    rng = np.random.default_rng(5)
    axes = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    inside = rng.uniform(-1, 1, (200, 2)) * (2, 0.5)
    flat = np.concatenate([inside, [(-2, -0.5), (2, 0.5), (-2, 0.5), (2, -0.5)]])
    points = flat @ axes[:2] + (5, 6, 7)
    found = fit_rectangle(points, axes[2])
    np.testing.assert_allclose(found @ found.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(found) == pytest.approx(1)
    part = build_box(points, found, 0.1)
    assert part.contains(points).all()
    assert part.box is not None
    np.testing.assert_allclose(np.sort(part.box.half_sizes), (0.05, 0.5, 2))


def test_separation_of_parts() -> None:
    first = build_box(np.array(np.meshgrid(*[(0.0, 1.0)] * 3)).reshape(3, -1).T, np.eye(3), 0.0)
    second = build_part(first.vertices + np.array([1.25, 0.5, 0]))
    assert measure_separation(first, second) == pytest.approx(0.25)
    assert PartSet([second]).is_clear(first)
    overlapping = build_part(first.vertices + np.array([0.9, 0.5, 0]))
    assert measure_separation(first, overlapping) == pytest.approx(-0.1)
    assert PartSet([second, overlapping]).list_touching(first) == [overlapping]


def test_a_surface_avoids_obstacles_and_ends_at_those_on_it() -> None:
    mesh = scan_table([], 0.1)
    above = build_box(np.array([(0.0, 0.0, 0.001), (0.2, 0.1, 0.2)]), np.eye(3), 0.0)
    crossing = build_box(np.array([(-0.3, -0.2, -0.01), (-0.28, -0.18, 0.2)]), np.eye(3), 0.0)
    obstacles = PartSet([above, crossing])
    parts = decompose_surface(mesh, 0.04, obstacles)
    assert prove_collision(mesh, parts, is_solid=False, resolution_m=0.02).gap_m == 0
    touching = [part for part in parts if not obstacles.is_clear(part)]
    # Only next to the obstacle that the surface crosses.
    assert 0 < len(touching) < len(parts) < 200
    corners = np.concatenate([part.vertices for part in touching])
    assert np.abs(corners[:, :2] - (-0.29, -0.19)).max() < 0.05


def test_a_floor_is_below_all_bodies() -> None:
    floor = HalfSpace(np.array([0.0, 0.0, 1.0]), 0.25)
    corners = [np.array([(0.0, 0.0, 0.3), (1.0, 0.0, 0.247)]), np.array([(0.0, 0.0, 0.26)])]
    assert lower_floor(floor, corners).offset_m == 0.247
    assert lower_floor(floor, [corners[1]]).offset_m == 0.25


def measure_common_volume(first: ConvexPart, second: ConvexPart) -> float:
    """Measure by an independent library."""
    manifold3d = pytest.importorskip("manifold3d")
    one, other = (
        manifold3d.Manifold(manifold3d.Mesh64(part.vertices, part.triangles.astype(np.uint64)))
        for part in (first, second)
    )
    return float((one ^ other).volume())


def make_cuboid(low: Sequence[float], high: Sequence[float]) -> ConvexPart:
    return build_box(np.array([low, high], float), np.eye(3), 0.0)


def test_a_part_keeps_its_surface_where_a_plane_separates_it_from_an_obstacle() -> None:
    surface = as_mesh(trimesh.creation.box((1, 1, 1)))
    part = make_cuboid((-0.55,) * 3, (0.55,) * 3)
    obstacles = [make_cuboid((0.52, -1, -1), (0.8, 1, 1)), make_cuboid((-1, 0.51, -1), (1, 0.9, 1))]
    (cleared,) = clear_obstacles([part], PartSet(obstacles), surface, 0.01)
    assert prove_collision(surface, [cleared], is_solid=True).gap_m == 0
    assert 0.5 < cleared.vertices[:, 0].max() < 0.52
    assert 0.5 < cleared.vertices[:, 1].max() < 0.51
    assert max(measure_common_volume(cleared, one) for one in obstacles) == 0


def test_a_part_ends_at_an_obstacle_that_the_surface_enters() -> None:
    surface = as_mesh(trimesh.creation.box((1, 1, 1)))
    obstacle = make_cuboid((0.47, -1, -1), (0.8, 1, 1))
    part = make_cuboid((-0.5,) * 3, (0.5,) * 3)
    (cleared,) = clear_obstacles([part], PartSet([obstacle]), surface, 0.01)
    assert measure_common_volume(cleared, obstacle) == 0
    assert prove_collision(surface, [cleared], is_solid=True).gap_m == pytest.approx(0.03, abs=1e-5)
    # Nothing is left of a part inside of an obstacle.
    assert clear_obstacles([part], PartSet([make_cuboid((-1,) * 3, (1,) * 3)]), surface, 0.01) == []


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_no_part_overlaps_random_obstacles_afterwards(seed: int) -> None:
    rng = np.random.default_rng(seed)
    parts = [build_part(rng.normal(rng.normal(0, 0.5, 3), 0.3, (12, 3))) for _ in range(3)]
    obstacles = [build_part(rng.normal(rng.normal(0, 0.7, 3), 0.2, (8, 3))) for _ in range(4)]
    surface = as_mesh(trimesh.creation.icosphere(1, 0.6))
    cleared = clear_obstacles(parts, PartSet(obstacles), surface, 0.01)
    assert sum(measure_common_volume(one, other) for one in cleared for other in obstacles) < 1e-12
    # Nothing is added.
    for one in cleared:
        assert any(part.compute_heights(one.vertices).max() < 1e-9 for part in parts)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_a_plane_separates_points_or_there_is_none(seed: int) -> None:
    rng = np.random.default_rng(seed)
    below, above = rng.normal(0, 0.3, (20, 3)), rng.normal((rng.uniform(0, 3), 0, 0), 0.3, (15, 3))
    plane = find_separating_plane(below, above)
    if plane is not None:
        assert np.linalg.norm(plane[:3]) == pytest.approx(1)
        assert (below @ plane[:3] + plane[3]).max() < 0 < (above @ plane[:3] + plane[3]).min()
    else:
        assert measure_common_volume(build_part(below), build_part(above)) > 0


def test_a_crash_of_coacd_leads_to_another_preprocessing(monkeypatch: pytest.MonkeyPatch) -> None:
    tried = []

    def run(module: str, arguments: list[str], seconds: float) -> dict[str, Any]:
        tried.append(arguments[-1])
        if arguments[-1] == "auto":
            raise SubprocessDiedError("aborted")
        return run_reader_subprocess(module, arguments, seconds)

    monkeypatch.setattr(decomposition, "run_reader_subprocess", run)
    parts = decompose_solid(as_mesh(trimesh.creation.box((1, 1, 1))), 0.02, 0.02)
    assert tried == ["auto", "off"]
    assert len(parts) == 1
