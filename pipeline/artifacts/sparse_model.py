"""Files with the cameras estimated by `structure`.

sparse/0/   model in COLMAP's binary format: cameras, images with poses, sparse points. Image names are paths
            in the scan folder, or in frames/; the ID of an image is its frame index plus 1.
frames/     frames that were taken from a video: JPEG files, named by frame
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from scanloom.pipeline.relative_paths import make_paths_relative
from scanloom.pipeline.stage import Artifact
from scanloom.stages.registration.structure.reconstruct import Structure
from scanloom.stages.scans.image_folders.image_files import list_images
from scanloom.stages.scans.layouts.colmap.model_files import read_model, read_points
from scanloom.stages.scans.model.depth_range import estimate_depth_range
from scanloom.stages.scans.model.scan import Frame, Scan

MODEL_FOLDER, FRAMES_FOLDER = "sparse", "frames"
_MODEL = "0"


@dataclass(frozen=True)
class SparseModel(Artifact):
    """Estimated cameras of photos, and sparse points."""

    NAME = "sparse_model"

    def apply_to(self, scan: Scan) -> Scan:
        """Apply the estimated cameras to a scan, dropping frames without a pose."""
        model = self.folder / MODEL_FOLDER / _MODEL
        photos = self._load_photos(scan)
        points = read_points(model)
        frames = []
        for view in sorted(read_model(model), key=lambda view: view.image_id):
            pose = view.world_from_camera
            if pose is None:
                continue
            depths = (points.get(view.image_id, np.zeros((0, 3))) - pose[:3, 3]) @ pose[:3, 2]
            frames.append(
                replace(
                    photos[view.image_id - 1],
                    camera=view.camera,
                    world_from_camera=pose,
                    depth_range=estimate_depth_range(depths),
                )
            )
        return replace(scan, frames=frames, missing=(), up=scan.up if scan.has_poses else None)

    def _load_photos(self, scan: Scan) -> Sequence[Frame]:
        """Return the frames that were used: of a video those in `frames/`, else all of the scan."""
        folder = self.folder / FRAMES_FOLDER
        if not folder.is_dir():
            return scan.frames
        frames = {frame.name: frame for frame in scan.frames}
        return [replace(frames[file.stem], color=file) for file in list_images(folder)]


def write_sparse_model(
    folder: Path, structure: Structure, scan_folder: Path | None = None
) -> Mapping[str, Any]:
    """Write a model into an empty folder and return its metrics.

    Paths in texts are made relative to the scan folder.
    """
    model = folder / MODEL_FOLDER / _MODEL
    model.mkdir(parents=True)
    structure.write_model(model)
    metrics: Mapping[str, Any] = make_paths_relative(structure.to_dict(), scan_folder)
    return metrics
