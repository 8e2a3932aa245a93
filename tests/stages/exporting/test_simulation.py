"""Simulation models, opened by the libraries of the simulators."""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as Xml

import numpy as np
import pytest
import trimesh
from coloured_sheet import sheet, textured_sheet
from scipy.spatial.transform import Rotation

from scanloom import Image, Material, Mesh, Texture, UsageError, export_simulation
from scanloom.stages.exporting.simulation import decomposition
from scanloom.stages.exporting.simulation.convex_part import build_part
from scanloom.stages.exporting.simulation.decomposition import MAX_CORNERS
from scanloom.stages.exporting.simulation.export_simulation import SimulationResult

coacd = pytest.importorskip("coacd")
pytest.importorskip("pxr")

DENSITY = 700.0


def make_cup() -> Mesh:
    """Make a textured cup of 9 cm, y-up, with walls of 1 cm, eight sides and two materials."""
    profile = [(0, 0), (0.03, 0), (0.04, 0.09), (0.03, 0.09), (0.02, 0.01), (0, 0.01)]
    made = trimesh.creation.revolve(profile, sections=8).subdivide().subdivide()
    vertices = np.array(made.vertices)[:, [1, 2, 0]]
    triangles = np.array(made.faces, np.int32)
    uvs = vertices[triangles][:, :, [0, 1]] / 0.1 + 0.5
    pixels = np.random.default_rng(3).integers(0, 256, (48, 64, 3)).astype(np.uint8)
    materials = (Material("one", Image(given=pixels)), Material("two", base_color=(0.5, 0.25, 1.0, 1.0)))
    ids = (np.arange(len(uvs)) % 2).astype(np.int32)
    return Mesh(vertices, triangles, texture=Texture(uvs, ids, materials), up=(0.0, 1.0, 0.0))


@pytest.fixture(scope="module")
def cup(tmp_path_factory: pytest.TempPathFactory) -> tuple[Mesh, Path, SimulationResult]:
    """Write the cup, and move its folder to another place."""
    mesh = make_cup()
    folder = tmp_path_factory.mktemp("written") / "cup"
    result = export_simulation(mesh, folder, density=DENSITY, max_excess=0.006)
    moved = tmp_path_factory.mktemp("moved") / "copy of cup"
    shutil.move(folder, moved)
    return mesh, moved, result


def read_corners(folder: Path, files: list[str]) -> np.ndarray:
    lines = [line for file in files for line in (folder / file).read_text().splitlines()]
    return np.array([line.split()[1:4] for line in lines if line.startswith("v ")], float)


def list_files(folder: Path, kind: str) -> list[str]:
    return [f"meshes/{path.name}" for path in sorted((folder / "meshes").glob(f"model_{kind}*.obj"))]


def test_parts_contain_the_surface_within_the_limit(cup: tuple[Mesh, Path, SimulationResult]) -> None:
    mesh, folder, result = cup
    (body,) = result.bodies
    assert result.diagnostics == ()
    assert body.proof.gap_m == 0
    assert body.proof.attained_excess_m <= body.proof.excess_m <= 0.006
    assert max(len(part.vertices) for part in body.parts) <= MAX_CORNERS
    assert result.collision_bytes < result.visual_bytes
    # The hollow stays hollow, and the base and the wall are filled, in the files that simulators read.
    parts = [build_part(read_corners(folder, [file])) for file in list_files(folder, "collision")]
    points = np.array([[0, 0, 0.06], [0, 0, 0.005], [0, 0.031, 0.06]])
    assert np.any([part.contains(points) for part in parts], axis=0).tolist() == [False, True, True]
    report = json.loads((folder / "simulation.json").read_text())
    assert report["bodies"][0]["excess_bound_m"] == body.proof.excess_m
    assert report["density_kg_m3"] == DENSITY
    assert report["max_excess_m"] == 0.006
    assert max(report["part_excess_bound_m"]["model"]) == body.proof.excess_m
    assert len(report["part_excess_bound_m"]["model"]) == len(body.parts)
    assert len(mesh.triangles) == body.to_dict()["triangles"]


def test_mass_agrees_with_trimesh(cup: tuple[Mesh, Path, SimulationResult]) -> None:
    mesh, _, result = cup
    turned = mesh.vertices[:, [2, 0, 1]]
    made = trimesh.Trimesh(turned, mesh.triangles)
    made.density = DENSITY
    mass = result.bodies[0].mass
    assert mass.mass_kg == pytest.approx(made.mass)
    np.testing.assert_allclose(mass.center_m[2], made.center_mass[2])
    np.testing.assert_allclose(np.sort(np.linalg.eigvalsh(mass.inertia)), made.principal_inertia_components)


def test_usd_has_rigid_body_colliders_mass_and_texture(cup: tuple[Mesh, Path, SimulationResult]) -> None:
    from pxr import Gf, Usd, UsdGeom, UsdPhysics, UsdShade

    _, folder, result = cup
    stage = Usd.Stage.Open(str(folder / "model.usda"))
    assert UsdGeom.GetStageUpAxis(stage) == "Z"
    assert UsdGeom.GetStageMetersPerUnit(stage) == UsdPhysics.GetStageKilogramsPerUnit(stage) == 1
    body = stage.GetPrimAtPath("/scan/model")
    assert body.HasAPI(UsdPhysics.RigidBodyAPI)
    mass = UsdPhysics.MassAPI(body)
    expected = result.bodies[0].mass
    assert mass.GetMassAttr().Get() == pytest.approx(expected.mass_kg)
    axes = np.array(Gf.Matrix3d(Gf.Rotation(Gf.Quatd(mass.GetPrincipalAxesAttr().Get())))).T
    inertia = axes @ np.diag(mass.GetDiagonalInertiaAttr().Get()) @ axes.T
    np.testing.assert_allclose(inertia, expected.inertia, atol=1e-5 * np.abs(expected.inertia).max())
    colliders = [prim for prim in stage.Traverse() if prim.HasAPI(UsdPhysics.CollisionAPI)]
    assert len(colliders) == len(result.bodies[0].parts)
    assert all(
        UsdPhysics.MeshCollisionAPI(one).GetApproximationAttr().Get() == "convexHull" for one in colliders
    )
    assert UsdGeom.Imageable(colliders[0]).ComputePurpose() == "guide"
    images = [UsdShade.Shader(prim) for prim in stage.Traverse() if prim.GetName() == "image"]
    assert [bool(one.GetInput("file").Get().resolvedPath) for one in images] == [True]


@pytest.mark.parametrize("suffix", ["urdf", "sdf"])
def test_descriptions_name_existing_files(cup: tuple[Mesh, Path, SimulationResult], suffix: str) -> None:
    _, folder, result = cup
    root = Xml.parse(folder / f"model.{suffix}").getroot()
    kinds = {}
    for kind in ("visual", "collision"):
        meshes = [one.find(".//mesh") for one in root.iter(kind)]
        files = [one.get("filename") or one.find("uri").text for one in meshes]
        assert files == list_files(folder, kind)
        kinds[kind] = len(files)
    assert kinds == {"visual": 2, "collision": len(result.bodies[0].parts)}
    mass = root.find(".//mass")
    assert float(mass.get("value") or mass.text) == pytest.approx(result.bodies[0].mass.mass_kg)
    names = [child.tag for child in root.find(".//inertia")] or list(root.find(".//inertia").attrib)
    assert names == ["ixx", "ixy", "ixz", "iyy", "iyz", "izz"]
    assert Xml.parse(folder / "model.config").getroot().find("sdf").text == "model.sdf"


def load_with_table(mujoco: Any, folder: Path, height: float, turn: np.ndarray) -> Any:
    spec = mujoco.MjSpec.from_file(str(folder / "model.xml"))
    table = spec.worldbody.add_geom()
    table.type = mujoco.mjtGeom.mjGEOM_PLANE
    table.size = [1, 1, 0.1]
    spec.body("model").pos = [0, 0, height]
    spec.body("model").quat = turn
    return spec


def replace_parts_by_hull(mujoco: Any, spec: Any, points: np.ndarray) -> None:
    """Replace the collision parts by the convex hull of the full mesh."""
    for geom in list(spec.geoms):
        if "collision" in (geom.meshname or ""):
            spec.delete(geom)
    mesh = spec.add_mesh()
    mesh.name = "hull"
    mesh.uservert = points.ravel()
    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
    geom = spec.body("model").add_geom()
    geom.type = mujoco.mjtGeom.mjGEOM_MESH
    geom.meshname = "hull"


def settle(mujoco: Any, spec: Any, steps: int = 4000) -> tuple[np.ndarray, np.ndarray, float]:
    """Return the centre of mass and rotation at rest, and the depth of the first contact."""
    spec.option.timestep = 0.001
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    depth = -min([one.dist for one in data.contact[: data.ncon]], default=0.0)
    for _ in range(steps):
        mujoco.mj_step(model, data)
    assert np.abs(data.qvel).max() < 0.05
    body = model.body("model").id
    return data.xipos[body].copy(), data.xmat[body].reshape(3, 3).copy(), depth


def compare_rest(folder: Path, result: SimulationResult, tilt_deg: float) -> tuple[float, float, float]:
    """Drop the parts and the full hull; return distance, angle in degrees and depth of the first contact."""
    mujoco = pytest.importorskip("mujoco")
    points = read_corners(folder, list_files(folder, "visual"))
    # Half a side of the cup about its axis, so that a side and no edge comes first.
    turned = Rotation.from_euler("zx", [22.5, tilt_deg], degrees=True)
    turn = turned.as_quat(scalar_first=True)
    # The bound says that no part reaches lower than this below the mesh.
    height = result.bodies[0].proof.excess_m - turned.apply(points)[:, 2].min()
    center, rotation, depth = settle(mujoco, load_with_table(mujoco, folder, height, turn))
    spec = load_with_table(mujoco, folder, height, turn)
    replace_parts_by_hull(mujoco, spec, points)
    expected_center, expected_turn, _ = settle(mujoco, spec)
    cosine = (np.trace(rotation.T @ expected_turn) - 1) / 2
    angle = float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
    return float(np.linalg.norm(center - expected_center)), angle, depth


@pytest.mark.parametrize("tilt_deg", [0.0, 10.0, 80.0])
def test_a_cup_rests_where_its_mesh_does(cup: tuple[Mesh, Path, SimulationResult], tilt_deg: float) -> None:
    _, folder, result = cup
    distance, angle, depth = compare_rest(folder, result, tilt_deg)
    assert depth <= 0
    assert distance < 0.001
    assert angle < 1


def test_mujoco_reads_mjcf_and_urdf(cup: tuple[Mesh, Path, SimulationResult]) -> None:
    mujoco = pytest.importorskip("mujoco")
    mesh, folder, result = cup
    (body,) = result.bodies
    model = mujoco.MjModel.from_xml_path(str(folder / "model.xml"))
    assert model.ngeom == len(body.parts) + 2
    assert np.count_nonzero(model.geom_contype) == len(body.parts)
    assert model.ntex == 1
    assert model.nmat == 2
    assert (model.mesh_texcoordadr[model.geom_dataid[model.geom_contype == 0]] >= 0).all()
    index = model.body("model").id
    assert model.body_mass[index] == pytest.approx(body.mass.mass_kg)
    np.testing.assert_allclose(
        np.sort(model.body_inertia[index]), np.linalg.eigvalsh(body.mass.inertia), rtol=1e-6
    )
    robot = mujoco.MjModel.from_xml_path(str(folder / "model.urdf"))
    assert np.count_nonzero(robot.geom_contype) == len(body.parts)
    assert len(mesh.triangles) > 0


def test_an_open_mesh_becomes_a_static_body(tmp_path: Path) -> None:
    # A floor: one slab.
    mesh = textured_sheet(20)
    mesh = mesh.with_(vertices=mesh.vertices * (1, 1, 0), up=(0.0, 0.0, 1.0))
    result = export_simulation(mesh, tmp_path / "a", max_excess=0.1)
    (body,) = result.bodies
    assert body.is_static
    assert len(body.parts) == 1
    assert [one.code for one in result.diagnostics] == ["export.open-body"]
    assert body.proof.gap_m == 0
    assert 0 < body.proof.excess_m <= 0.1
    assert Xml.parse(tmp_path / "a" / "model.sdf").getroot().find(".//static").text == "true"
    if mujoco := sys.modules.get("mujoco"):
        assert mujoco.MjModel.from_xml_path(str(tmp_path / "a" / "model.xml")).nv == 0


def test_small_holes_are_closed_and_reported(tmp_path: Path) -> None:
    made = trimesh.creation.icosphere(subdivisions=3, radius=0.05)
    kept = made.triangles_center[:, 2] < 0.049
    mesh = Mesh(np.array(made.vertices), np.array(made.faces[kept], np.int32), up=(0.0, 0.0, 1.0))
    result = export_simulation(mesh, tmp_path / "a", max_excess=0.005)
    assert not result.bodies[0].is_static
    assert [one.code for one in result.diagnostics] == ["export.holes-closed"]
    assert result.bodies[0].mass.mass_kg == pytest.approx(1000 * made.volume, rel=0.01)
    assert 0 < result.bodies[0].cap_ratio < 0.02


def test_vertex_colours_are_reported_and_an_unknown_up_direction(tmp_path: Path) -> None:
    mesh = sheet()
    mesh = mesh.with_(vertices=mesh.vertices * (1, 1, 0))
    result = export_simulation(mesh, tmp_path / "a", max_excess=0.1)
    codes = {one.code for one in result.diagnostics}
    assert codes == {"export.left-out", "export.up-unknown", "export.open-body"}


def test_the_same_mesh_gives_the_same_bytes(
    cup: tuple[Mesh, Path, SimulationResult], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mesh, folder, _ = cup
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    export_simulation(mesh, tmp_path / folder.name, density=DENSITY, max_excess=0.006)
    for path in sorted(folder.rglob("*")):
        if path.is_file() and path.name not in ("simulation.json", "model.config"):
            assert (tmp_path / folder.name / path.relative_to(folder)).read_bytes() == path.read_bytes()


def test_an_unreached_limit_is_unmet(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # One hull for the cup, which fills its hollow.
    monkeypatch.setattr(decomposition, "_run_coacd", lambda mesh, concavity_m: [mesh.vertices])  # noqa: ARG005
    result = export_simulation(make_cup(), tmp_path / "a", max_excess=0.006)
    (found,) = result.diagnostics
    assert (found.code, found.severity) == ("export.collision-loose", "unmet")
    assert "in 1 of 1 parts" in found.message
    assert result.bodies[0].proof.gap_m == 0
    assert 0.02 < result.bodies[0].proof.attained_excess_m <= result.bodies[0].proof.excess_m < 0.04


def test_a_limit_that_needs_too_many_parts_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"max_excess.*0\.1 %"):
        export_simulation(make_cup(), tmp_path / "a", max_excess=1e-5)
    assert not (tmp_path / "a").exists()


@pytest.mark.parametrize("module", ["coacd", "pxr"])
def test_a_missing_library_is_one_message(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, module: str
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(UsageError, match=r"requires .*scanloom\[sim\]"):
        export_simulation(make_cup(), tmp_path / "a")
