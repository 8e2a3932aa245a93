"""Evaluation of the result against held-out frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from scanloom.stages.comparing.held_out_views import evaluate_held_out_photos
from scanloom.stages.progress import Progress, ignore_progress
from scanloom.stages.rendering.render import write_png
from scanloom.stages.scans.model.poses import invert_pose
from scanloom.stages.scans.model.scan import Frame
from scanloom.stages.surface.mesh import Mesh


def evaluate_held_out(
    folder: Path | None, mesh: Mesh, held_out: Sequence[Frame], progress: Progress = ignore_progress
) -> tuple[dict[str, Any], list[str]]:
    """Compare held-out frames with a mesh, and draw the worst and the median frame.

    Parameters
    ----------
    folder : folder for the pictures; None to draw none.

    Returns
    -------
    Metrics, and the file names of the pictures.
    """
    found = evaluate_held_out_photos(mesh, held_out, progress)
    if folder is None:
        return found.to_dict(), []
    names = []
    for which, picture in found.comparison_images.items():
        names.append(f"held-out-{which}.png")
        write_png(folder / names[-1], picture)
    return found.to_dict(), names


def transfer_neighbour_poses(
    held_out: Sequence[Frame], every: int, input_frames: Sequence[Frame], final_frames: Sequence[Frame]
) -> list[Frame]:
    """Apply the pose and camera corrections of neighbouring frames to held-out frames.

    Each held-out frame uses the correction of the frame taken just after it.

    Parameters
    ----------
    held_out : every `every`-th frame of a scan.
    input_frames : remaining frames in order, with input poses and cameras.
    final_frames : frames with final poses and cameras.
    """
    found = {frame.name: frame for frame in final_frames}
    return [
        _transfer_pose(
            frame, input_frames[min(every // 2 + number * (every - 1), len(input_frames) - 1)], found
        )
        for number, frame in enumerate(held_out)
    ]


def _transfer_pose(frame: Frame, neighbour: Frame, found: dict[str, Frame]) -> Frame:
    used = found.get(neighbour.name)
    if used is None or used.world_from_camera is None:
        return frame
    pose = used.world_from_camera
    if frame.world_from_camera is not None and neighbour.world_from_camera is not None:
        pose = pose @ invert_pose(neighbour.world_from_camera) @ frame.world_from_camera
    return replace(
        frame,
        world_from_camera=pose,
        # A guessed camera may have been replaced by an estimate.
        camera=used.camera if frame.camera.is_guess else frame.camera,
        color_camera=used.color_camera,
        color_from_depth=used.color_from_depth,
        depth_correction=used.depth_correction,
        # Zero marks a rolling shutter: the rotation of this frame itself is estimated during the comparison.
        shutter_turn=None if used.shutter_turn is None else np.zeros(3),
    )
