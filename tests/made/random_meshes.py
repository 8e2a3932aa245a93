"""Random meshes with any combination of attributes, for round trips."""

from __future__ import annotations

from typing import Any

import numpy as np
from hypothesis import strategies as st

from scanloom.stages.files.image_bytes import encode_png
from scanloom.stages.surface.mesh import Image, Material, Mesh, Texture

# Kinds of texture, named by the images of their materials.
TEXTURES = (
    "none",
    "one image",
    "two images",
    "image and untextured part",
    "shared image",
    "colours alone",
    "image file",
)


def random_image(rng: np.random.Generator, channels: int = 3) -> Image:
    """Make an image of noise, 5 rows of 7 pixels."""
    return Image(given=rng.integers(0, 256, (5, 7, channels)).astype(np.uint8))


def random_texture(rng: np.random.Generator, triangles: int, kind: str) -> Texture | None:
    """Make a texture of one of TEXTURES with random coordinates."""
    if kind == "none":
        return None
    image = random_image(rng)
    png = Image("noise.png", encode_png(image.pixels))
    materials = {
        "one image": (Material(image=image),),
        "two images": (Material(image=image), Material(image=random_image(rng, 4))),
        "image and untextured part": (Material(image=image),),
        "shared image": (Material(image=image), Material(image=image, base_color=(0.2, 0.6, 1.0, 1.0))),
        "colours alone": (
            Material(base_color=(1.0, 0.4, 0.2, 1.0)),
            Material(base_color=(0.0, 0.2, 0.4, 1.0)),
        ),
        "image file": (Material(image=png), Material()),
    }[kind]
    low = -1 if kind == "image and untextured part" else 0
    ids = rng.integers(low, len(materials), triangles).astype(np.int32)
    # Few different values, so that some corners of a vertex share a coordinate and others do not.
    return Texture(rng.integers(1, 4, (triangles, 3, 2)) / 4, ids, materials)


def random_directions(rng: np.random.Generator, *shape: int) -> Any:
    """Draw unit vectors (*shape, 3)."""
    vectors = rng.normal(size=(*shape, 3))
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


@st.composite
def varied_meshes(draw: st.DrawFn) -> Mesh:
    """Draw a mesh of 1 to 20 triangles, which may overlap and leave vertices unused."""
    rng = np.random.default_rng(draw(st.integers(0, 1 << 16)))
    vertices, triangles = draw(st.integers(3, 12)), draw(st.integers(1, 20))
    has_parts = draw(st.booleans())
    return Mesh(
        vertices=rng.normal(size=(vertices, 3)) * 10.0 ** draw(st.integers(-3, 3)),
        triangles=np.array([rng.permutation(vertices)[:3] for _ in range(triangles)], np.int32),
        colors=rng.integers(0, 256, (vertices, 3)).astype(np.uint8) if draw(st.booleans()) else None,
        normals=random_directions(rng, vertices) if draw(st.booleans()) else None,
        texture=random_texture(rng, triangles, draw(st.sampled_from(TEXTURES))),
        corner_normals=random_directions(rng, triangles, 3) if draw(st.booleans()) else None,
        part_ids=rng.integers(-1, 2, triangles).astype(np.int32) if has_parts else None,
        part_names=("lid", "pot") if has_parts else (),
        up=draw(st.sampled_from([None, (0.0, 0.0, 1.0), (0.0, 0.6, 0.8)])),
    )
