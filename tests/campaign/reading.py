"""Pass a file to its reader, and check the promises of readers."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from scanloom.pipeline.cache.store import Cache
from scanloom.pipeline.config import Config
from scanloom.stages.inspecting.inspect import inspect
from scanloom.stages.normal_meshes.normal_mesh import decode
from scanloom.stages.scans.calibration.rig_calibration import read_rig
from scanloom.stages.scans.reader import read_scan
from scanloom.stages.scans.trajectory.trajectory_formats import read_trajectory
from scanloom.stages.simplification.records.load import load_record
from scanloom.stages.surface.mesh import Mesh, validate_mesh
from scanloom.stages.surface.mesh_files import read_mesh
from tests.pipeline import toy


def _describe_valid(mesh: Mesh) -> str:
    """Check that a mesh is valid, and describe it."""
    validate_mesh(mesh)
    assert mesh.texture is None or np.isfinite(mesh.texture.uvs).all(), "a texture coordinate is not finite"
    return repr(mesh)


def _check_mesh(path: Path) -> str:
    mesh = read_mesh(path)
    for image in () if mesh.texture is None else mesh.texture.images:
        if image is not None:
            assert image.pixels.ndim == 3, "an image without channels"
    return _describe_valid(mesh)


def _check_normal_mesh(path: Path) -> str:
    return "; ".join(_describe_valid(level) for level in decode(path).levels)


def _check_record(path: Path) -> str:
    record = load_record(path)
    return "; ".join(_describe_valid(record.replay(ratio=ratio).mesh) for ratio in (1.0, 0.5, 0.2))


def _check_scan(path: Path) -> str:
    scan = read_scan(path, complete=False)
    for frame in scan.frames:
        pose = frame.world_from_camera
        assert pose is None or np.isfinite(pose).all(), f"the pose of frame {frame.name} is not finite"
    return repr(inspect(scan))


def _check_calibration(path: Path) -> str:
    rig = read_rig(path, 32, 24)
    return f"{rig}"


def _check_trajectory(path: Path) -> str:
    poses = [pose for pose in read_trajectory(path).poses if pose is not None]
    assert np.isfinite(poses).all(), "a pose is not finite"
    return f"{len(poses)} poses"


def _check_config(path: Path) -> str:
    return Config.load(path).dumps()


def _check_cache(path: Path) -> str:
    cache = Cache(path / "out" / "cache")
    listed = [*cache.ls(), *cache.verify()]
    warnings: list[str] = []
    toy.run(toy.write_scan(path / "scan"), path / "out", "cut.far=0.5", warnings=warnings)
    return f"{[entry.problem for entry in listed]} {warnings}"


READERS: dict[str, Callable[[Path], str]] = {
    "mesh": _check_mesh,
    "normal mesh": _check_normal_mesh,
    "record": _check_record,
    "scan": _check_scan,
    "calibration": _check_calibration,
    "trajectory": _check_trajectory,
    "config": _check_config,
    "cache": _check_cache,
}
