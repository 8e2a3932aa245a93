"""The optional stages `lod` and `tiles`: what they leave and tell; without them nothing of it stays."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from coloured_meshes import sheet
from tile_reader import read_tiles

from scanloom.pipeline.config import Config
from scanloom.pipeline.graph import STAGES, list_skip_reasons, plan_stages
from scanloom.pipeline.run.run import CACHE_VARIABLE, run
from scanloom.pipeline.steps.lod import LodSection, write_levels
from scanloom.stages import lod
from scanloom.stages.diagnostics.collector import collecting
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.progress import ignore_progress
from scanloom.stages.scans.layouts.scan_json import write_scan_json
from scanloom.stages.scans.model.scan import Camera, Frame, Scan
from scanloom.stages.surface.formats.ply import read_ply

QUICK = (
    "texture.enabled=false",
    "fuse.voxel_size=0.03",
    "report.viewpoints=1",
    "report.page=false",
    "report.width=64",
    "compare.samples=1000",
    "lod.cell_triangles=500",
    "lod.root_triangles=100",
)
CAMERA = Camera(96, 72, 80.0, 80.0, 47.5, 35.5)
PLAIN = [
    "clean.ply",
    "fused.ply",
    "pictures",
    "refined.ply",
    "report.json",
    "simplified.glb",
    "simplified.ply",
]
OWN = ["lod.slod", "tiles"]
NOISE = 0.004


@pytest.fixture(autouse=True)
def _no_shared_cache(monkeypatch):
    monkeypatch.delenv(CACHE_VARIABLE, raising=False)


@pytest.fixture
def scan(tmp_path: Path) -> Path:
    """Four noisy frames of a wavy wall about a metre away, from a camera that is tilted by 30°."""
    folder = tmp_path / "scan"
    folder.mkdir()
    random = np.random.default_rng(1)
    v, u = np.mgrid[0:72, 0:96]
    frames = []
    for i in range(4):
        pose = np.eye(4)
        pose[:3, :3] = tilt()
        pose[:3, 3] = pose[:3, :3] @ (0.03 * i, 0, 0)
        depth = (
            1
            + 0.02 * np.sin((u - 47.5) / 12 + 0.2 * i) * np.cos(v / 15)
            + NOISE * random.normal(size=u.shape)
        )
        color = np.stack([2 * u, 3 * v, 0 * u + 90], axis=2).astype(np.uint8)
        files = {kind: folder / f"{kind}-{i}.png" for kind in ("color", "depth")}
        cv2.imwrite(str(files["color"]), color)
        cv2.imwrite(str(files["depth"]), np.rint(10000 * depth).astype(np.uint16))
        frames.append(
            Frame(
                str(i),
                CAMERA,
                files["color"],
                depth=files["depth"],
                world_from_camera=pose,
                depth_scale=10000,
            )
        )
    write_scan_json(folder, frames)
    return folder


def tilt() -> np.ndarray:
    c, s = np.cos(np.pi / 6), np.sin(np.pi / 6)
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])


def quick(*assignments: str) -> Config:
    return Config().set([*QUICK, "adjust.enabled=false", *assignments])


def names(out: Path) -> list[str]:
    return sorted(path.name for path in out.iterdir() if path.name != "cache")


def ran(result) -> list[str]:
    return [outcome.stage for outcome in result.stages if not outcome.cached]


def metrics_of(result, stage: str = "lod") -> dict:
    return result.report["stages"][stage]["metrics"]


def test_it_is_there_if_it_is_enabled_and_reads_the_clean_mesh():
    plain = Scan(frames=(), folder=None, layout="none")
    assert "lod.enabled=true" in list_skip_reasons(plain, Config())["lod"]
    assert "lod.enabled=true" in list_skip_reasons(plain, Config())["tiles"]
    assert not {"lod", "tiles"} & {stage.name for stage in plan_stages(plain, Config())}
    stages = {stage.name: stage for stage in plan_stages(plain, Config().set(["lod.enabled=true"]))}
    assert stages["lod"].input_names == ("frames", "poses", "refined_mesh", "simplified_mesh", "up_direction")
    assert stages["tiles"].input_names == ("up_direction", "levels")
    assert [stage.name for stage in STAGES][-4:] == ["tiles", "export", "coverage", "report"]
    without = Config().set(["lod.enabled=true", "tiles.enabled=false"])
    assert "tiles.enabled=true" in list_skip_reasons(plain, without)["tiles"]


@pytest.mark.slow
def test_an_enabled_stage_leaves_the_levels_and_their_tiles(scan, tmp_path):
    out = tmp_path / "out"
    result = run(scan, out, quick("lod.enabled=true"))
    assert ran(result) == [
        "fuse",
        "clean",
        "refine",
        "upright",
        "simplify",
        "lod",
        "tiles",
        "export",
        "report",
    ]
    assert names(out) == sorted([*PLAIN, *OWN])

    hierarchy = lod.read_slod(out / "lod.slod")
    stages = json.loads((out / "report.json").read_text())["stages"]
    told = stages["lod"]["metrics"]
    assert told["input_triangles"] == len(read_ply(out / "refined.ply").triangles)
    assert told["base_triangles"] < told["input_triangles"]
    assert (told["base_error_source"], told["base_error_m"]) == ("noise", 0.5 * told["depth_noise_m"])
    assert told["depth_noise_m"] == pytest.approx(NOISE, rel=0.2)
    assert 0 < told["base_shape_bound_m"] <= told["base_error_m"]
    assert [level["shape_bound_m"] for level in told["levels"]] == sorted(
        (float(hierarchy.shape_bound[hierarchy.level == level].max()) for level in set(hierarchy.level)),
        reverse=True,
    )
    assert told["file_bytes"] == (out / "lod.slod").stat().st_size
    tiles = list((out / "tiles").rglob("*.glb"))
    assert stages["tiles"]["metrics"]["tiles"] == len(tiles)
    assert stages["tiles"]["metrics"]["total_bytes"] == sum(path.stat().st_size for path in tiles)
    assert ran(run(scan, out, quick("lod.enabled=true"))) == []


@pytest.mark.slow
def test_tiles_stand_upright_as_the_camera_was_held_where_there_is_no_floor(scan, tmp_path):
    out = tmp_path / "out"
    told = metrics_of(run(scan, out, quick("lod.enabled=true")), "upright")
    assert told["up_source"] == "cameras"
    np.testing.assert_allclose(told["up"], -tilt()[:, 1], atol=1e-5)
    np.testing.assert_allclose(
        lod.read_slod(out / "lod.slod").cut(triangles=100).mesh.up, told["up"], atol=1e-12
    )
    transform = np.array(read_tree(out)["root"]["transform"]).reshape(4, 4).T
    np.testing.assert_allclose(transform[:3, :3] @ -tilt()[:, 1], (0, 0, 1), atol=1e-5)
    assert np.linalg.det(transform[:3, :3]) == pytest.approx(1)
    up = read_tiles(out / "tiles").vertices.astype(float) @ transform[:3, :3].T
    # The wall's height is what the frames' rows show of it.
    assert np.ptp(up[:, 2]) == pytest.approx(72 / 80, rel=0.1)

    turned = run(scan, out, quick("lod.enabled=true", "upright.up=as-is"))
    assert ran(turned) == ["upright", "lod", "tiles", "export"]
    assert lod.read_slod(out / "lod.slod").up is None
    assert "transform" not in read_tree(out)["root"]


@pytest.mark.slow
def test_tiles_show_what_the_photos_do_and_follow_the_texture_alone(scan, tmp_path):
    out = tmp_path / "out"
    textured = ("lod.enabled=true", "texture.enabled=true")
    result = run(scan, out, quick(*textured))
    told = metrics_of(result, "tiles")
    assert told["images"]["root_bytes"] > 0
    assert all(
        tile["content"]["extras"]["color_rms_levels_sampled"] < 12 for tile in all_of(read_tree(out)["root"])
    )
    # What the texture depends on does not build the levels again.
    again = run(scan, out, quick(*textured, "simplify.ratio=0.3"))
    assert ran(again) == ["simplify", "texture", "tiles", "report"]
    plain = run(scan, out, quick(*textured, "simplify.ratio=0.3", "tiles.images=false"))
    assert ran(plain) == ["tiles"]
    assert metrics_of(plain, "tiles")["images"] is None
    paged = run(scan, out, quick(*textured, "simplify.ratio=0.3", "tiles.images=false", "tiles.page=true"))
    assert ran(paged) == ["tiles"]
    assert (out / "tiles" / "index.html").exists()


def all_of(tile: dict) -> list[dict]:
    return [tile, *(one for child in tile.get("children", ()) for one in all_of(child))]


def read_tree(out: Path) -> dict:
    return json.loads((out / "tiles" / "tileset.json").read_text())


@pytest.mark.slow
def test_skip_reasons_again_it_leaves_nothing_behind_and_the_others_alone(scan, tmp_path):
    out = tmp_path / "out"
    run(scan, out, quick())
    assert names(out) == PLAIN
    # No other stage reads what it makes.
    assert ran(run(scan, out, quick("lod.enabled=true"))) == ["lod", "tiles"]
    assert ran(run(scan, out, quick())) == []
    assert names(out) == PLAIN
    assert ran(run(scan, out, quick("lod.enabled=true", "tiles.enabled=false"))) == []
    assert names(out) == sorted([*PLAIN, "lod.slod"])
    assert ran(run(scan, out, quick("lod.enabled=true"))) == []
    assert names(out) == sorted([*PLAIN, *OWN])


@pytest.mark.slow
def test_its_parameters_and_the_clean_mesh_decide_its_result_but_threads_do_not(scan, tmp_path):
    out = tmp_path / "out"
    run(scan, out, quick("lod.enabled=true"), until="lod")
    other = run(scan, out, quick("lod.enabled=true", "lod.ratio=4"), until="lod")
    assert ran(other) == ["lod"]
    assert "ratio 2.5 → 4" in other.stages[-1].reason
    exact = run(scan, out, quick("lod.enabled=true", "lod.base_error=0"), until="lod")
    assert ran(exact) == ["lod"]
    assert metrics_of(exact)["base_triangles"] == metrics_of(exact)["input_triangles"]
    assert metrics_of(exact)["depth_noise_m"] is None
    assert ran(run(scan, out, quick("lod.enabled=true", "lod.threads=1"), until="lod")) == []
    # The simplified mesh does not.
    lighter = run(scan, out, quick("lod.enabled=true", "simplify.ratio=0.3"), until="lod")
    assert ran(lighter) == ["simplify"]
    filled = run(scan, out, quick("lod.enabled=true", "clean.fill_holes=10"), until="lod")
    assert "clean" in ran(filled)


def test_frames_that_tell_no_noise_give_the_clean_mesh_itself_and_a_warning(tmp_path):
    mesh = sheet(20)
    pose = np.eye(4)
    wall = np.ones((72, 96), np.float32)
    frame = Frame("0", CAMERA, None, depth=wall, world_from_camera=pose)
    params = LodSection(cell_triangles=200, root_triangles=50)
    with collecting() as diagnostics:
        metrics = write_levels(tmp_path, mesh, [frame], params, ignore_progress)
    assert metrics["base_triangles"] == len(mesh.triangles)
    assert (metrics["base_error_m"], metrics["base_error_source"]) == (0, "noise")
    assert [one.code for one in diagnostics] == ["levels.noise-unknown"]


@pytest.mark.parametrize(
    "word", ["lod.ratio=1", "lod.base_error=-1", "upright.up=sideways", "upright.up=0 0 0"]
)
def test_bad_values_are_refused_before_anything_runs(word):
    with pytest.raises(UsageError, match=word.partition("=")[0]):
        Config().set([word])


def test_threads_and_whether_it_is_there_are_no_part_of_its_key():
    plain = Config().to_canonical("lod")
    assert not {"enabled", "threads"} & set(plain)
    assert replace(Config(), lod=LodSection(enabled=True, threads=1)).to_canonical("lod") == plain
