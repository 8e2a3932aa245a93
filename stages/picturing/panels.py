"""Side-by-side renderings of several meshes from one viewpoint."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from scanloom.stages.picturing.lettering import ScaleBar, focus_of, scale_bar, with_scale_bar, with_words
from scanloom.stages.picturing.render import Model, Shading
from scanloom.stages.picturing.viewpoints import Viewpoint
from scanloom.stages.scans.model.scan import ColorImage
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import Surface

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
        self._models = [Model(Surface(mesh)) for mesh in meshes]
        self._texts = texts

    def draw(
        self, viewpoint: Viewpoint, shading: Shading = "color", bar: ScaleBar | None = None
    ) -> ColorImage:
        """Render all meshes from left to right, with captions and scale bar."""
        images: list[ColorImage] = []
        for model, text in zip(self._models, self._texts, strict=True):
            image = model.draw(viewpoint, shading)
            image = with_words(image, text) if text else image
            image = image if bar is None else with_scale_bar(image, bar)
            gap = np.full((image.shape[0], _GAP, 3), _PAPER, np.uint8)
            images += [gap, image] if images else [image]
        return np.ascontiguousarray(np.hstack(images))

    def scale_bar(self, viewpoint: Viewpoint) -> ScaleBar | None:
        """Choose a scale bar for a viewpoint; None if nothing is visible.

        The bar is valid at the viewpoint's focus, or else at the first mesh in the image centre.
        """
        depth = viewpoint.focus or focus_of(self._models[0], viewpoint)
        return None if depth is None else scale_bar(viewpoint, depth)
