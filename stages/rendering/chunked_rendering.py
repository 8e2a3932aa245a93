"""Rendering of chunked meshes into a common depth buffer."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from scanloom.stages.rendering.render import RenderedPicture, RenderModel, Shading, is_box_visible
from scanloom.stages.rendering.viewpoints import Viewpoint
from scanloom.stages.scans.model.scan import ColorImage
from scanloom.stages.surface.chunked_mesh import ChunkedMesh
from scanloom.stages.surface.raycasting import Floats, RaycastingSurface

# Maximum pixels of all images rendered at a time, at about 50 bytes each: bounds memory.
_BATCH_PIXELS = 6_000_000


def draw_chunked(
    chunked_mesh: ChunkedMesh, viewpoints: Sequence[Viewpoint], box: Floats, *, shading: Shading = "color"
) -> Iterator[ColorImage]:
    """Render a chunked mesh from several viewpoints, as `RenderModel.draw` does for whole meshes.

    Parameters
    ----------
    chunked_mesh : the chunked mesh.
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
    for batch in _group_viewpoints(viewpoints):
        pictures = [RenderedPicture(viewpoint, shading) for viewpoint in batch]
        _add_chunks(chunked_mesh, pictures, box)
        for picture in pictures:
            picture.refine()
        _add_chunks(chunked_mesh, pictures, box)
        for picture in pictures:
            yield picture.image()


def _add_chunks(chunked_mesh: ChunkedMesh, pictures: Sequence[RenderedPicture], box: Floats) -> None:
    for piece in chunked_mesh.iterate_batches(with_normals=True):
        showing = [picture for picture in pictures if is_box_visible(picture.viewpoint, piece.box)]
        if showing:
            model = RenderModel(RaycastingSurface(piece.mesh, box), piece.normals)
            for picture in showing:
                picture.add(model, piece.box)


def _group_viewpoints(viewpoints: Sequence[Viewpoint]) -> Iterator[list[Viewpoint]]:
    """Group viewpoints into batches that fit into memory, at least one in each."""
    batch: list[Viewpoint] = []
    pixels = 0
    for viewpoint in viewpoints:
        pixel_count = viewpoint.camera.width * viewpoint.camera.height
        if batch and pixels + pixel_count > _BATCH_PIXELS:
            yield batch
            batch, pixels = [], 0
        batch.append(viewpoint)
        pixels += pixel_count
    if batch:
        yield batch
