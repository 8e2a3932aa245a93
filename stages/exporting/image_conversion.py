"""Conversion of a mesh's texture images to another format or size."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from scanloom.stages._opencv import require_opencv
from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.diagnostic import Severity
from scanloom.stages.diagnostics.errors import MeshError
from scanloom.stages.exporting.codes import EXPORT_IMAGE_AS_PNG
from scanloom.stages.files.image_bytes import encode_image
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.texture import Image

IMAGE_FORMATS = ("keep", "jpeg", "webp", "png")
_SUFFIX = {"jpeg": ".jpg", "webp": ".webp", "png": ".png"}
_MIME = {"jpeg": "image/jpeg", "webp": "image/webp", "png": "image/png"}


def convert_images(mesh: Mesh, image_format: str, quality: int, max_size: int) -> Mesh:
    """Return the mesh with its texture images re-encoded and downsized.

    An image that already has the format and is small enough is kept byte for byte. An image that cannot be
    decoded is kept, with a warning. A transparent image becomes PNG instead of JPEG.

    Parameters
    ----------
    image_format : target format, one of FORMATS.
    quality : JPEG and WebP quality, 1 to 100.
    max_size : maximum length of the longer side in pixels; larger images are downsampled.
    """
    if mesh.texture is None:
        return mesh
    made = {
        id(image): _convert_image(image, image_format, quality, max_size) for image in mesh.texture.images
    }
    materials = tuple(
        material if material.image is None else replace(material, image=made[id(material.image)])
        for material in mesh.texture.materials
    )
    if all(new.image is old.image for new, old in zip(materials, mesh.texture.materials, strict=True)):
        return mesh
    return mesh.with_(texture=replace(mesh.texture, materials=materials))


def _convert_image(image: Image, image_format: str, quality: int, max_size: int) -> Image:
    has_format = image_format == "keep" or image.mime == _MIME[image_format]
    try:
        pixels = image.pixels
    except MeshError as error:
        emit(replace(error.diagnostic, severity=Severity.WARNING))
        return image
    longest = max(pixels.shape[:2])
    if has_format and longest <= max_size:
        return image
    if image_format == "keep":
        image_format = next((name for name, mime in _MIME.items() if image.mime == mime), "png")
    if longest > max_size:
        pixels = _downsample(pixels, max_size / longest)
    if pixels.shape[2] == 4 and image_format == "jpeg":
        if (pixels[:, :, 3] < 255).any():
            emit(
                EXPORT_IMAGE_AS_PNG.info(
                    "the image {name} is transparent: it is stored as PNG, because JPEG has no transparency",
                    name=image.name or "without a name",
                )
            )
            image_format = "png"
        else:
            pixels = pixels[:, :, :3]
    stem = image.name.rpartition(".")[0] or image.name
    return Image(stem + _SUFFIX[image_format] if stem else "", encode_image(pixels, image_format, quality))


def _downsample(pixels: np.ndarray, scale: float) -> np.ndarray:
    require_opencv()
    import cv2

    height, width = (max(1, round(size * scale)) for size in pixels.shape[:2])
    return np.asarray(cv2.resize(pixels, (width, height), interpolation=cv2.INTER_AREA), np.uint8)
