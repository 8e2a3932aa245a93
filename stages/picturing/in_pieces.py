"""Rendering of chunked meshes into a common depth buffer."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from scanloom.stages.picturing.render import Model, Picture, Shading, sees
from scanloom.stages.picturing.viewpoints import Viewpoint
from scanloom.stages.scans.model.scan import ColorImage
from scanloom.stages.surface.piecewise import Piecewise
from scanloom.stages.surface.raycasting import Floats, Surface

# Maximum pixels of all images rendered at a time, at about 50 bytes each: bounds memory.
_AT_ONCE = 6_000_000


def draw_in_pieces(
    large: Piecewise, viewpoints: Sequence[Viewpoint], box: Floats, *, shading: Shading = "color"
) -> Iterator[ColorImage]:
    """Render a chunked mesh from several viewpoints, as `Model.draw` does for whole meshes.

    Parameters
    ----------
    large : the chunked mesh.
    viewpoints : one for each image.
    box : (2, 3) bounding box of all meshes to be drawn, metres.
    shading : see `render`.

    Yields
    ------
    (h, w, 3) uint8, one image per viewpoint.

    Raises
    ------
    InputError
        If the file of the chunks is damaged.
    """
    for some in _together(viewpoints):
        pictures = [Picture(viewpoint, shading) for viewpoint in some]
        _add(large, pictures, box)
        for picture in pictures:
            picture.refine()
        _add(large, pictures, box)
        for picture in pictures:
            yield picture.image()


def _add(large: Piecewise, pictures: Sequence[Picture], box: Floats) -> None:
    for piece in large.pieces(facing=True):
        showing = [picture for picture in pictures if sees(picture.viewpoint, piece.box)]
        if showing:
            model = Model(Surface(piece.mesh, box), piece.normals)
            for picture in showing:
                picture.add(model, piece.box)


def _together(viewpoints: Sequence[Viewpoint]) -> Iterator[list[Viewpoint]]:
    """Group viewpoints into batches that fit into memory, at least one in each."""
    some: list[Viewpoint] = []
    pixels = 0
    for viewpoint in viewpoints:
        more = viewpoint.camera.width * viewpoint.camera.height
        if some and pixels + more > _AT_ONCE:
            yield some
            some, pixels = [], 0
        some.append(viewpoint)
        pixels += more
    if some:
        yield some
