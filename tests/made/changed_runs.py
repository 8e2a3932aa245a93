"""Runs that differ in one thing from an earlier run: over its results, and from nothing.

Both have the same results.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import cv2
import numpy as np
import posed_scene
from numpy.typing import NDArray
from small_sample import write_small_sample
from small_scans import write_small_scan

from scanloom.pipeline.config import Config
from scanloom.pipeline.run.run import run
from scanloom.stages.diagnostics.errors import ScanloomError
from scanloom.stages.params import describe_all, get_default, get_hint
from scanloom.stages.scans.reader import read_scan

SAMPLES = Path(__file__).parents[2] / "samples"
# Facts about the machine, the moment, the content of the cache, and the division of work.
MOMENT = frozenset(
    (
        *("created", "cached", "reason", "seconds", "compute_seconds", "peak_memory_mb", "digest"),
        *("bricks", "bricks_fused"),
    )
)
SMALL = (
    "fuse.voxel_size=0.03",
    "simplify.ratio=0.4",
    "texture.texels_per_pixel=0.1",
    "compare.samples=200",
    "report.viewpoints=1",
    "report.width=64",
    "report.photos=1",
)
ALL_STAGES = (
    "bake.enabled=true",
    "remesh.enabled=true",
    "lod.enabled=true",
    "export.web=true",
    "coverage.enabled=true",
)
# Parameters with the name of a file; another file is another input.
FILES = ("poses", "calibration", "masks", "adjusted_cameras", "depth_calibration", "images", "model")
BY_SHAPE = ("simplify.ratio=none", "simplify.max_shape=0.02")
# Settings that a parameter needs to have an effect.
WITH: Mapping[str, tuple[str, ...]] = {
    "simplify.certified.": ("simplify.method=certified", *BY_SHAPE),
    "simplify.seams.": ("simplify.method=seams",),
    "simplify.jia01.": ("simplify.method=jia01",),
    "simplify.planar.": ("simplify.method=planar", *BY_SHAPE),
    "depth.sgbm.": ("depth.matcher=sgbm",),
    "clean.repair_angle": ("clean.repair=true",),
    "clean.max_shape": ("clean.repair=true",),
    "simplify.triangles": ("simplify.ratio=none",),
    "fuse.plane_margin": ("fuse.remove_plane=true",),
    "fuse.upsample_factor": ("fuse.upsample=guided",),
    "fuse.center": ("fuse.radius=0.5",),
}
TEXTS = {
    "intrinsics": "50,50,31.5,23.5",
    "known_distance": "1 2",
    "up": "+y",
    "depth_scale": "2000",
    "center": "0,0,1",
    "box": "-1,-1,0,1,1,1.1",
    "cache.max_size": "1GB",
    "clean.weld_distance": "0.001",
    "remesh.tolerance": "0.001",
    "simplify.triangles": "50",
}


@dataclass(frozen=True)
class Trial:
    """A scan with settings that enable the stages of some sections."""

    write: Callable[[Path], None]
    settings: tuple[str, ...] = ()


def write_ball(folder: Path) -> None:
    write_small_scan(folder, 3)


def write_pairs(folder: Path) -> None:
    """Write two pairs of the stereo sample at a quarter of their size."""
    text = (SAMPLES / "stereo" / "calibration.toml").read_text()
    folder.mkdir()
    scaled = re.sub(
        r"(?m)^(width|height|fx|fy|cx|cy) = (.*)$", lambda m: f"{m[1]} = {float(m[2]) / 4:g}", text
    )
    (folder / "calibration.toml").write_text(scaled)
    for side in ("left", "right"):
        (folder / side).mkdir()
        for path in sorted((SAMPLES / "stereo" / side).iterdir())[:2]:
            image = cv2.imread(str(path))
            assert image is not None
            small = cv2.resize(image, None, fx=0.25, fy=0.25)
            cv2.imwrite(str(folder / side / f"{path.stem}.png"), small, [cv2.IMWRITE_PNG_COMPRESSION, 0])
    poses = (SAMPLES / "stereo" / "poses.txt").read_text().splitlines()
    (folder / "poses.txt").write_text("\n".join(poses[:2]))


def write_views(folder: Path) -> None:
    posed_scene.write_posed_views(folder, 4)


def write_unposed(folder: Path) -> None:
    write_small_sample(folder)
    document = json.loads((folder / "scan.json").read_text())
    for frame in document["frames"]:
        frame["world_from_camera"] = None
    (folder / "scan.json").write_text(json.dumps(document))


def write_ball_and_files(folder: Path) -> None:
    """Write a scan with poses, masks and a depth calibration in files of their own."""
    write_ball(folder)
    read = read_scan(folder)
    poses = [frame.world_from_camera for frame in read.frames]
    lines = (f"{i} {pose[0, 3]:.3f} 0.001 0 0 0 0 1\n" for i, pose in enumerate(poses) if pose is not None)
    (folder / "poses.tum").write_text("".join(lines))
    (folder / "masks").mkdir()
    for frame in read.frames:
        mask = np.full((frame.camera.height, frame.camera.width), 255, np.uint8)
        mask[:4] = 0
        cv2.imwrite(str(folder / "masks" / f"{frame.name}.png"), mask)
    for path in folder.rglob("*.png"):
        rewrite_image(path, lambda image: image)


def rewrite_image(path: Path, change: Callable[[NDArray[Any]], NDArray[Any]]) -> None:
    """Rewrite an image without compression, so that its size does not depend on its pixels."""
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert image is not None
    assert cv2.imwrite(str(path), change(image), [cv2.IMWRITE_PNG_COMPRESSION, 0])


def brighten_corner(image: NDArray[Any]) -> NDArray[Any]:
    """Change pixels of any image: colour, depth or mask."""
    changed: NDArray[Any] = image.copy()
    changed[20:40, 20:40] = np.where(changed[20:40, 20:40] == 255, 0, changed[20:40, 20:40] + 9)
    return changed


def change_file(path: Path) -> None:
    """Change the content of a file, but neither its size nor its time stamps."""
    before = path.stat()
    if path.suffix == ".png":
        rewrite_image(path, brighten_corner)
    else:
        text = path.read_text()
        first = re.search(r"\.\d+(?![\de])", text)
        assert first is not None
        place = first.end() - 1
        path.write_text(text[:place] + str((int(text[place]) + 3) % 10) + text[place + 1 :])
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
    assert path.stat().st_size == before.st_size


ONE_SCAN = Trial(write_ball)
WITH_FILES = Trial(
    write_ball_and_files,
    ("scan.poses={scan}/poses.tum", "scan.masks={scan}/masks", "texture.images={scan}"),
)


def list_other_values(key: str) -> list[str]:
    """List values other than the default as text; some are refused."""
    section, _, name = key.partition(".")
    cls = Config.get_types()[section]
    about, default, hint = describe_all(cls)[name], get_default(cls, name), get_hint(cls, name)
    text = TEXTS.get(key, TEXTS.get(name))
    if text is not None:
        return [text]
    if about.choices:
        return [choice for choice in about.choices if choice != default]
    kinds = (hint, *get_args(hint))
    if bool in kinds:
        return ["false", "true"] if default is None else [str(not default).lower()]
    if default is None:
        return ["0.5", "2", "1", "0.05"] if int in kinds or float in kinds else []
    numbers = (default * 2, default / 2, default + 1, default - 1)
    return [str(kinds[0](number)) for number in numbers if kinds[0](number) != default]


def list_keys(section: str) -> list[str]:
    """List the parameters of a section that are not names of files."""
    described = describe_all(Config.get_types()[section])
    return [f"{section}.{name}" for name in described if name not in FILES]


def read_facts(report: Any) -> Any:
    """Remove from a report the facts that differ between equal runs."""
    if isinstance(report, dict):
        return {key: read_facts(value) for key, value in report.items() if key not in MOMENT}
    return [read_facts(value) for value in report] if isinstance(report, list) else report


def list_files(out: Path) -> dict[str, str]:
    """Digest the results of a run, without the report and the page, which tell the time."""
    files = (path for path in out.rglob("*") if path.is_file() and out / "cache" not in path.parents)
    return {
        path.relative_to(out).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in files
        if path.name not in ("report.json", "report.html") and not path.name.startswith(".")
    }


def list_differences(one: Any, other: Any, at: str = "") -> list[str]:
    """List the first differences between JSON values, with their location."""
    if isinstance(one, dict) and isinstance(other, dict):
        pairs = [(f"{at}.{key}", one.get(key), other.get(key)) for key in {**one, **other}]
    elif isinstance(one, list) and isinstance(other, list) and len(one) == len(other):
        both = zip(one, other, strict=True)
        pairs = [(f"{at}[{i}]", first, second) for i, (first, second) in enumerate(both)]
    else:
        return [] if one == other else [f"{at}: {one!r:.150} instead of {other!r:.150}"]
    return [line for where, first, second in pairs for line in list_differences(first, second, where)][:5]


def run_once(scan: Path, out: Path, config: Config) -> tuple[Mapping[str, Any], list[str]]:
    """Run, and return the results to compare, and the stages that came from the cache."""
    result = run(scan, out, config)
    facts = {
        "report": read_facts(json.loads((out / "report.json").read_text(encoding="utf-8"))),
        "diagnostics": [one.to_dict() for one in result.diagnostics],
        "files": list_files(out),
        "has_page": (out / "report.html").exists(),
    }
    return facts, [one.stage for one in result.stages if one.cached]


def compare_runs(scan: Path, earlier: Path, tmp_path: Path, config: Config) -> list[str]:
    """Run over the results of an earlier run and from nothing, compare, and return the cached stages."""
    shutil.copytree(earlier, tmp_path / "again")
    from_nothing, none = run_once(scan, tmp_path / "new", config)
    from_cache, cached = run_once(scan, tmp_path / "again", config)
    assert not none
    for name, facts in from_nothing.items():
        different = list_differences(from_cache[name], facts)
        assert not different, f"{name}{'; '.join(different)}; from the cache: {cached}"
    shutil.rmtree(tmp_path / "again")
    shutil.rmtree(tmp_path / "new")
    return cached


def configure(trial: Trial, scan: Path, *more: str) -> Config:
    """Return the configuration of a run of a trial's scan, which may be a copy."""
    return Config().set([*SMALL, *(one.format(scan=scan) for one in trial.settings), *more])


class Bases:
    """Scans, each with the results of a run, made when they are first needed."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._made: dict[tuple[Trial, tuple[str, ...]], Path] = {}

    def get_scan(self, trial: Trial) -> Path:
        scan = self._folder / trial.write.__name__ / "scan"
        if not scan.exists():
            scan.parent.mkdir()
            trial.write(scan)
        return scan

    def configure(self, trial: Trial, *more: str) -> Config:
        return configure(trial, self.get_scan(trial), *more)

    def get_results(self, trial: Trial, settings: tuple[str, ...]) -> Path:
        out = self._made.get((trial, settings))
        if out is None:
            out = self._made[trial, settings] = self._folder / f"out-{len(self._made)}"
            run(self.get_scan(trial), out, self.configure(trial, *settings))
        return out


def check_parameter(key: str, trial: Trial, bases: Bases, tmp_path: Path) -> bool:
    """Compare runs for the first other value that a run accepts; return False if there is none."""
    settings = next((needed for start, needed in WITH.items() if key.startswith(start)), ())
    for text in list_other_values(key):
        try:
            config = bases.configure(trial, *settings, f"{key}={text}")
            compare_runs(bases.get_scan(trial), bases.get_results(trial, settings), tmp_path, config)
        except ScanloomError:
            for left in tmp_path.iterdir():
                shutil.rmtree(left)
            continue
        except AssertionError as error:
            raise AssertionError(f"{key}={text}: {error}") from error
        return True
    return False


def compare_copy(trial: Trial, bases: Bases, folder: Path, changed: str | None = None) -> list[str]:
    """Compare runs of a copy of a scan, in which one file may be changed; return the cached stages."""
    copy = folder / "another path" / "copied scan"
    shutil.copytree(bases.get_scan(trial), copy)
    if changed is not None:
        change_file(copy / changed)
    return compare_runs(copy, bases.get_results(trial, ()), folder, configure(trial, copy))
