"""Conversion of a mesh's texture images to another format or size."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from scanloom.stages._opencv import require_opencv
from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.diagnostic import Severity
from scanloom.stages.diagnostics.errors import MeshError
from scanloom.stages.exporting.codes import EXPORT_IMAGE_AS_PNG, EXPORT_IMAGE_REDUCED
from scanloom.stages.files.image_bytes import encode_image
from scanloom.stages.files.ktx2 import (
    KTX2_MIME,
    KTX2_SUFFIX,
    MAX_ENCODED_TEXELS,
    SIDE_MULTIPLE,
    encode_ktx2,
)
from scanloom.stages.surface.formats.gltf_materials import ImageEncoder
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.texture import Image

IMAGE_FORMATS = ("keep", "jpeg", "webp", "png", "ktx2")
_SUFFIX = {"jpeg": ".jpg", "webp": ".webp", "png": ".png"}
_MIME = {"jpeg": "image/jpeg", "webp": "image/webp", "png": "image/png"}


def convert_images(mesh: Mesh, image_format: str, quality: int, max_size: int) -> Mesh:
    """Return the mesh with its texture images re-encoded and downsized.

    An image that already has the format and is small enough is kept byte for byte. An image that cannot be
    decoded is kept, with a warning. A transparent image becomes PNG instead of JPEG. For KTX2, images are
    downsized only: their encoding depends on their use, so `make_ktx2_encoder` encodes them while a file is
    written.

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
    has_format = image_format in ("keep", "ktx2") or image.mime == _MIME[image_format]
    try:
        pixels = image.pixels
    except MeshError as error:
        emit(replace(error.diagnostic, severity=Severity.WARNING))
        return image
    longest = max(pixels.shape[:2])
    if has_format and longest <= max_size:
        return image
    if image_format == "ktx2":
        return Image(image.name, given=_downsample(pixels, max_size / longest))
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


def make_ktx2_encoder(quality: int, max_size: int) -> ImageEncoder:
    """Return the function that encodes the images of a glTF file as KTX2.

    Sides become multiples of four texels, as KHR_texture_basisu requires. An image that cannot be decoded is
    kept, with a warning.

    Parameters
    ----------
    quality : 1 to 100, for colours.
    max_size : maximum length of the longer side in pixels; larger images are downsampled.
    """

    def encode(image: Image, kind: str) -> Image:
        if image.mime == KTX2_MIME and max(image.size or (0, 0)) <= max_size:
            return image
        try:
            pixels = image.pixels
        except MeshError as error:
            emit(replace(error.diagnostic, severity=Severity.WARNING))
            return image
        pixels = _fit_to_blocks(pixels, max_size, image.name)
        stem = image.name.rpartition(".")[0] or image.name
        return Image(stem + KTX2_SUFFIX if stem else "", encode_ktx2(pixels, kind, quality))

    return encode


def _fit_to_blocks(pixels: np.ndarray, max_size: int, name: str) -> np.ndarray:
    """Resize an image to sides that are multiples of a block, within the limits of size and encoder."""
    height, width = pixels.shape[:2]
    scale = min(1.0, max_size / max(height, width))
    if (max_scale := (MAX_ENCODED_TEXELS / (height * width)) ** 0.5) < scale:
        scale = max_scale
        emit(
            EXPORT_IMAGE_REDUCED.warning(
                "the image {name} of {width} × {height} texels is downsampled, because the KTX2 encoder "
                "accepts at most {max_texels:,}",
                remedy="use `webp` or a smaller `image_size`.",
                name=name or "without a name",
                width=width,
                height=height,
                max_texels=MAX_ENCODED_TEXELS,
            )
        )
    # Rounded down, so that the limits hold.
    rows, columns = (
        max(SIDE_MULTIPLE, int(size * scale) // SIDE_MULTIPLE * SIDE_MULTIPLE) for size in (height, width)
    )
    return pixels if (rows, columns) == (height, width) else _resize(pixels, rows, columns)


def _downsample(pixels: np.ndarray, scale: float) -> np.ndarray:
    height, width = (max(1, round(size * scale)) for size in pixels.shape[:2])
    return _resize(pixels, height, width)


def _resize(pixels: np.ndarray, height: int, width: int) -> np.ndarray:
    require_opencv()
    import cv2

    return np.asarray(cv2.resize(pixels, (width, height), interpolation=cv2.INTER_AREA), np.uint8)
