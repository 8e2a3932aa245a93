"""USD files, read by USD's reference library."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import pytest
from coloured_sheet import UP, ball, sheet, textured_sheet

from scanloom import export
from scanloom.stages.surface.formats.color_conversion import convert_srgb_to_linear

pxr = pytest.importorskip("pxr")

from pxr import Usd, UsdGeom, UsdShade  # noqa: E402


def open_stage(path: Path):
    stage = Usd.Stage.Open(str(path))
    return stage, UsdGeom.Mesh(stage.GetPrimAtPath("/scan/mesh"))


@pytest.mark.parametrize("suffix", [".usda", ".usdz"])
@pytest.mark.parametrize("made", [sheet, textured_sheet, ball])
def test_usd_is_metric_upright_and_coloured(tmp_path, suffix, made):
    mesh = made().with_(up=UP)
    export(mesh, tmp_path / f"a{suffix}")
    stage, shape = open_stage(tmp_path / f"a{suffix}")
    assert UsdGeom.GetStageUpAxis(stage) == "Y"
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1
    assert stage.GetDefaultPrim().GetName() == "scan"
    turn = np.array(UsdGeom.XformCache().GetLocalToWorldTransform(shape.GetPrim()))
    points = np.array(shape.GetPointsAttr().Get())
    np.testing.assert_allclose(points, mesh.vertices, atol=1e-6)
    placed = np.column_stack([points, np.ones(len(points))]) @ turn
    np.testing.assert_allclose(placed[:, 1], -mesh.vertices[:, 1], atol=1e-6)
    np.testing.assert_array_equal(
        np.array(shape.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3), mesh.triangles
    )
    primvars = UsdGeom.PrimvarsAPI(shape)
    if mesh.colors is not None:
        light = np.array(primvars.GetPrimvar("displayColor").Get())
        np.testing.assert_allclose(light, convert_srgb_to_linear(mesh.colors / 255), atol=1e-6)
        assert UsdShade.MaterialBindingAPI(shape).ComputeBoundMaterial()[0]
    if mesh.texture is not None:
        uvs = np.array(primvars.GetPrimvar("st").Get()).reshape(-1, 3, 2)
        np.testing.assert_allclose(uvs, mesh.texture.uvs, atol=1e-6)
        parts = UsdShade.MaterialBindingAPI(shape).GetMaterialBindSubsets()
        rows = [np.array(part.GetIndicesAttr().Get()) for part in parts]
        for number, found in enumerate(rows):
            np.testing.assert_array_equal(found, np.flatnonzero(mesh.texture.material_ids == number))
        images = [
            UsdShade.Shader(prim).GetInput("file").Get().resolvedPath
            for prim in stage.Traverse()
            if prim.GetName() == "image"
        ]
        assert len(images) == 2
        assert all(images)
        if suffix == ".usdz":
            with zipfile.ZipFile(tmp_path / "a.usdz") as packed:
                (name,) = [name for name in packed.namelist() if name.endswith(".png")]
                assert packed.read(name) == mesh.texture.images[0].file_bytes


def test_an_unsupported_image_becomes_png(tmp_path):
    written = export(textured_sheet(kind="webp"), tmp_path / "a.usdz")
    assert any("PNG" in str(one) for one in written.diagnostics)
    with zipfile.ZipFile(tmp_path / "a.usdz") as packed:
        assert any(name.endswith(".png") for name in packed.namelist())
