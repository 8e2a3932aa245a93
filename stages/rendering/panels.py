"""Side-by-side renderings of several meshes from one viewpoint."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from scanloom.stages.rendering.annotations import (
    ScaleBar,
    choose_scale_bar,
    draw_caption,
    draw_scale_bar,
    find_focus,
)
from scanloom.stages.rendering.render import RenderModel, Shading
from scanloom.stages.rendering.viewpoints import Viewpoint
from scanloom.stages.scans.model.scan import ColorImage
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import RaycastingSurface

# Gap between panels, pixels (even, as video encoders require), and its grey level.
_GAP, _PAPER = 8, 255


class Panels:
    """Meshes prepared for side-by-side rendering from any number of viewpoints.

    Parameters
    ----------
    meshes : one or more, each with at least one triangle.
    texts : caption of each mesh; empty for no caption.
    """

    def __init__(self, meshes: Sequence[Mesh], texts: Sequence[str]) -> None:
        self._models = [RenderModel(RaycastingSurface(mesh)) for mesh in meshes]
        self._texts = texts

    def draw(
        self, viewpoint: Viewpoint, shading: Shading = "color", bar: ScaleBar | None = None
    ) -> ColorImage:
        """Render all meshes from left to right, with captions and scale bar."""
        images: list[ColorImage] = []
        for model, text in zip(self._models, self._texts, strict=True):
            image = model.draw(viewpoint, shading)
            image = draw_caption(image, text) if text else image
            image = image if bar is None else draw_scale_bar(image, bar)
            gap = np.full((image.shape[0], _GAP, 3), _PAPER, np.uint8)
            images += [gap, image] if images else [image]
        return np.ascontiguousarray(np.hstack(images))

    def choose_scale_bar(self, viewpoint: Viewpoint) -> ScaleBar | None:
        """Choose a scale bar for a viewpoint; None if nothing is visible.

        The bar is valid at the viewpoint's focus, or else at the first mesh in the image centre.
        """
        depth = viewpoint.focus or find_focus(self._models[0], viewpoint)
        return None if depth is None else choose_scale_bar(viewpoint, depth)
