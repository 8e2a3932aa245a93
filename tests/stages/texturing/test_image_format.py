from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image as PillowImage
from textured_models import encode_jpeg, encode_png, waves

from scanloom.stages.surface.mesh import Image
from scanloom.stages.texturing.image_format import (
    ImageFormat,
    choose_format,
    encode,
    encode_within,
    estimate_jpeg_quality,
)


@pytest.mark.parametrize("quality", [15, 50, 75, 90, 97])
@pytest.mark.parametrize("subsampling", [0, 2])
def test_the_quality_of_a_jpeg_is_estimated(quality: int, subsampling: int) -> None:
    found, is_subsampled = estimate_jpeg_quality(encode_jpeg(waves(), quality, subsampling).file_bytes)
    assert abs(found - quality) <= 1
    assert is_subsampled == (subsampling == 2)


def test_the_format_is_that_of_the_sources() -> None:
    jpeg, png = encode_jpeg(waves(), 77), encode_png(waves())
    file = io.BytesIO()
    PillowImage.fromarray(waves()).save(file, "WEBP", quality=80)
    webp = Image("a.webp", file.getvalue())
    assert choose_format([jpeg], has_alpha=False).kind == "jpeg"
    assert choose_format([jpeg, png], has_alpha=False).kind == "jpeg"
    assert choose_format([jpeg, png], has_alpha=True).kind == "png"
    assert choose_format([png], has_alpha=False).kind == "png"
    assert choose_format([webp], has_alpha=True).kind == "webp"
    assert choose_format([webp, png], has_alpha=False).kind == "png"


@pytest.mark.parametrize("kind", ["jpeg", "webp", "png"])
def test_images_are_encoded_within_a_byte_limit(kind: str) -> None:
    pixels = np.random.default_rng(0).integers(0, 255, (128, 192, 3)).astype(np.uint8)
    form = ImageFormat(kind, 90)
    whole = len(encode(pixels, form))
    (found,), scale = encode_within([(pixels, form)], whole // 4)
    assert len(found.data) <= whole // 4
    assert scale < 1
    shown = np.asarray(PillowImage.open(io.BytesIO(found.data)))
    assert shown.shape[:2] == found.size[::-1]
    (same,), scale = encode_within([(pixels, form)], whole)
    assert scale == 1
    assert same.quality == (None if kind == "png" else 90)


def test_quality_is_reduced_before_resolution() -> None:
    pixels = waves()
    form = ImageFormat("jpeg", 90)
    whole = len(encode(pixels, form))
    (found,), scale = encode_within([(pixels, form)], int(0.95 * whole))
    assert scale == 1
    assert 80 <= found.quality < 90
