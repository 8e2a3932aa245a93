"""What is known of a texture's texels, as images beside it.

photo-1.png   16 bits: the number of the photo that counts most at a texel of image 1; 0 for none
count-1.png   8 bits: how many photos count there
photos.json   the frames' names by number, and the texel's size in metres
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from stages.files.image_bytes import encoded_gray_png
from stages.texturing.texture import Textured


def write_maps(folder: Path, textured: Textured) -> None:
    """Write the maps into a folder."""
    for number, (labels, counts) in enumerate(zip(textured.labels, textured.counts, strict=True), 1):
        (folder / f"photo-{number}.png").write_bytes(encoded_gray_png((labels + 1).astype(np.uint16)))
        (folder / f"count-{number}.png").write_bytes(encoded_gray_png(counts))
    document = {
        "photos": {str(number): name for number, name in enumerate(textured.photos, 1)},
        "texel_size_m": textured.texel_size,
    }
    (folder / "photos.json").write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
