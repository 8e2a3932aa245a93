"""Meshes for other programs: rotated, scaled, compressed; each format is read back by another library."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from browsers import PAGE, run_node
from coloured_sheet import UP, ball, sheet, textured_sheet

from scanloom import Image, Material, export, preset, read_mesh
from scanloom.stages.diagnostics.diagnostic import Severity
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.exporting.export import (
    AXES,
    EXPORT_SUFFIXES,
    GLTF_SUFFIXES,
    ExportResult,
    require_supported_params,
)
from scanloom.stages.exporting.presets import PRESETS
from scanloom.stages.surface.formats.gltf_container import read_container
from scanloom.stages.surface.formats.gltf_packing import COMPRESSIONS

VALIDATE = Path(__file__).resolve().parents[2] / "made" / "validate_glb.cjs"


@pytest.mark.parametrize("suffix", [s for s in EXPORT_SUFFIXES if s[:4] not in (".usd", ".3mf")])
@pytest.mark.parametrize("made", [sheet, textured_sheet, ball])
def test_every_format_keeps_shape_and_position(tmp_path, suffix, made):
    mesh = made().with_(up=UP)
    written = export(mesh, tmp_path / f"a{suffix}")
    assert written.triangles == len(mesh.triangles)
    assert written.bytes == (tmp_path / f"a{suffix}").stat().st_size
    back = read_mesh(tmp_path / f"a{suffix}")
    np.testing.assert_allclose(np.sort(back.vertices, axis=0), np.sort(mesh.vertices, axis=0), atol=1e-6)
    is_bare = suffix in (".stl", ".off") and (mesh.colors is not None or mesh.texture is not None)
    assert any("geometry only" in str(one) for one in written.diagnostics) == is_bare


@pytest.mark.parametrize("axes", AXES)
@pytest.mark.parametrize("suffix", [".ply", ".obj", ".stl", ".off"])
def test_formats_without_up_axis_are_rotated_on_request(tmp_path, axes, suffix):
    mesh = sheet().with_(colors=None, up=UP, normals=np.tile((0.0, 0.0, 1.0), (144, 1)))
    export(mesh, tmp_path / f"a{suffix}", axes=axes)
    back = read_mesh(tmp_path / f"a{suffix}")
    height = {"scan": -back.vertices[:, 1], "y-up": back.vertices[:, 1], "z-up": back.vertices[:, 2]}[axes]
    np.testing.assert_allclose(np.sort(height), np.sort(-mesh.vertices[:, 1]), atol=1e-6)
    if suffix == ".ply":
        corners = back.vertices[back.triangles]
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        assert (np.einsum("ij,ij->i", across, back.normals[back.triangles[:, 0]]) > 0).all()


def test_an_unknown_up_direction_is_reported(tmp_path):
    written = export(sheet(), tmp_path / "a.obj", axes="y-up")
    assert any("up direction is unknown" in str(one) for one in written.diagnostics)
    given = export(sheet(), tmp_path / "a.obj", axes="y-up", up="+z")
    assert given.diagnostics == ()
    back = read_mesh(tmp_path / "a.obj")
    np.testing.assert_allclose(np.sort(back.vertices[:, 1]), np.sort(sheet().vertices[:, 2]), atol=1e-6)


def list_unmet(written: ExportResult) -> list[str]:
    return [str(one) for one in written.diagnostics if one.severity is Severity.UNMET]


def test_the_print_preset_puts_the_mesh_on_the_plate_in_millimetres(tmp_path):
    written = export(ball(), tmp_path / "a.stl", preset("print", ".stl"))
    assert list_unmet(written) == []
    low, high = (f(read_mesh(tmp_path / "a.stl").vertices, axis=0) for f in (np.min, np.max))
    np.testing.assert_allclose(low, (-50, -50, 0), atol=1e-3)
    np.testing.assert_allclose(high, (50, 50, 100), atol=1e-3)
    open_one = export(sheet(), tmp_path / "b.stl", preset("print", ".stl"))
    assert any("edges with only one triangle" in text for text in list_unmet(open_one))
    turned_in = ball().with_(triangles=np.ascontiguousarray(ball().triangles[:, ::-1]))
    turned = export(turned_in, tmp_path / "c.stl", preset("print", ".stl"))
    assert any("inwards" in text for text in list_unmet(turned))


@pytest.mark.parametrize("kind", ["jpeg", "webp", "png"])
@pytest.mark.parametrize("given", ["jpeg", "webp", "png"])
def test_images_are_encoded_again_only_if_necessary(tmp_path, kind, given):
    mesh = textured_sheet(kind=given)
    export(mesh, tmp_path / "a.glb", images=kind)
    (image,) = read_mesh(tmp_path / "a.glb").texture.images
    assert image.mime == f"image/{kind}"
    assert len(read_container(tmp_path / "a.glb").tree["images"]) == 1
    # The replaced source image must not remain next to the new image.
    export(read_mesh(tmp_path / "a.glb"), tmp_path / "c.glb", images="webp", image_size=40)
    assert len(read_container(tmp_path / "c.glb").tree["images"]) == 1
    if kind == given:
        assert image.file_bytes == mesh.texture.images[0].file_bytes
    assert image.pixels.shape == (48, 64, 3)
    export(mesh, tmp_path / "b.glb", images=kind, image_size=32)
    assert read_mesh(tmp_path / "b.glb").texture.images[0].pixels.shape == (24, 32, 3)
    assert len(read_mesh(tmp_path / "b.glb").texture.materials) == 2


def test_transparency_is_not_lost_to_jpeg(tmp_path):
    mesh = textured_sheet()
    pixels = np.dstack([mesh.texture.images[0].pixels, np.full((48, 64), 9, np.uint8)])
    clear = replace(mesh.texture, materials=(Material("one", Image("clear.png", given=pixels)),) * 2)
    written = export(mesh.with_(texture=clear), tmp_path / "a.glb", images="jpeg")
    assert any("transparent" in str(one) for one in written.diagnostics)
    np.testing.assert_array_equal(read_mesh(tmp_path / "a.glb").texture.images[0].pixels, pixels)


@pytest.mark.slow
def test_gltf_files_pass_the_validator(tmp_path):
    folder = tmp_path / "files"
    folder.mkdir()
    for name, made in (("colours", sheet), ("image", textured_sheet), ("ball", ball)):
        for way in COMPRESSIONS:
            for shading in ("bare", "keep", "unlit", "lit"):
                for up in (UP, (0.6, 0.0, 0.8)):
                    path = folder / f"{name}-{way}-{shading}-{up[1]}.glb"
                    export(made().with_(up=up), path, compress=way, shading=shading)
    export(textured_sheet(), folder / "web.glb", preset("web"))
    said = run_node(VALIDATE, PAGE, folder)
    assert len(said) == 73
    worse = {name: [m for m in found if m["severity"] < 2] for name, found in said.items()}
    assert not any(worse.values()), worse


def test_a_file_for_the_web_is_small(tmp_path):
    plain = export(textured_sheet(120, "jpeg"), tmp_path / "a.glb").bytes
    written = export(textured_sheet(120, "jpeg"), tmp_path / "b.glb", preset("web"))
    assert written.bytes < 0.2 * plain
    assert written.position_error == pytest.approx(0.5 * 3**0.5 * 2.0**-13)


@pytest.mark.parametrize("suffix", EXPORT_SUFFIXES)
def test_web_images_are_webp_in_gltf_and_jpeg_elsewhere(suffix):
    assert preset("web", suffix).images == ("webp" if suffix in GLTF_SUFFIXES else "jpeg")


def test_the_blender_preset_rotates_only_obj_files(tmp_path):
    for suffix, height in ((".obj", 1), (".ply", 2), (".stl", 2)):
        export(sheet().with_(up=UP), tmp_path / f"a{suffix}", preset("blender", suffix))
        back = read_mesh(tmp_path / f"a{suffix}")
        np.testing.assert_allclose(
            np.sort(back.vertices[:, height]), np.sort(-sheet().vertices[:, 1]), atol=1e-6
        )


@pytest.mark.parametrize(
    ("name", "changes", "message"),
    [
        ("a.fbx", {}, "extension .fbx is unknown"),
        ("a", {}, "is unknown"),
        ("a.obj", {"compress": "meshopt"}, "only to glTF"),
        ("a.ply", {"shading": "unlit"}, "only to glTF"),
        ("a.glb", {"unit": "mm"}, "in metres"),
        ("a.usdz", {"on_floor": True}, "in metres"),
        ("a.glb", {"up": "sideways"}, "up is"),
        ("a.glb", {"compress": "draco"}, "compress"),
        ("a.glb", {"quality": 0}, "quality"),
    ],
)
def test_unsupported_options_are_refused_before_writing(tmp_path, name, changes, message):
    with pytest.raises(UsageError, match=message):
        export(sheet(), tmp_path / name, **changes)
    assert list(tmp_path.iterdir()) == []


def test_presets_are_valid_for_every_format():
    for name in PRESETS:
        for suffix in EXPORT_SUFFIXES:
            require_supported_params(Path(f"a{suffix}"), preset(name, suffix))
    with pytest.raises(UsageError, match="the presets are web, unity, blender, print"):
        preset("paper")
