"""The stage `texture`: photos of a second camera instead of the frames' images, and cache hits."""

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from wall_photos import CAMERA, paint, photos, wall

from scanloom import InputError, export
from scanloom.pipeline.cache.store import Cache
from scanloom.pipeline.config import Config
from scanloom.pipeline.graph import find_stage
from scanloom.pipeline.run.dry_run import predict_run
from scanloom.pipeline.run.run import RunResult, prepare_run, run
from scanloom.pipeline.steps.texture import TextureSection, write_textured
from scanloom.stages.progress import ignore_progress
from scanloom.stages.scans.layouts.scan_json import write_scan_json
from scanloom.stages.scans.model.scan import Frame
from scanloom.stages.surface.formats.gltf_materials import is_unlit
from scanloom.stages.surface.mesh_files import read_mesh
from scanloom.stages.surface.surface_color import compute_surface_colors
from scanloom.stages.texturing.shading_normals import has_normal_map

pytestmark = pytest.mark.slow


def write_grey_scan(folder: Path) -> Path:
    """Write a scan of the painted wall with grey images."""
    frames = []
    for frame in photos(8):
        color, depth = folder / "color" / f"{frame.name}.png", folder / "depth" / f"{frame.name}.png"
        for path, image in (
            (color, np.full((CAMERA.height, CAMERA.width, 3), 128, np.uint8)),
            (depth, np.rint(np.asarray(frame.depth) * 1000).astype(np.uint16)),
        ):
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(cv2.imencode(".png", image)[1].tobytes())
        frames.append(
            Frame(frame.name, CAMERA, color=color, depth=depth, world_from_camera=frame.world_from_camera)
        )
    write_scan_json(folder, frames)
    return folder


def write_other_photos(folder: Path) -> Path:
    """Write photos of the wall in nerfstudio's convention: y up, camera facing −z."""
    folder.mkdir()
    listed = []
    for frame in photos(12):
        image = np.asarray(frame.color)[:, :, ::-1]
        (folder / f"{frame.name}.png").write_bytes(cv2.imencode(".png", image)[1].tobytes())
        pose = np.asarray(frame.world_from_camera) @ np.diag([1, -1, -1, 1])
        listed.append({"file_path": f"{frame.name}.png", "transform_matrix": pose.tolist()})
    camera = {
        "w": CAMERA.width,
        "h": CAMERA.height,
        "fl_x": CAMERA.fx,
        "fl_y": CAMERA.fy,
        "cx": CAMERA.cx + 0.5,
        "cy": CAMERA.cy + 0.5,
        "frames": listed,
    }
    (folder / "transforms.json").write_text(json.dumps(camera))
    return folder


def config(images: Path) -> Config:
    return Config().set([f"texture.images={images}", "adjust.enabled=false", "fuse.voxel_size=0.02"])


def list_computed(result: RunResult) -> set[str]:
    return {one.stage for one in result.stages if not one.cached}


def test_photos_of_another_camera_are_used(tmp_path: Path):
    scan, images, out = (
        write_grey_scan(tmp_path / "scan"),
        write_other_photos(tmp_path / "photos"),
        tmp_path / "out",
    )
    result = run(scan, out, config(images), until="texture")
    mesh = read_mesh(out / "textured.glb")
    rng = np.random.default_rng(1)
    chosen, weights = rng.choice(len(mesh.triangles), 2000), rng.dirichlet((1, 1, 1), 2000)
    places = np.einsum("kc,kcx->kx", weights, mesh.vertices[mesh.triangles[chosen]])
    middle = (np.abs(places[:, :2] - 0.5) < 0.25).all(axis=1)
    off = np.abs(compute_surface_colors(mesh, chosen, weights) - paint(places[:, 0], places[:, 1]))[middle]
    assert np.median(off) < 5

    # The key of texture depends on the content of the folder but not on its path.
    moved = Path(shutil.move(images, tmp_path / "moved"))
    assert list_computed(run(scan, out, config(moved), until="texture")) == set()
    first = moved / "000.png"
    first.write_bytes(cv2.imencode(".png", cv2.imread(str(first)) // 2)[1].tobytes())
    foreseen = predict_run(scan, out, config(moved), until="texture")
    assert [one.stage for one in foreseen.stages if not one.cached] == ["texture"]
    assert list_computed(run(scan, out, config(moved), until="texture")) == {"texture"}
    assert "texture" in {one.stage for one in result.stages}


def test_photos_are_read_with_the_parameters_of_their_section(tmp_path: Path):
    scan, images = write_grey_scan(tmp_path / "scan"), write_other_photos(tmp_path / "photos")
    told = config(images).set(["photos.last=5", "photos.intrinsics=200,201,80,60"])
    cache = Cache(tmp_path / "cache")
    wanted = prepare_run(scan, tmp_path / "out", told, until="texture", force=(), cache=cache)
    assert wanted.photos is not None
    assert [len(wanted.scan.frames), len(wanted.photos.frames)] == [8, 6]
    assert wanted.photos.frames[0].camera.fy == 201
    assert wanted.scan.frames[0].camera.fy == CAMERA.fy


def test_photos_without_poses_are_refused(tmp_path: Path):
    images = tmp_path / "photos"
    images.mkdir()
    with pytest.raises(InputError, match="photos"):
        run(write_grey_scan(tmp_path / "scan"), tmp_path / "out", config(images), until="texture")


def test_colour_bounds_limit_simplification_only_without_a_texture(tmp_path: Path):
    scan, out = write_grey_scan(tmp_path / "scan"), tmp_path / "out"

    def run_simplify(*settings: str) -> dict[str, object]:
        told = Config().set(["adjust.enabled=false", "fuse.voxel_size=0.02", *settings])
        result = run(scan, out, told, until="simplify")
        return dict(next(one for one in result.stages if one.stage == "simplify").metrics)

    textured, colored = run_simplify(), run_simplify("texture.enabled=false")
    assert textured["method"] == "certified"
    assert isinstance(bound := textured["default_max_shape_m"], float)
    assert textured["details"]["shape_bound_m"] <= bound  # type: ignore[index]
    assert colored["method"] == "jia01"
    assert "default_max_shape_m" not in colored
    # Enabling the texture again hits the first result.
    told = Config().set(["adjust.enabled=false", "fuse.voxel_size=0.02"])
    assert list_computed(run(scan, out, told, until="simplify")) == set()


@pytest.mark.parametrize("height", [0.0, 0.01])
def test_a_normal_map_is_written_if_it_is_worth_its_bytes(tmp_path: Path, height: float):
    light, fine = wall(2), wall(80)
    relief = height * np.sin(20 * fine.vertices[:, 0])
    original = fine.with_(vertices=fine.vertices + relief[:, None] * (0, 0, 1))
    metrics, sizes = [], []
    for name, source in (("plain", None), ("mapped", original)):
        folder = tmp_path / name
        folder.mkdir()
        metrics.append(
            write_textured(folder, light, photos(4), TextureSection(), None, ignore_progress, source)
        )
        sizes.append((folder / "textured.glb").stat().st_size)
    assert metrics[0]["normal_map"] is None
    about = metrics[1]["normal_map"]
    mapped = read_mesh(tmp_path / "mapped" / "textured.glb")
    assert about["is_written"] == has_normal_map(mapped) == (height > 0)
    if height == 0:
        assert sizes[1] == sizes[0]
        return
    assert sizes[1] <= 4 / 3 * sizes[0]
    assert about["shading_error_after"]["p90_deg"] < about["shading_error_before"]["p90_deg"] / 2
    assert is_unlit(mapped.texture.materials[0])
    # Unlit files drop the map, which they would not show; lit files keep it.
    for shading in ("unlit", "lit"):
        export(mapped, tmp_path / f"{shading}.glb", shading=shading)
        assert has_normal_map(read_mesh(tmp_path / f"{shading}.glb")) == (shading == "lit")


def test_the_refined_mesh_counts_only_for_a_normal_map():
    stage = find_stage("texture")
    assert stage is not None
    assert "refined_mesh" not in stage.ignored_inputs(Config())
    assert "refined_mesh" in stage.ignored_inputs(Config().set(["texture.normal_map=false"]))
