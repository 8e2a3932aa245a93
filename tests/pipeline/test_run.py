"""The real stages on scans of a few small frames."""

import contextlib
import json
import math
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from scanloom.pipeline.artifacts.depth_maps import choose_depth_scale
from scanloom.pipeline.cache.digest import compute_digest, compute_file_digest
from scanloom.pipeline.cache.store import Cache
from scanloom.pipeline.config import Config
from scanloom.pipeline.evaluation.measurements import edge_metrics
from scanloom.pipeline.graph import STAGES
from scanloom.pipeline.run.events import RunStarted
from scanloom.pipeline.run.run import CACHE_VARIABLE, run
from scanloom.pipeline.run.schema import SCHEMA
from scanloom.stages.diagnostics.errors import InputError, UsageError
from scanloom.stages.params import describe_all, flatten
from scanloom.stages.scans.layouts.scan_json import write_scan_json
from scanloom.stages.scans.model.images import read_color, read_depth
from scanloom.stages.scans.model.scan import Camera, Frame
from scanloom.stages.scans.reader import read_scan
from scanloom.stages.surface.formats.ply import read_ply
from scanloom.stages.surface.mesh import Mesh

WIDTH, HEIGHT, FOCAL = 160, 120, 140.0
CAMERA = Camera(WIDTH, HEIGHT, FOCAL, FOCAL, (WIDTH - 1) / 2, (HEIGHT - 1) / 2)
QUICK = (
    "fuse.voxel_size=0.02",
    "report.viewpoints=1",
    "report.page=false",
    "report.width=64",
    "compare.samples=1000",
)
PLAIN = [
    "clean.ply",
    "fused.ply",
    "pictures",
    "refined.ply",
    "report.json",
    "simplified.ply",
    "texture_maps",
    "textured.glb",
]


@pytest.fixture(autouse=True)
def _no_shared_cache(monkeypatch):
    monkeypatch.delenv(CACHE_VARIABLE, raising=False)


def make_shifted_pose(x: float) -> np.ndarray:
    pose = np.eye(4)
    pose[0, 3] = x
    return pose


def write_rgbd(folder: Path) -> Path:
    """Write six frames of a camera that passes a sphere of 0.25 m in front of a wall 1.2 m away."""
    for name in ("color", "depth"):
        (folder / name).mkdir(parents=True)
    columns, rows = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    ray = np.stack(
        [(columns - CAMERA.cx) / FOCAL, (rows - CAMERA.cy) / FOCAL, np.ones((HEIGHT, WIDTH))], axis=-1
    )
    frames = []
    for i in range(6):
        x = 0.02 * i
        to_ball = np.array([-x, 0, 0.9])
        along = ray @ to_ball / (ray**2).sum(-1)
        inside = along**2 - (to_ball @ to_ball - 0.25**2) / (ray**2).sum(-1)
        depth = np.where(inside > 0, along - np.sqrt(np.maximum(inside, 0)), 1.2)
        color = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
        color[..., 0] = np.where(inside > 0, 220, 60)
        color[..., 1] = np.clip(128 + 200 * (ray[..., 1] * depth), 0, 255)
        color[..., 2] = np.clip(128 + 200 * (ray[..., 0] * depth + x), 0, 255)
        name = f"{i:04d}.png"
        cv2.imwrite(str(folder / "color" / name), color)
        cv2.imwrite(str(folder / "depth" / name), np.rint(depth * 1000).astype(np.uint16))
        frames.append(
            Frame(
                name,
                CAMERA,
                folder / "color" / name,
                depth=folder / "depth" / name,
                world_from_camera=make_shifted_pose(x),
            )
        )
    write_scan_json(folder, frames)
    return folder


@pytest.fixture
def rgbd(tmp_path: Path) -> Path:
    """Write a separate RGB-D scan for each test."""
    return write_rgbd(tmp_path / "rgbd")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Run the RGB-D scan once; tests continue with copies of its results and cache."""
    folder = tmp_path_factory.mktemp("made")
    run(write_rgbd(folder / "rgbd"), folder / "out", make_quick_config(), cache_dir=folder / "out" / "cache")
    return folder / "out"


@pytest.fixture
def stereo(tmp_path: Path) -> Path:
    """Write four stereo pairs of a textured wall.

    16 px of disparity, f = 140 px, b = 0.1 m, so 0.875 m away.
    """
    folder = tmp_path / "stereo"
    for name in ("left", "right"):
        (folder / name).mkdir(parents=True)
    wall = cv2.GaussianBlur(
        np.random.default_rng(5).integers(0, 255, (HEIGHT, 2 * WIDTH, 3), np.uint8), (3, 3), 0
    )
    poses = []
    for i in range(4):
        at = 8 * i
        cv2.imwrite(str(folder / "left" / f"{i:04d}.png"), wall[:, at : at + WIDTH])
        cv2.imwrite(str(folder / "right" / f"{i:04d}.png"), wall[:, at + 16 : at + 16 + WIDTH])
        poses.append(" ".join(map(str, make_shifted_pose(at * 0.875 / FOCAL)[:3].ravel())))
    (folder / "poses.txt").write_text("\n".join(poses) + "\n")
    matrix = CAMERA.matrix.tolist()
    calibration = {"K1": matrix, "K2": matrix, "R": np.eye(3).tolist(), "T": [-0.1, 0, 0], "rectified": True}
    (folder / "calibration.json").write_text(json.dumps(calibration))
    return folder


def make_quick_config(*assignments: str) -> Config:
    return Config().set([*QUICK, *assignments])


def list_computed(result) -> list[str]:
    return [outcome.stage for outcome in result.stages if not outcome.cached]


def list_names(out: Path) -> list[str]:
    return sorted(path.name for path in out.iterdir() if path.name != "cache")


def read_results(out: Path) -> dict[str, bytes]:
    """Read every result except the report, which contains times."""
    paths = [*out.glob("*.ply"), *(path for path in out.glob("pictures/**/*") if path.is_file())]
    return {str(path.relative_to(out)): path.read_bytes() for path in paths}


def list_file_states(folder: Path) -> list[tuple]:
    return sorted((str(path), path.stat().st_mtime_ns, path.stat().st_size) for path in folder.rglob("*"))


def test_rgbd_scan_to_mesh_and_report(rgbd, tmp_path):
    out = tmp_path / "out"
    before = list_file_states(rgbd)
    events = []
    result = run(rgbd, out, make_quick_config(), events=events.append)
    assert list_file_states(rgbd) == before, "the scan is only read"
    assert events[0] == RunStarted(
        "plain-rgbd", 6, ("adjust", "fuse", "clean", "refine", "upright", "simplify", "texture", "report")
    )
    assert list_computed(result) == [
        "adjust",
        "fuse",
        "clean",
        "refine",
        "upright",
        "simplify",
        "texture",
        "report",
    ]
    assert list_names(out) == PLAIN

    report = json.loads((out / "report.json").read_text())
    assert report == result.report
    assert result.to_dict()["out"] == str(out)
    assert report["schema"] == SCHEMA
    assert report["scan"] == {
        "layout": "plain-rgbd",
        "frames": 6,
        "frames_skipped": [],
        "diagnostics": [],
        "metric": True,
        "scale": None,
    }
    assert list(report["stages"]) == [
        "adjust",
        "fuse",
        "clean",
        "refine",
        "upright",
        "simplify",
        "texture",
        "report",
    ]
    for stage in report["stages"].values():
        assert stage["cached"] is False
        assert stage["reason"] == "first run"
        assert stage["seconds"] >= stage["compute_seconds"] > 0
        assert stage["peak_memory_mb"] > 10
    assert report["stages"]["fuse"]["params"]["fuse"]["voxel_size"] == 0.02

    mesh = read_ply(out / "simplified.ply")
    found = report["mesh"]
    assert (found["vertices"], found["triangles"]) == (len(mesh.vertices), len(mesh.triangles))
    assert found["manifold"] is True
    assert found["boundary_loops"] >= 1
    assert 0 < found["to_fused"]["distance"]["symmetric"]["rms_m"] < 0.02
    assert found["to_fused"]["color"]["symmetric"]["rmse_levels"] < 40
    assert found["to_refined"]["distance"]["symmetric"]["rms_m"] < 0.02
    sizes = {Path(name).name: cv2.imread(str(out / name)).shape for name in report["pictures"]}
    assert sizes == {
        "fused-overview.png": (48, 64, 3),
        "refined-overview.png": (48, 64, 3),
        "simplified-overview.png": (48, 64, 3),
        "simplified-triangles.png": (48, 128, 3),
        "textured-overview.png": (48, 64, 3),
        "textured-photos.png": (48, 64, 3),
    }


def test_second_run_is_cached_and_imports_nothing_heavy(rgbd, made, tmp_path):
    out = Path(shutil.copytree(made, tmp_path / "out"))
    code = (
        "import sys; from scanloom.pipeline.config import Config; from scanloom.pipeline.run.run import run\n"
        f"result = run({str(rgbd)!r}, {str(out)!r}, Config().set({QUICK!r}))\n"
        "print([o.cached for o in result.stages], {'open3d', 'scipy', 'trimesh'} & set(sys.modules))"
    )
    started = time.perf_counter()
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[True, True, True, True, True, True, True, True] set()"
    assert time.perf_counter() - started < 10
    report = json.loads((out / "report.json").read_text())
    assert [stage["cached"] for stage in report["stages"].values()] == [True] * 8
    assert report["mesh"]["triangles"] > 0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("assignment", "expected"),
    [
        ("fuse.voxel_size=0.03", ["fuse", "clean", "refine", "upright", "simplify", "texture", "report"]),
        ("simplify.ratio=0.5", ["simplify", "texture", "report"]),
        ("compare.seed=1", ["report"]),
        ("report.width=80", ["report"]),
        ("fuse.memory=3000", []),
        ("remesh.levels=2", []),
        ("lod.ratio=2", []),
        ("tiles.page=true", []),
        ("depth.sgbm.block_size=5", []),
    ],
)
def test_a_parameter_reruns_its_stage_and_later_stages(rgbd, made, tmp_path, assignment, expected):
    shutil.copytree(made, tmp_path / "out")
    result = run(rgbd, tmp_path / "out", make_quick_config(assignment))
    assert list_computed(result) == expected
    if expected:
        name = assignment.partition("=")[0]
        assert name.split(".")[1] in next(o.reason for o in result.stages if not o.cached)


def test_every_section_belongs_to_one_stage():
    # Parameters for reading folders affect the key through the scan itself.
    used = [section for stage in STAGES for section in stage.sections]
    assert sorted([*used, "scan", "photos", "cache"]) == sorted(Config.get_types())


@pytest.mark.parametrize("section", sorted(set(Config.get_types()) - {"scan"}))
def test_every_parameter_is_in_the_key_unless_it_cannot_change_the_result(section):
    about = describe_all(Config.get_types()[section])
    assert set(flatten(Config().to_canonical(section))) == {
        name for name, one in about.items() if one.invalidates
    }


def test_configuration_prints_and_reads_back():
    assert Config.loads(Config().dumps()) == Config()


@pytest.mark.slow
def test_results_are_deterministic(rgbd, made, tmp_path):
    run(rgbd, tmp_path / "out", make_quick_config())
    assert read_results(tmp_path / "out") == read_results(made)


@pytest.mark.slow
def test_killed_at_random_moments_and_restarted(rgbd, tmp_path):
    code = (
        "from scanloom.pipeline.config import Config; from scanloom.pipeline.run.run import run; import sys\n"
        f"run({str(rgbd)!r}, sys.argv[1], Config().set({QUICK!r}))"
    )
    started = time.perf_counter()
    subprocess.run([sys.executable, "-c", code, tmp_path / "whole"], check=True)
    seconds = time.perf_counter() - started
    out = tmp_path / "out"
    draw = random.Random(11)
    kills = 0
    for _ in range(3):
        with subprocess.Popen([sys.executable, "-c", code, out]) as process:
            time.sleep(seconds * draw.uniform(0.2, 0.9))
            process.kill()
        kills += process.returncode == -signal.SIGKILL
        assert all(entry.problem is None for entry in Cache(out / "cache").verify())
    assert kills > 0
    run(rgbd, out, make_quick_config())
    assert read_results(out) == read_results(tmp_path / "whole")
    assert list_names(out) == PLAIN
    assert not list((out / "cache" / "drafts").iterdir())


def test_stereo_scan_leaves_its_depth_as_a_scan(stereo, tmp_path):
    out = tmp_path / "out"
    result = run(stereo, out, make_quick_config(), until="fuse")
    assert list_computed(result) == ["depth", "adjust", "fuse"]
    assert list_names(out) == ["fused.ply", "points.ply", "report.json"]
    assert result.report["mesh"] is None

    scan = read_scan(result.stages[0].folder)
    assert [frame.name for frame in scan.frames] == ["000000", "000001", "000002", "000003"]
    for i, frame in enumerate(scan.frames):
        depth = read_depth(frame)
        assert np.count_nonzero(depth) > 0.5 * depth.size
        assert np.median(depth[depth > 0]) == pytest.approx(0.875, abs=0.005)
        assert np.array_equal(read_color(frame), read_color(read_scan(stereo).frames[i]))
        assert frame.world_from_camera[0, 3] == pytest.approx(8 * i * 0.875 / FOCAL)
        confidence = cv2.imread(str(result.stages[0].folder / "confidence" / f"{frame.name}.png"), -1)
        assert confidence.shape == depth.shape
        assert (confidence[depth > 0] > 0).all()
    points = read_ply(out / "points.ply")
    assert np.median(points.vertices[:, 2]) == pytest.approx(0.875, abs=0.005)
    assert points.colors is not None
    assert list_computed(run(stereo, out, make_quick_config(), until="fuse")) == []
    assert list_computed(run(stereo, out, make_quick_config("depth.threads=1"), until="fuse")) == []
    assert list_computed(run(stereo, out, make_quick_config("depth.sgbm.uniqueness=6"), until="depth")) == [
        "depth"
    ]


def test_bad_frame_is_skipped_and_counted(rgbd, tmp_path):
    (rgbd / "depth" / "0003.png").write_bytes(b"not an image")
    for _ in ("made", "cached"):
        result = run(rgbd, tmp_path / "out", make_quick_config("fuse.max_skipped_ratio=0.5"), until="fuse")
        [skipped] = result.stages[1].metrics["frames_skipped"]
        assert "0003" in skipped["reason"]
        [warned] = result.diagnostics
        assert str(warned).startswith("fuse: 1 frame skipped; the first is ")
        assert warned.code == "scan.frames-skipped"


def test_a_skipped_frame_is_reported_by_its_current_name(rgbd, tmp_path):
    (rgbd / "depth" / "0003.png").write_bytes(b"not an image")
    options = make_quick_config("fuse.max_skipped_ratio=0.5")
    first = run(rgbd, tmp_path / "out", options, until="fuse")
    moved_to = tmp_path / "elsewhere"
    rgbd.rename(moved_to)
    again = run(moved_to, tmp_path / "out", options, until="fuse")
    assert list_computed(again) == [], "a moved scan is the same scan"
    for result in (first, again):
        [skipped] = result.stages[1].metrics["frames_skipped"]
        assert skipped["reason"].startswith("depth/0003.png: "), "not where it stood once"
    (moved_to / "depth" / "0003.png").rename(moved_to / "depth" / "third.png")
    listed = moved_to / "scan.json"
    listed.write_text(listed.read_text().replace("depth/0003.png", "depth/third.png"))
    renamed = run(moved_to, tmp_path / "out", options, until="fuse")
    [skipped] = renamed.stages[1].metrics["frames_skipped"]
    assert skipped["reason"].startswith("depth/third.png: ")


def test_the_cache_size_is_limited_after_a_run(rgbd, tmp_path):
    out = tmp_path / "out"
    run(rgbd, out, make_quick_config("fuse.voxel_size=0.03"), until="fuse")
    first = run(rgbd, out, make_quick_config(), until="fuse").stages[1].folder
    assert len(list(first.parent.iterdir())) == 2
    again = run(rgbd, out, make_quick_config("cache.max_size=1 kB"), until="fuse")
    assert list_computed(again) == []
    assert [path.name for path in first.parent.iterdir()] == [first.name]
    assert "more than cache.max_size" in str(again.diagnostics[-1])


def test_unchecked_poses_are_checked_on_request(rgbd, tmp_path):
    listed = json.loads((rgbd / "scan.json").read_text())
    for frame in listed["frames"]:
        pose = np.array(frame["world_from_camera"])
        pose[0, 3] *= -15
        frame["world_from_camera"] = pose.tolist()
    (rgbd / "scan.json").write_text(json.dumps(listed))
    plain = make_quick_config("scan.check_poses=false")
    assert list_computed(run(rgbd, tmp_path / "out", plain, until="fuse")) == ["adjust", "fuse"]
    with contextlib.suppress(InputError):  # test_poses_of_another_convention checks the message
        assert list_computed(run(rgbd, tmp_path / "out", make_quick_config(), until="fuse")) == [
            "adjust",
            "fuse",
        ]


def test_a_scan_of_unusable_pairs_is_refused(stereo, tmp_path):
    for path in stereo.glob("right/*.png"):
        cv2.imwrite(str(path), cv2.imread(str(path)).astype(np.uint16))
    with pytest.raises(InputError):
        run(stereo, tmp_path / "out", make_quick_config("depth.max_skipped_ratio=1"))
    assert list_names(tmp_path / "out") == []


@pytest.mark.parametrize("limit", [0.5, 1.0, 38.0, 655.35, 2000.0])
def test_depth_scale_uses_the_sixteen_bits(limit):
    assert 65535 * 0.98 < limit * choose_depth_scale(limit) <= 65535 * (1 + 1e-12)


def test_edge_metrics_of_a_known_mesh():
    square = Mesh(
        np.array([[0, 0, 0], [3, 0, 0], [3, 4, 0], [0, 4, 0]], float),
        np.array([[0, 1, 2], [0, 2, 3]], np.int32),
    )
    found = edge_metrics(square)
    assert found["count"] == 5
    assert found["length_mean_m"] == pytest.approx((3 + 3 + 4 + 4 + 5) / 5)
    assert found["length_std_m"] == pytest.approx(math.sqrt((2 * 0.8**2 + 2 * 0.2**2 + 1.2**2) / 5))
    assert (found["length_min_m"], found["length_max_m"]) == (3, 5)


def test_output_may_not_be_the_scan(rgbd, tmp_path, monkeypatch):
    before = list_file_states(rgbd)
    with pytest.raises(UsageError, match="the output folder is the scan itself"):
        run(rgbd, rgbd)
    monkeypatch.setenv(CACHE_VARIABLE, str(rgbd))
    with pytest.raises(UsageError, match="the cache folder is the scan itself"):
        run(rgbd, tmp_path / "out")
    assert list_file_states(rgbd) == before


def test_cache_folder_from_argument_and_environment(rgbd, tmp_path, monkeypatch):
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "shared"))
    assert run(rgbd, tmp_path / "out", make_quick_config(), until="fuse").cache == tmp_path / "shared"
    assert list_computed(run(rgbd, tmp_path / "other", make_quick_config(), until="fuse")) == []
    given = run(rgbd, tmp_path / "out", make_quick_config(), until="fuse", cache_dir=tmp_path / "given")
    assert list_computed(given) == ["adjust", "fuse"]
    assert given.cache == tmp_path / "given"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"until": "fuze"}, "there is no stage 'fuze'; did you mean fuse?"),
        (
            {"force": ["all"]},
            "there is no stage 'all'; known are structure, depth, register, adjust, fuse, clean, refine, "
            "upright, simplify, ",
        ),
        ({"until": "depth"}, "depth does not apply to this scan"),
        ({"force": ["depth"]}, "depth does not apply to this scan"),
        ({"until": "remesh"}, "remesh is not enabled; set remesh.enabled=true"),
        ({"until": "lod"}, "lod is not enabled; set lod.enabled=true"),
    ],
)
def test_unknown_stages_are_refused(rgbd, tmp_path, options, message):
    with pytest.raises(UsageError) as raised:
        run(rgbd, tmp_path / "out", **options)
    assert str(raised.value).startswith(message)
    assert not (tmp_path / "out").exists()


def test_bad_scan_leaves_no_output_folder(tmp_path):
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="empty"):
        run(tmp_path / "empty", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_poses_of_another_convention_stop_the_run(shared_data, tmp_path):
    scan = shared_data / "rgbd" / "tabletop_box_realsense"
    inverse = tmp_path / "inverse.txt"
    np.savetxt(inverse, [np.linalg.inv(np.loadtxt(one)).ravel() for one in sorted(scan.glob("*.pose.txt"))])
    config = Config().set([f"scan.poses={inverse}"])
    with pytest.raises(InputError, match="tabletop_box_realsense: the poses are probably world-to-camera"):
        run(scan, tmp_path / "out", config, until="fuse")


def test_files_of_users_are_not_replaced(rgbd, tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / "simplified.ply").write_bytes(b"mine")
    for name in ("fused.ply", "notes.txt"):
        (out / name).write_bytes(b"mine")
    with pytest.raises(
        InputError, match=r"fused\.ply: this file was not written by a run, .* give run.overwrite"
    ) as refused:
        run(rgbd, out, make_quick_config(), until="fuse")
    assert "\n" not in str(refused.value)
    # Refused before any work.
    assert not list((out / "cache").glob("fuse/*"))
    (out / "fused.ply").unlink()
    assert list_computed(run(rgbd, out, make_quick_config(), until="fuse")) == ["adjust", "fuse"]
    with pytest.raises(InputError, match=r"simplified\.ply"):
        run(rgbd, out, make_quick_config())
    assert (out / "simplified.ply").read_bytes() == (out / "notes.txt").read_bytes() == b"mine"
    run(rgbd, out, make_quick_config(), overwrite=True)
    assert len(read_ply(out / "simplified.ply").triangles) > 0
    assert (out / "notes.txt").read_bytes() == b"mine"


def test_files_of_a_run_are_recognised_without_its_cache(rgbd, tmp_path):
    out = tmp_path / "out"
    run(rgbd, out, make_quick_config(), until="clean")
    shutil.rmtree(out / "cache")
    assert list_computed(run(rgbd, out, make_quick_config("fuse.voxel_size=0.08"), until="fuse")) == [
        "adjust",
        "fuse",
    ]
    # Outdated later results are removed as usual.
    assert list_names(out) == ["fused.ply", "report.json"]
    shutil.rmtree(out / "cache")
    report = out / "report.json"
    report.write_text(report.read_text().replace('"frames": ', '"frames": 1'))
    with pytest.raises(InputError, match=r"fused\.ply|report\.json"):
        run(rgbd, out, make_quick_config(), until="clean")


def test_files_of_a_killed_run_are_recognised(rgbd, tmp_path, monkeypatch):
    out = tmp_path / "out"
    run(rgbd, out, make_quick_config(), until="clean")
    run(rgbd, out, make_quick_config("clean.min_island_area=0.5"), until="clean")

    class KilledError(BaseException):
        pass

    def killed(*_):
        raise KilledError

    for at in ("copy_atomically", "OutputFolder.write_report"):
        with monkeypatch.context() as patched:
            patched.setattr(f"scanloom.pipeline.run.output_folder.{at}", killed)
            with pytest.raises(KilledError):
                run(rgbd, out, make_quick_config(), until="clean")
        run(rgbd, out, make_quick_config("clean.min_island_area=0.5"), until="clean")


def test_paths_in_a_report_cannot_leave_the_folder(rgbd, tmp_path):
    out, other = tmp_path / "out", tmp_path / "other.ply"
    other.write_bytes(b"mine")
    run(rgbd, out, make_quick_config(), until="fuse")
    report = json.loads((out / "report.json").read_text())
    del report["digest"]
    report["placed"]["remesh"] = {"../other.ply": compute_file_digest(other)}
    (out / "report.json").write_text(json.dumps({**report, "digest": compute_digest(report)}))
    shutil.rmtree(out / "cache")
    with pytest.raises(InputError, match="not written by a run"):
        run(rgbd, out, make_quick_config(), until="fuse")
    assert other.read_bytes() == b"mine"


def test_outdated_results_of_another_cache_are_removed(rgbd, tmp_path):
    out = tmp_path / "out"
    run(rgbd, out, make_quick_config(), until="clean", cache_dir=tmp_path / "a")
    run(rgbd, out, make_quick_config("fuse.voxel_size=0.08"), until="clean", cache_dir=tmp_path / "b")
    run(rgbd, out, make_quick_config("fuse.voxel_size=0.09"), until="fuse", cache_dir=tmp_path / "a")
    assert list_names(out) == ["fused.ply", "report.json"]
