"""Pictures of a mesh in pieces: each is drawn by itself, and of all of them what is nearest is seen."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from scanloom.stages.picturing.render import Model, Picture, Shading, sees
from scanloom.stages.picturing.viewpoints import Viewpoint
from scanloom.stages.scans.model.scan import ColorImage
from scanloom.stages.surface.piecewise import Piecewise
from scanloom.stages.surface.raycasting import Floats, Surface

# Pixels of all pictures that are drawn at a time; they take some 50 bytes each.
_AT_ONCE = 6_000_000


def draw_in_pieces(
    large: Piecewise, viewpoints: Sequence[Viewpoint], box: Floats, *, shading: Shading = "color"
) -> Iterator[ColorImage]:
    """Draw a mesh in pieces from viewpoints, one picture after the other, as `Model.draw` does a whole one.

    Parameters
    ----------
    box : (2, 3) around all meshes that are drawn.

    Raises
    ------
    InputError
        If the file of the pieces is damaged.
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
    """Yield viewpoints, as many at a time as there is memory for, one at least."""
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
