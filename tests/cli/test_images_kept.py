"""Textures are never dropped silently: they are kept, baked again, or a warning names the option."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from seamed_meshes import count_edges, weld_corners, wrapped_ball

from scanloom.stages.exporting.export import export
from scanloom.stages.exporting.packing_detection import detect_packing
from scanloom.stages.surface.mesh import Image, Material, Mesh, Texture
from scanloom.stages.surface.mesh_files import read_mesh, write_mesh

Run = Callable[..., Any]

METHODS = {
    "quadric": ("--method", "quadric", "--ratio", 0.3),
    "certified": ("--max-shape", 0.05),
    "auto": ("--ratio", 0.3),
    "jia01": ("--method", "jia01"),
    "planar": ("--method", "planar", "--max-shape", 0.05),
}


@pytest.fixture
def textured(tmp_path: Path) -> Path:
    """Write a closed ball with an image that is red on its left half and blue on its right half."""
    mesh = wrapped_ball(16, 32, bumps=0.05)
    pixels = np.zeros((64, 64, 3), np.uint8)
    pixels[:, :32, 0] = pixels[:, 32:, 2] = 200
    assert mesh.texture is not None
    image = Material("halves", image=Image(given=pixels))
    material_ids = np.zeros(len(mesh.triangles), np.int32)
    path = tmp_path / "ball.glb"
    write_mesh(
        path, Mesh(mesh.vertices, mesh.triangles, texture=Texture(mesh.texture.uvs, material_ids, (image,)))
    )
    return path


@pytest.mark.parametrize("method", METHODS)
def test_every_method_gives_a_closed_mesh_with_an_image(
    scanloom: Run, textured: Path, tmp_path: Path, method: str
) -> None:
    target = tmp_path / "light.glb"
    ran = scanloom("simplify", textured, target, *METHODS[method], "--json")
    assert ran.exit_code == 0, ran.stderr
    assert not any("texture" in warning for warning in ran.warnings)
    light, mesh = read_mesh(target), read_mesh(textured)
    assert count_edges(weld_corners(light))[0] <= count_edges(weld_corners(mesh))[0]
    assert len(light.triangles) < len(mesh.triangles)
    assert light.texture is not None
    assert len(light.texture.images) == 1
    if "kept_images" in ran.json:
        assert method == "auto"
        assert ran.json["kept_images"]["rmse_levels"] < 0.35 * ran.json["kept_images"]["baked_rmse_levels"]
    else:
        assert ran.json["baked"]["image_bytes"] > 0
    color = scanloom("compare", textured, target, "--set", "compare.samples=20000", "--json").json["color"]
    assert color["a_to_b"]["rmse_levels"] < 40


@pytest.mark.parametrize("method", ["quadric", "jia01", "planar"])
def test_no_bake_warns_that_the_texture_is_discarded(
    scanloom: Run, textured: Path, tmp_path: Path, method: str
) -> None:
    target = tmp_path / "light.glb"
    ran = scanloom("simplify", textured, target, *METHODS[method], "--no-bake")
    assert ran.exit_code == 0
    assert "discards the texture; method seams preserves it, and bake creates a new image" in ran.stderr
    assert read_mesh(target).texture is None


@pytest.mark.parametrize("suffix", [".stl", ".off"])
def test_geometry_only_formats_warn_about_dropped_colours(
    scanloom: Run, textured: Path, tmp_path: Path, suffix: str
) -> None:
    ran = scanloom("simplify", textured, tmp_path / f"light{suffix}", "--ratio", 0.5, "--quiet")
    assert ran.exit_code == 0
    assert f"{suffix} stores geometry only: the colours are left out; write .ply or .glb" in ran.stderr


def test_a_normal_mesh_gets_a_baked_image(scanloom: Run, textured: Path, tmp_path: Path) -> None:
    target = tmp_path / "normal.glb"
    ran = scanloom("mesh", "remesh", textured, target, "--json")
    assert ran.exit_code == 0, ran.stderr
    light = read_mesh(target)
    assert light.texture is not None
    assert count_edges(weld_corners(light))[0] <= count_edges(weld_corners(read_mesh(textured)))[0]
    assert ran.json["baked"]["charts"] > 0
    ran = scanloom("mesh", "remesh", textured, target, "--no-bake")
    assert "remesh discards the texture" in ran.stderr


def test_dropped_transparency_is_reported(scanloom: Run, tmp_path: Path) -> None:
    lines = ["ply", "format ascii 1.0", "element vertex 3", *(f"property float {x}" for x in "xyz")]
    lines += [f"property uchar {name}" for name in ("red", "green", "blue", "alpha")]
    lines += ["element face 1", "property list uchar int vertex_indices", "end_header"]
    lines += ["0 0 0 9 9 9 128", "1 0 0 9 9 9 255", "0 1 0 9 9 9 255", "3 0 1 2", ""]
    path = tmp_path / "glass.ply"
    path.write_text("\n".join(lines))
    ran = scanloom("simplify", path, tmp_path / "light.ply", "--ratio", 1.0)
    assert f"warning: {path}: the transparency of vertices is left out" in ran.stderr


def test_keep_uv_keeps_the_image_bytes(scanloom: Run, textured: Path, tmp_path: Path) -> None:
    target = tmp_path / "light.glb"
    ran = scanloom("simplify", textured, target, "--ratio", 0.3, "--keep-uv", "--json")
    assert ran.exit_code == 0, ran.stderr
    assert ran.json["method"] == "seams"
    assert "baked" not in ran.json
    light, mesh = read_mesh(target), read_mesh(textured)
    assert light.texture is not None
    assert mesh.texture is not None
    assert light.texture.images[0].file_bytes == mesh.texture.images[0].file_bytes
    refused = scanloom("simplify", textured, tmp_path / "other.glb", "--ratio", 0.3, "--keep-uv", "--bake")
    assert refused.exit_code == 2


def test_without_a_goal_the_default_bound_is_reported(scanloom: Run, textured: Path, tmp_path: Path) -> None:
    ran = scanloom("simplify", textured, tmp_path / "light.glb")
    assert ran.exit_code == 0, ran.stderr
    assert "Neither a size nor a bound was given: the shape stays within" in ran.stdout
    assert "Colour error on the original:" in ran.stdout
    assert "Proven: no point is more than" in ran.stdout
    assert "colours differ by" not in ran.stdout


@pytest.mark.parametrize("suffix", [".glb", ".obj", ".ply"])
def test_formats_with_images_store_the_baked_image(
    scanloom: Run, textured: Path, tmp_path: Path, suffix: str
) -> None:
    target = tmp_path / f"light{suffix}"
    ran = scanloom("simplify", textured, target, "--ratio", 0.3, "--bake", "--json")
    assert ran.exit_code == 0, ran.stderr
    color = scanloom("compare", textured, target, "--set", "compare.samples=20000", "--json").json["color"]
    assert color["a_to_b"]["rmse_levels"] == pytest.approx(ran.json["baked"]["color"]["rmse_levels"], rel=0.3)


@pytest.mark.parametrize("compress", ["quantize", "meshopt"])
def test_a_compressed_file_stays_compressed_and_gets_no_larger(
    scanloom: Run, textured: Path, tmp_path: Path, compress: str
) -> None:
    source, target = tmp_path / "small.glb", tmp_path / "light.glb"
    export(read_mesh(textured), source, compress=compress, position_bits=14, texel_steps=2)
    mesh = read_mesh(source)
    packing = detect_packing(source, mesh)
    assert (packing.compress, packing.position_bits, packing.texel_steps) == (compress, 14, 4)
    ran = scanloom("simplify", source, target, "--ratio", 0.7, "--keep-uv", "--json")
    assert ran.exit_code == 0, ran.stderr
    assert detect_packing(target, read_mesh(target)).compress == compress
    assert ran.json["input_bytes"] == source.stat().st_size
    assert ran.json["output_bytes"] == target.stat().st_size < source.stat().st_size
    assert 0 < ran.json["position_error_m"] < 3e-4
    assert not any("larger" in warning for warning in ran.warnings)


def test_rounding_of_a_compressed_file_counts_in_the_bound(
    scanloom: Run, textured: Path, tmp_path: Path
) -> None:
    source, target = tmp_path / "small.glb", tmp_path / "light.glb"
    export(read_mesh(textured), source, compress="quantize", position_bits=10)
    ran = scanloom("simplify", source, target, "--max-shape", 0.02, "--json")
    assert ran.exit_code == 0, ran.stderr
    rounding = ran.json["position_error_m"]
    assert rounding > 1e-3
    assert ran.json["details"]["max_shape_m"] + rounding <= 0.02 + 1e-12
    # Rounding alone exceeds this bound, so the file is not compressed.
    ran = scanloom("simplify", source, target, "--max-shape", 0.001, "--json")
    assert "position_error_m" not in ran.json
    assert detect_packing(target, read_mesh(target)).compress == "none"


def test_a_file_that_grows_is_reported_with_its_bytes(scanloom: Run, textured: Path, tmp_path: Path) -> None:
    source, target = tmp_path / "small.off", tmp_path / "light.off"
    plain = read_mesh(textured)
    rounded = np.rint(plain.vertices * 100)
    lines = ["OFF", f"{len(rounded)} {len(plain.triangles)} 0"]
    lines += [" ".join(f"{value:.0f}" for value in row) for row in rounded]
    lines += [f"3 {a} {b} {c}" for a, b, c in plain.triangles]
    source.write_text("\n".join(lines))
    ran = scanloom("simplify", source, target, "--ratio", 0.9, "--json")
    assert ran.json["output_bytes"] == target.stat().st_size > source.stat().st_size
    assert any(
        f"larger than the input, {target.stat().st_size:,} bytes instead of {source.stat().st_size:,}" in text
        for text in ran.warnings
    )


def test_output_bytes_include_separate_images(scanloom: Run, textured: Path, tmp_path: Path) -> None:
    for suffix in (".gltf", ".obj", ".ply"):
        folder = tmp_path / suffix[1:]
        folder.mkdir()
        target = folder / f"light{suffix}"
        ran = scanloom("simplify", textured, target, "--ratio", 0.5, "--json")
        assert ran.exit_code == 0, ran.stderr
        files = [path for path in folder.iterdir() if path.suffix != ".mtl"]
        assert len(files) > 1
        assert ran.json["output_bytes"] == sum(path.stat().st_size for path in files)
