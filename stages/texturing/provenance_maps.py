"""Per-texel provenance maps of a texture, as image files.

photo-1.png      16 bits: number of the photo with the highest weight at a texel of image 1; 0 for none
count-1.png      8 bits: number of photos that are blended
obliquity-1.png  8 bits: angle between surface normal and direction to that photo, degrees; 255 for none
texel-1.png      16 bits: width of the texel on the surface in micrometres, at most 65,535; 0 for none
photos.json      frame names by photo number, and the median texel size in metres
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import _kernels
from scanloom.stages.files.image_bytes import encode_gray_png
from scanloom.stages.scans.model.prefetch import get_worker_count, map_ordered
from scanloom.stages.surface.memory_release import release_free_memory
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import compute_triangle_normals
from scanloom.stages.surface.texture import Texture, compute_signed_areas
from scanloom.stages.surface.topology import compute_areas
from scanloom.stages.texturing.texture import TextureResult

_NO_PHOTO = 255
# Texels measured at a time by all threads, at some hundred bytes each: bounds memory.
_BATCH_TEXELS = 1_000_000


def write_maps(folder: Path, textured: TextureResult) -> None:
    """Write the provenance maps and `photos.json` into a folder."""
    mesh, texture = textured.mesh, textured.mesh.texture
    assert texture is not None
    for number, (labels, counts) in enumerate(zip(textured.labels, textured.photo_counts, strict=True)):
        # Painting and the previous image have left fragmented free memory.
        release_free_memory()
        obliquity, width = _measure_texels(mesh, texture, number, labels, textured.camera_centers)
        maps: dict[str, NDArray[np.uint8] | NDArray[np.uint16]] = {
            "photo": (labels + 1).astype(np.uint16),
            "count": counts,
            "obliquity": obliquity,
            "texel": width,
        }
        files = map_ordered(
            encode_gray_png, maps.values(), threads=get_worker_count(), max_pending=get_worker_count()
        )
        for name, data in zip(maps, files, strict=True):
            (folder / f"{name}-{number + 1}.png").write_bytes(data)
    document = {
        "photos": {str(number): name for number, name in enumerate(textured.photos, 1)},
        "texel_size_m": textured.texel_size,
    }
    (folder / "photos.json").write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8", newline="\n")


def _measure_texels(
    mesh: Mesh, texture: Texture, number: int, labels: NDArray[np.int32], camera_centers: NDArray[np.float64]
) -> tuple[NDArray[np.uint8], NDArray[np.uint16]]:
    """Measure the viewing angle and the width of each texel of an image.

    Returns
    -------
    Angles (h, w) uint8 in degrees, 255 without a photo; widths (h, w) uint16 in micrometres, 0 without
    surface.
    """
    height, width = labels.shape
    corners = (texture.uvs - (0, 1)) * (width, -height)
    pages = np.where(texture.material_ids == number, 0, -1).astype(np.int32)
    pixels, triangles, shares = _kernels.rasterize_texels(corners, pages, page=0, width=width, height=height)
    normals = compute_triangle_normals(mesh)
    of_triangles = [mesh.vertices[:, axis][mesh.triangles] for axis in range(3)]
    obliquity = np.full(labels.size, _NO_PHOTO, np.uint8)

    def compute_angles(part: slice) -> tuple[NDArray[np.uint32], NDArray[np.uint8]]:
        label = labels.reshape(-1)[pixels[part]]
        shown = label >= 0
        triangle_ids, label, weights = triangles[part][shown], label[shown], shares[part][shown]
        # One axis at a time: NumPy is slow over a last axis of length three.
        projections, squared_distances = np.zeros(len(triangle_ids)), np.zeros(len(triangle_ids))
        for axis, corner in enumerate(of_triangles):
            to_camera = camera_centers[label, axis] - sum(
                weights[:, k] * corner[triangle_ids, k] for k in range(3)
            )
            projections += to_camera * normals[triangle_ids, axis]
            squared_distances += to_camera**2
        cosines = projections / np.maximum(np.sqrt(squared_distances), 1e-12)
        degrees = np.degrees(np.arccos(cosines.clip(0, 1)))
        return pixels[part][shown], np.rint(degrees).astype(np.uint8)

    threads = get_worker_count()
    step = _BATCH_TEXELS // threads
    parts = [slice(start, start + step) for start in range(0, len(pixels), step)]
    for at, degrees in map_ordered(compute_angles, parts, threads=threads, max_pending=threads):
        obliquity[at] = degrees
    texel_areas = np.abs(compute_signed_areas(corners))
    widths_um = 1e6 * np.sqrt(compute_areas(mesh.vertices, mesh.triangles) / np.maximum(texel_areas, 1e-12))
    sizes = np.zeros(labels.size, np.uint16)
    sizes[pixels] = np.rint(widths_um.clip(1, 65_535)).astype(np.uint16)[triangles]
    return obliquity.reshape(labels.shape), sizes.reshape(labels.shape)
