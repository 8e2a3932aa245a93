"""Commands `bake` and `simplify --bake`: image, metrics, and messages about bad input."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from scanloom.stages.surface.mesh_files import read_mesh

Run = Callable[..., Any]


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".glb", ".obj", ".ply"])
def test_simplify_bakes_into_each_format_with_images(
    scanloom: Run, clean_ball: Path, tmp_path: Path, suffix: str
) -> None:
    target = tmp_path / f"light{suffix}"
    ran = scanloom("simplify", clean_ball, target, "--ratio", 0.1, "--bake", "--json")
    assert ran.exit_code == 0, ran.stderr
    light = read_mesh(target)
    assert len(light.triangles) == ran.json["triangles"] <= 128
    assert light.texture is not None
    assert light.colors is None
    (image,) = light.texture.images
    assert ran.json["baked"]["images"] == [list(image.pixels.shape[:2])]
    # The baked image is closer to the original than vertex colours, also when measured from the file.
    metrics = scanloom("compare", clean_ball, target, "--set", "compare.samples=20000", "--json").json
    baked = ran.json["baked"]
    assert metrics["color"]["a_to_b"]["rmse_levels"] == pytest.approx(baked["color"]["rmse_levels"], rel=0.1)
    assert baked["color"]["rmse_levels"] < baked["vertex_color"]["rmse_levels"]


@pytest.mark.slow
def test_bake_takes_a_simplified_and_a_detailed_mesh(scanloom: Run, clean_ball: Path, tmp_path: Path) -> None:
    light, target = tmp_path / "light.ply", tmp_path / "new" / "light.glb"
    assert scanloom("simplify", clean_ball, light, "--ratio", 0.1).exit_code == 0
    ran = scanloom("mesh", "bake", light, clean_ball, target, "--set", "bake.max_size=64")
    assert ran.exit_code == 0, ran.stderr
    assert "dB) with the texture" in ran.stdout
    assert read_mesh(target).texture.images[0].pixels.shape == (64, 64, 3)


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        (("mesh", "bake", "{ball}", "{ball}", "out.stl"), 2, "unknown file extension"),
        (
            ("mesh", "bake", "{ball}", "{ball}", "out.glb", "--set", "bake.max_size=100"),
            2,
            "--set bake.max_size is 100 texels; it must be a",
        ),
        (("simplify", "{ball}", "out.off", "--bake"), 2, "unknown file extension"),
        (("mesh", "bake", "{ball}", "absent.ply", "out.glb"), 3, "there is no such file"),
    ],
)
def test_bad_input_is_reported_and_nothing_is_written(
    scanloom: Run,
    ball: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    words: tuple[str, ...],
    code: int,
    message: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    ran = scanloom(*(word.format(ball=ball) for word in words))
    assert ran.exit_code == code
    assert message in ran.stderr
    assert not list(tmp_path.glob("out.*"))
