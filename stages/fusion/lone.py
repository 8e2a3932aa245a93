"""A frame that is fused alone: its depth goes on a little past its rims, so that the mesh reaches them.

The surface passes only through cells of the field all of whose corners were seen. Corners of cells at a rim
lie beside it: a strip as wide as a cell would be lost along each outline and each hole, where of several
frames others fill it in. So the plane of the nearest pixel is continued past the rim by the diagonal of a
cell's face; the triangles that come of it and lie on no pixel with depth are dropped again.

On oblique or noisy surfaces depth goes in steps, one pixel flat and the next one steep. Each pixel counts as
oblique as the most oblique around it, so that the field behind the flat ones reaches as far as behind these.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stages.fusion.crop import part_of
from stages.fusion.depth_filter import Surface
from stages.fusion.posed_depth import PosedDepth
from stages.fusion.voxels import Layer
from stages.scans.scan import ColorImage, Pose
from stages.surface.mesh import Mesh

Mask = NDArray[np.bool_]

# The diagonal of a cell's face, in voxels; but no more pixels than this, where voxels are far larger.
_REACH = 2**0.5
_MOST_PX = 8
# A plane is continued to no more than this share nearer or farther than where it was seen.
_CHANGE = 0.05
# Obliqueness is the largest of so many pixels each way.
_STEPS = 5


@dataclass(frozen=True, eq=False)
class Continued:
    """A view past its rims, and past the edge of its image.

    Attributes
    ----------
    view : with depth there, of a camera whose image is larger by `margin` pixels on each side.
    here : (h, w), which pixels are to be in the volume.
    color : of that size; None without.
    """

    view: PosedDepth
    here: Mask
    color: ColorImage | None


def continued(view: PosedDepth, here: Mask, color: ColorImage | None, voxel_size: float) -> Continued:
    """Continue a view past its rims.

    Parameters
    ----------
    here : (h, w), which pixels are to be in the volume; those beside them are, too, then.
    color : (h, w, 3) uint8.
    voxel_size : metres.
    """
    import cv2
    from scipy.ndimage import distance_transform_edt

    camera = view.camera
    nearest = float(view.surface.depth[view.surface.depth > 0].min())
    margin = int(np.clip(np.ceil(_REACH * voxel_size * camera.fx / nearest), 1, _MOST_PX))
    camera = replace(
        camera,
        width=camera.width + 2 * margin,
        height=camera.height + 2 * margin,
        cx=camera.cx + margin,
        cy=camera.cy + margin,
    )
    depth = np.pad(view.surface.depth, margin)
    away, (rows, columns) = distance_transform_edt(depth == 0, return_indices=True)
    z = depth[rows, columns]
    normal = [np.pad(axis, margin)[rows, columns] for axis in view.surface.normal]
    obliqueness = np.pad(view.surface.obliqueness, margin)[rows, columns]
    x = (np.arange(camera.width) - camera.cx) / camera.fx
    y = (np.arange(camera.height) - camera.cy) / camera.fy
    # How much nearer the plane is on a pixel's own ray than on that of the pixel with depth.
    nearer = (normal[0] * x + normal[1] * y[:, None] + normal[2]) / (
        normal[0] * x[columns] + normal[1] * y[rows] + normal[2]
    )
    plane = np.where(depth > 0, depth, z / np.clip(nearer, 1 - _CHANGE, 1 + _CHANGE))
    shown = away <= np.minimum(_REACH * voxel_size * camera.fx / z, _MOST_PX)
    steepest = cv2.dilate(
        np.where(depth > 0, obliqueness, 0).astype(np.float32), np.ones((_STEPS, _STEPS), np.uint8)
    )
    steepest = np.maximum(steepest, obliqueness)
    scale = steepest / obliqueness
    across, down, ahead = ((axis * scale).astype(np.float32) for axis in normal)
    surface = Surface(
        np.where(shown, plane, 0).astype(np.float32), (across, down, ahead), steepest.astype(np.float32)
    )
    if color is not None:
        color = np.asarray(
            cv2.copyMakeBorder(color, margin, margin, margin, margin, cv2.BORDER_REPLICATE), np.uint8
        )
    return Continued(
        replace(view, surface=surface, camera=camera),
        shown & np.pad(here, margin)[rows, columns],
        color,
    )


def as_one(parts: list[Layer]) -> list[Layer]:
    """Return layers that each reach all places that any of them touches: no other frame fills gaps."""
    if not parts:
        return parts
    points = np.concatenate([part.points for part in parts])
    return [replace(part, points=points) for part in parts]


def on_depth(mesh: Mesh, view: PosedDepth, pose: Pose) -> Mesh:
    """Return the triangles of a mesh that have a corner on a pixel of the view with depth.

    Parameters
    ----------
    view : as it was read; pose : its camera to the mesh's axes.
    """
    points = (mesh.vertices - pose[:3, 3]) @ pose[:3, :3]
    camera = view.camera
    ahead = np.maximum(points[:, 2], np.finfo(np.float64).tiny)
    columns, rows = (
        np.rint(points[:, axis] / ahead * focal + centre).clip(-1, 1 << 30).astype(np.int64)
        for axis, focal, centre in ((0, camera.fx, camera.cx), (1, camera.fy, camera.cy))
    )
    inside = (columns >= 0) & (columns < camera.width) & (rows >= 0) & (rows < camera.height)
    on = np.zeros(len(points), bool)
    on[inside] = view.surface.depth[rows[inside], columns[inside]] > 0
    return part_of(mesh, np.asarray(on[mesh.triangles].any(axis=1)))
