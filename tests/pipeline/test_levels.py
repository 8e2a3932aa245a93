"""The optional stages `lod` and `tiles`: results, metrics, and removal of results when they are disabled."""

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
    """Write four noisy frames of a wavy wall about 1 m away, from a camera that is tilted by 30°."""
    folder = tmp_path / "scan"
    folder.mkdir()
    random = np.random.default_rng(1)
    v, u = np.mgrid[0:72, 0:96]
    frames = []
    for i in range(4):
        pose = np.eye(4)
        pose[:3, :3] = make_tilt()
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


def make_tilt() -> np.ndarray:
    c, s = np.cos(np.pi / 6), np.sin(np.pi / 6)
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])


def make_quick_config(*assignments: str) -> Config:
    return Config().set([*QUICK, "adjust.enabled=false", *assignments])


def list_names(out: Path) -> list[str]:
    return sorted(path.name for path in out.iterdir() if path.name != "cache")


def list_computed(result) -> list[str]:
    return [outcome.stage for outcome in result.stages if not outcome.cached]


def get_metrics(result, stage: str = "lod") -> dict:
    return result.report["stages"][stage]["metrics"]


def test_lod_is_planned_only_if_enabled_and_reads_the_clean_mesh():
    frame = Frame("0", Camera(4, 3, 4.0, 4.0, 1.5, 1.0), depth=np.ones((3, 4), np.float32))
    plain = Scan(frames=(frame,), folder=None, layout="none")
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
def test_an_enabled_lod_stage_writes_levels_and_tiles(scan, tmp_path):
    out = tmp_path / "out"
    result = run(scan, out, make_quick_config("lod.enabled=true"))
    assert list_computed(result) == [
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
    assert list_names(out) == sorted([*PLAIN, *OWN])

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
    assert list_computed(run(scan, out, make_quick_config("lod.enabled=true"))) == []


@pytest.mark.slow
def test_without_a_floor_tiles_are_upright_by_the_camera(scan, tmp_path):
    out = tmp_path / "out"
    told = get_metrics(run(scan, out, make_quick_config("lod.enabled=true")), "upright")
    assert told["up_source"] == "cameras"
    np.testing.assert_allclose(told["up"], -make_tilt()[:, 1], atol=1e-5)
    np.testing.assert_allclose(
        lod.read_slod(out / "lod.slod").cut(triangles=100).mesh.up, told["up"], atol=1e-12
    )
    transform = np.array(read_tree(out)["root"]["transform"]).reshape(4, 4).T
    np.testing.assert_allclose(transform[:3, :3] @ -make_tilt()[:, 1], (0, 0, 1), atol=1e-5)
    assert np.linalg.det(transform[:3, :3]) == pytest.approx(1)
    up = read_tiles(out / "tiles").vertices.astype(float) @ transform[:3, :3].T
    # The height of the wall is the height of the frames.
    assert np.ptp(up[:, 2]) == pytest.approx(72 / 80, rel=0.1)

    turned = run(scan, out, make_quick_config("lod.enabled=true", "upright.up=as-is"))
    assert list_computed(turned) == ["upright", "lod", "tiles", "export"]
    assert lod.read_slod(out / "lod.slod").up is None
    assert "transform" not in read_tree(out)["root"]


@pytest.mark.slow
def test_tiles_show_photos_and_depend_only_on_the_texture(scan, tmp_path):
    out = tmp_path / "out"
    textured = ("lod.enabled=true", "texture.enabled=true")
    result = run(scan, out, make_quick_config(*textured))
    told = get_metrics(result, "tiles")
    assert told["images"]["root_bytes"] > 0
    assert all(
        tile["content"]["extras"]["color_rms_levels_sampled"] < 12
        for tile in list_tiles(read_tree(out)["root"])
    )
    # The stages that the texture depends on do not trigger building levels.
    again = run(scan, out, make_quick_config(*textured, "simplify.ratio=0.3"))
    assert list_computed(again) == ["simplify", "texture", "tiles", "report"]
    plain = run(scan, out, make_quick_config(*textured, "simplify.ratio=0.3", "tiles.images=false"))
    assert list_computed(plain) == ["tiles"]
    assert get_metrics(plain, "tiles")["images"] is None
    paged = run(
        scan, out, make_quick_config(*textured, "simplify.ratio=0.3", "tiles.images=false", "tiles.page=true")
    )
    assert list_computed(paged) == ["tiles"]
    assert (out / "tiles" / "index.html").exists()


def list_tiles(tile: dict) -> list[dict]:
    return [tile, *(one for child in tile.get("children", ()) for one in list_tiles(child))]


def read_tree(out: Path) -> dict:
    return json.loads((out / "tiles" / "tileset.json").read_text())


@pytest.mark.slow
def test_disabling_lod_removes_its_results_and_keeps_all_others(scan, tmp_path):
    out = tmp_path / "out"
    run(scan, out, make_quick_config())
    assert list_names(out) == PLAIN
    # No other stage reads the results of lod.
    assert list_computed(run(scan, out, make_quick_config("lod.enabled=true"))) == ["lod", "tiles"]
    assert list_computed(run(scan, out, make_quick_config())) == []
    assert list_names(out) == PLAIN
    assert list_computed(run(scan, out, make_quick_config("lod.enabled=true", "tiles.enabled=false"))) == []
    assert list_names(out) == sorted([*PLAIN, "lod.slod"])
    assert list_computed(run(scan, out, make_quick_config("lod.enabled=true"))) == []
    assert list_names(out) == sorted([*PLAIN, *OWN])


@pytest.mark.slow
def test_the_key_of_lod_depends_on_parameters_and_clean_mesh_but_not_threads(scan, tmp_path):
    out = tmp_path / "out"
    run(scan, out, make_quick_config("lod.enabled=true"), until="lod")
    other = run(scan, out, make_quick_config("lod.enabled=true", "lod.ratio=4"), until="lod")
    assert list_computed(other) == ["lod"]
    assert "ratio 2.5 → 4" in other.stages[-1].reason
    exact = run(scan, out, make_quick_config("lod.enabled=true", "lod.base_error=0"), until="lod")
    assert list_computed(exact) == ["lod"]
    assert get_metrics(exact)["base_triangles"] == get_metrics(exact)["input_triangles"]
    assert get_metrics(exact)["depth_noise_m"] is None
    assert (
        list_computed(run(scan, out, make_quick_config("lod.enabled=true", "lod.threads=1"), until="lod"))
        == []
    )
    # The simplified mesh is not an input of lod.
    lighter = run(scan, out, make_quick_config("lod.enabled=true", "simplify.ratio=0.3"), until="lod")
    assert list_computed(lighter) == ["simplify"]
    filled = run(scan, out, make_quick_config("lod.enabled=true", "clean.fill_holes=10"), until="lod")
    assert "clean" in list_computed(filled)


def test_without_a_noise_estimate_the_finest_level_is_the_clean_mesh(tmp_path):
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
def test_invalid_values_are_refused_before_the_run(word):
    with pytest.raises(UsageError, match=word.partition("=")[0]):
        Config().set([word])


def test_the_key_of_lod_excludes_threads_and_enabled():
    plain = Config().to_canonical("lod")
    assert not {"enabled", "threads"} & set(plain)
    assert replace(Config(), lod=LodSection(enabled=True, threads=1)).to_canonical("lod") == plain
