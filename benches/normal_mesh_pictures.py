"""Pictures of normal meshes.

A picture shows the base mesh, all levels, and the original coloured by its distance to the result. Part of
normal_mesh.py.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from scanloom.stages.comparing.distance_map import paint_distances
from scanloom.stages.normal_meshes.normal_mesh import NormalMesh
from scanloom.stages.rendering.render import RenderModel, write_png
from scanloom.stages.rendering.viewpoints import Viewpoint
from scanloom.stages.scans.model.scan import ColorImage
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import RaycastingSurface, compute_bounding_box

INK, PAPER = (38, 52, 74), (242, 244, 247)
HEAD_PX = 32
# Width of the colour bar, and its distance from the right end of the title bar, pixels.
SCALE_PX, SCALE_END_PX = 120, 80


def draw_levels(mesh: Mesh, result: NormalMesh, viewpoint: Viewpoint, path: Path) -> None:
    """Draw all levels from one viewpoint, side by side, as PNG.

    Coloured meshes get a second row that shows their colours.
    """
    models = [RenderModel(RaycastingSurface(light)) for light in result.levels]
    top = [
        add_title(model.draw(viewpoint, "edges"), f"level {level}: {len(light.triangles):,} triangles")
        for level, (model, light) in enumerate(zip(models, result.levels, strict=True))
    ]
    rows = [[*top, draw_distances(mesh, result.mesh, viewpoint)]]
    if mesh.colors is not None:
        below = [
            add_title(model.draw(viewpoint), f"level {level}: colours") for level, model in enumerate(models)
        ]
        rows.append(
            [*below, add_title(RenderModel(RaycastingSurface(mesh)).draw(viewpoint), "original: colours")]
        )
    write_png(path, np.vstack([np.hstack(row) for row in rows]))


def draw_distances(mesh: Mesh, result: Mesh, viewpoint: Viewpoint) -> ColorImage:
    """Draw a mesh coloured by distance to another, with a colour bar."""
    box = compute_bounding_box(mesh, result)
    painted, full_scale = paint_distances(mesh, RaycastingSurface(result, box))
    image = add_title(RenderModel(RaycastingSurface(painted)).draw(viewpoint), "original: distance 0 to")
    ramp = np.linspace(0, 255, SCALE_PX).astype(np.uint8)[:, None]
    end = image.shape[1] - SCALE_END_PX
    image[10:22, end - SCALE_PX : end] = cv2.applyColorMap(ramp, cv2.COLORMAP_VIRIDIS)[:, 0, ::-1]
    write_title(image, f"{full_scale / np.linalg.norm(box[1] - box[0]):.1g}", end + 8)
    return image


def add_title(image: ColorImage, title: str) -> ColorImage:
    """Add a title bar above an image."""
    head = np.full((HEAD_PX, image.shape[1], 3), PAPER, np.uint8)
    write_title(head, title, 10)
    return np.vstack([head, image])


def write_title(image: ColorImage, text: str, left: int) -> None:
    """Write text into an image's title bar, in place."""
    cv2.putText(image, text, (left, 21), cv2.FONT_HERSHEY_SIMPLEX, 0.55, INK, 1, cv2.LINE_AA)
