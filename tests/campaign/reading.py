"""Hand a file to its reader, and hold what comes back to what readers promise."""

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


def _sound(mesh: Mesh) -> str:
    """Say what a mesh is, all of whose numbers are as its class says."""
    validate_mesh(mesh)
    assert mesh.texture is None or np.isfinite(mesh.texture.uvs).all(), "a texture coordinate is not finite"
    return repr(mesh)


def _mesh(path: Path) -> str:
    mesh = read_mesh(path)
    for image in () if mesh.texture is None else mesh.texture.images:
        if image is not None:
            assert image.pixels.ndim == 3, "an image without channels"
    return _sound(mesh)


def _normal_mesh(path: Path) -> str:
    return "; ".join(_sound(level) for level in decode(path).levels)


def _record(path: Path) -> str:
    record = load_record(path)
    return "; ".join(_sound(record.replay(ratio=ratio).mesh) for ratio in (1.0, 0.5, 0.2))


def _scan(path: Path) -> str:
    scan = read_scan(path, complete=False)
    for frame in scan.frames:
        pose = frame.world_from_camera
        assert pose is None or np.isfinite(pose).all(), f"the pose of frame {frame.name} is not finite"
    return repr(inspect(scan))


def _calibration(path: Path) -> str:
    rig = read_rig(path, 32, 24)
    return f"{rig}"


def _trajectory(path: Path) -> str:
    poses = [pose for pose in read_trajectory(path).poses if pose is not None]
    assert np.isfinite(poses).all(), "a pose is not finite"
    return f"{len(poses)} poses"


def _config(path: Path) -> str:
    return Config.load(path).dumps()


def _cache(path: Path) -> str:
    cache = Cache(path / "out" / "cache")
    listed = [*cache.ls(), *cache.verify()]
    warnings: list[str] = []
    toy.run(toy.write_scan(path / "scan"), path / "out", "cut.far=0.5", warnings=warnings)
    return f"{[entry.problem for entry in listed]} {warnings}"


READERS: dict[str, Callable[[Path], str]] = {
    "mesh": _mesh,
    "normal mesh": _normal_mesh,
    "record": _record,
    "scan": _scan,
    "calibration": _calibration,
    "trajectory": _trajectory,
    "config": _config,
    "cache": _cache,
}
