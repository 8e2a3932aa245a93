"""File formats of baked images, and encoding within a byte limit."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scanloom.stages._opencv import require_opencv
from scanloom.stages.files.image_bytes import encode_image, encode_png
from scanloom.stages.files.image_headers import detect_image_type
from scanloom.stages.surface.texture import Image

Pixels = NDArray[np.uint8]

# Luminance table of JPEG at quality 50 (ITU-T T.81, table K.1), which the IJG library scales.
_LUMINANCE = (
    *(16, 11, 10, 16, 24, 40, 51, 61, 12, 12, 14, 19, 26, 58, 60, 55),
    *(14, 13, 16, 24, 40, 57, 69, 56, 14, 17, 22, 29, 51, 87, 80, 62),
    *(18, 22, 37, 56, 68, 109, 103, 77, 24, 35, 55, 64, 81, 104, 113, 92),
    *(49, 64, 78, 87, 103, 121, 120, 101, 72, 92, 95, 98, 112, 100, 103, 99),
)
# JPEG quality if a source does not reveal its own.
_DEFAULT_QUALITY = 90
# Maximum reduction of the quality before the resolution is reduced, its step, and the minimum quality.
_MAX_QUALITY_LOSS, _QUALITY_STEP, _MIN_QUALITY = 9, 3, 40
# Target as a ratio of the byte limit when the resolution is reduced: the file size follows it only roughly.
_TARGET_RATIO = 0.95
_MAX_TRIES = 12
_MIN_SIDE = 4
# Images below this ratio of all bytes keep their resolution, because reducing them saves almost nothing.
_MIN_REDUCED_RATIO = 0.05


@dataclass(frozen=True)
class ImageFormat:
    """Image file format.

    Attributes
    ----------
    kind : "jpeg", "webp" or "png".
    quality : 1 to 100; ignored for PNG.
    is_subsampled : chroma at half the resolution, as in most JPEG files.
    is_lossless : lossless WebP.
    """

    kind: str
    quality: int = _DEFAULT_QUALITY
    is_subsampled: bool = True
    is_lossless: bool = False

    @property
    def extension(self) -> str:
        """File name extension, such as "jpg"."""
        return {"jpeg": "jpg"}.get(self.kind, self.kind)


@dataclass(frozen=True)
class EncodedImage:
    """Encoded image.

    Attributes
    ----------
    data : bytes of the file.
    size : (width, height), texels.
    quality : JPEG or WebP quality; None for PNG.
    """

    data: bytes
    size: tuple[int, int]
    quality: int | None


def choose_format(sources: Sequence[Image], *, has_alpha: bool, is_color: bool = True) -> ImageFormat:
    """Choose the format of an image that replaces others.

    Parameters
    ----------
    sources : images that are replaced.
    has_alpha : the image has an alpha channel, which JPEG cannot store.
    is_color : pixels are colours. Other maps, such as normals, are subsampled only if all sources are.
    """
    kinds = [detect_image_type(image.file_bytes, image.name)[0] for image in sources]
    lossy = [image for image, kind in zip(sources, kinds, strict=True) if kind == ".jpg"]
    webp = [image for image, kind in zip(sources, kinds, strict=True) if kind == ".webp"]
    if webp and len(webp) == len(sources):
        is_lossless = any(b"VP8L" in image.file_bytes[:64] for image in webp)
        return ImageFormat("webp", _DEFAULT_QUALITY, is_lossless=is_lossless)
    if has_alpha or not lossy:
        return ImageFormat("png")
    found = [estimate_jpeg_quality(image.file_bytes) for image in lossy]
    qualities = [quality for quality, _ in found]
    return ImageFormat(
        "jpeg",
        max(qualities),
        is_subsampled=all(subsampled for _, subsampled in found) and (is_color or len(lossy) == len(sources)),
    )


def estimate_jpeg_quality(data: bytes) -> tuple[int, bool]:
    """Estimate the quality (1 to 100) and chroma subsampling of a JPEG file."""
    from PIL import JpegImagePlugin

    try:
        # Opened by class, so that the content cannot choose another decoder. Only the header is read.
        with JpegImagePlugin.JpegImageFile(io.BytesIO(data)) as image:
            tables = getattr(image, "quantization", {})
            layers = getattr(image, "layer", [])
    except (OSError, ValueError, SyntaxError):
        return _DEFAULT_QUALITY, True
    is_subsampled = len(layers) > 1 and tuple(layers[0][1:3]) != tuple(layers[1][1:3])
    if not tables:
        return _DEFAULT_QUALITY, is_subsampled
    # The sum does not depend on the order of the table (zigzag or rows).
    total = sum(tables[min(tables)])
    return min(range(1, 101), key=lambda quality: abs(_sum_luminance_table(quality) - total)), is_subsampled


def _sum_luminance_table(quality: int) -> int:
    """Sum the luminance table of the IJG library at a quality."""
    scale = 5000 // quality if quality < 50 else 200 - 2 * quality
    return sum(min(max((value * scale + 50) // 100, 1), 255) for value in _LUMINANCE)


def encode(pixels: Pixels, form: ImageFormat, *, is_thorough: bool = False) -> bytes:
    """Encode an RGB or RGBA image; `is_thorough` makes PNG files smaller but slower."""
    if form.kind == "png":
        return _compress_png(pixels) if is_thorough else encode_png(pixels)
    if form.kind == "jpeg" and not form.is_subsampled:
        return encode_image(pixels, "jpeg", form.quality)
    from PIL import Image as PillowImage

    file = io.BytesIO()
    if form.kind == "jpeg":
        PillowImage.fromarray(pixels[..., :3]).save(
            file, "JPEG", quality=form.quality, subsampling=2, optimize=True
        )
    else:
        PillowImage.fromarray(pixels).save(file, "WEBP", quality=form.quality, lossless=form.is_lossless)
    return file.getvalue()


def _compress_png(pixels: Pixels) -> bytes:
    import cv2

    code = cv2.COLOR_RGBA2BGRA if pixels.shape[2] == 4 else cv2.COLOR_RGB2BGR
    _, data = cv2.imencode(".png", cv2.cvtColor(pixels, code), [cv2.IMWRITE_PNG_COMPRESSION, 6])
    return data.tobytes()


def encode_within(
    images: Sequence[tuple[Pixels, ImageFormat]], max_bytes: float
) -> tuple[list[EncodedImage], float]:
    """Encode images within a common byte limit.

    PNG files are compressed better first. Then the quality of lossy images is reduced a little. Then the
    resolution of all images that are a considerable part of the bytes is reduced.

    Parameters
    ----------
    images : pixels and format of each image.
    max_bytes : limit of all files together.

    Returns
    -------
    images : list of EncodedImage, in the same order.
    scale : side length relative to the input pixels, at most 1.
    """
    shown = [pixels for pixels, _ in images]
    forms = [form for _, form in images]
    data = [encode(pixels, form) for pixels, form in images]
    scale, loss = 1.0, 0

    def count_bytes() -> int:
        return sum(map(len, data))

    if count_bytes() > max_bytes:
        data = [
            min(old, encode(pixels, form, is_thorough=True), key=len) if form.kind == "png" else old
            for old, (pixels, form) in zip(data, images, strict=True)
        ]
    for _ in range(_MAX_TRIES):
        if count_bytes() <= max_bytes:
            break
        if any(map(_is_lossy, forms)) and loss < _MAX_QUALITY_LOSS:
            loss += _QUALITY_STEP
            forms = [
                replace(form, quality=max(form.quality - loss, min(form.quality, _MIN_QUALITY)))
                for _, form in images
            ]
            changed = [k for k, form in enumerate(forms) if _is_lossy(form)]
        else:
            scale *= min((_TARGET_RATIO * max_bytes / count_bytes()) ** 0.5, 0.97)
            changed = [k for k, one in enumerate(data) if len(one) >= _MIN_REDUCED_RATIO * count_bytes()]
            for k in changed:
                height, width = images[k][0].shape[:2]
                size = max(round(scale * width), _MIN_SIDE), max(round(scale * height), _MIN_SIDE)
                shown[k] = resize_image(images[k][0], (min(size[0], width), min(size[1], height)))
        for k in changed:
            data[k] = encode(shown[k], forms[k], is_thorough=True)
    return [
        EncodedImage(one, (pixels.shape[1], pixels.shape[0]), None if form.kind == "png" else form.quality)
        for one, pixels, form in zip(data, shown, forms, strict=True)
    ], scale


def _is_lossy(form: ImageFormat) -> bool:
    return form.kind != "png" and not form.is_lossless


def resize_image(pixels: Pixels, size: tuple[int, int]) -> Pixels:
    """Resize an image to (width, height) by area averaging."""
    require_opencv()
    import cv2

    if size == (pixels.shape[1], pixels.shape[0]):
        return pixels
    found: NDArray[np.uint8] = np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), np.uint8)
    return found.reshape(size[1], size[0], -1)
