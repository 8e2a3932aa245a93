"""Pack models into a page of at most so many bytes: photos are left out and models made lighter for it."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from stages.exporting.export import export
from stages.exporting.presets import preset
from stages.files.opening import content_of
from stages.picturing.page.one_file import PageCamera, PageModel, PageScale, one_file
from stages.picturing.page.standing import facing
from stages.simplification.simplify import simplify
from stages.surface.mesh import Mesh
from stages.surface.upright import turn_along_z

# Told what a person should know, in a sentence.
Warn = Callable[[str], None]

# What the models of a page are made smaller by, until it is small enough.
_HALVINGS = 6
_LEAST_TRIANGLES = 2_000
# The first model is what a page is for, and is made lighter last; those beside it have at most so many.
_MOST_BESIDE = 150_000
_LAST = 2
# Of the page, photos may take one part of so many.
_PHOTOS_SHARE = 4


class Shown(NamedTuple):
    """A model of a page before it is packed; see `PageModel`."""

    mesh: Mesh
    note: str = ""
    scale: PageScale | None = None


# By their names, the most important first.
Models = Mapping[str, Shown]


def packed_page(
    title: str,
    models: Models,
    most_bytes: int,
    warn: Warn,
    told: Mapping[str, Any] | None = None,
    cameras: Sequence[PageCamera] = (),
) -> bytes:
    """Return a page of at most `most_bytes`, if it can be; what that takes is told in it, and warned of.

    Parameters
    ----------
    title, told, cameras : see `one_file`.
    models : in one place and one stand.
    """
    cameras, photos = _with_photos_within(cameras, most_bytes // _PHOTOS_SHARE)
    if photos:
        warn(f"{photos} of the photos are left out of the page, which may take {most_bytes:,} bytes.")
    page = b""
    for halvings in range(_HALVINGS):
        page = one_file(title, list(_packed(models, halvings)), told, cameras)
        if len(page) <= most_bytes:
            return page
    warn(f"the page takes {len(page):,} bytes, more than {most_bytes:,}, as small as it gets.")
    return page


def turn_of_page(mesh: Mesh) -> NDArray[np.float64]:
    """Return what turns a mesh z up, as the page's camera has it; unknown, it stands as glTF has it, y up."""
    return turn_along_z(np.array((0.0, 1.0, 0.0) if mesh.up is None else mesh.up))


def _with_photos_within(cameras: Sequence[PageCamera], most: int) -> tuple[list[PageCamera], int]:
    """Return cameras without every other photo, as often as it takes, and how many photos that leaves out."""
    sizes = [0 if camera.photo is None else len(camera.photo) for camera in cameras]
    kept = [number for number, size in enumerate(sizes) if size]
    count = len(kept)
    while sum(sizes[number] for number in kept) > most:
        kept = kept[1::2]
    chosen = set(kept)
    thinned = [
        camera if number in chosen else replace(camera, photo=None) for number, camera in enumerate(cameras)
    ]
    return thinned, count - len(kept)


def _packed(models: Models, halvings: int) -> Iterator[PageModel]:
    """Give the models as files, with fewer triangles and smaller images the more often they are halved."""
    with tempfile.TemporaryDirectory(prefix="scanloom-") as folder:
        for number, (name, (mesh, note, scale)) in enumerate(models.items()):
            light, words = mesh, note
            count = len(mesh.triangles)
            halved = (
                count >> max(halvings - _LAST, 0) if number == 0 else min(count, _MOST_BESIDE) >> halvings
            )
            target = max(halved, _LEAST_TRIANGLES)
            if count > target:
                light = simplify(mesh, triangles=target).mesh.with_(up=mesh.up)
                words = ", ".join(filter(None, (note, f"of {count:,}, for this page")))
            path = Path(folder) / "model.glb"
            web = preset("web")
            size = max(web.image_size >> max(halvings - _LAST, 0), 512)
            export(light, path, web, image_size=size)
            look = facing(light, turn_of_page(mesh))
            yield PageModel(name, content_of(path), len(light.triangles), words, look, scale)
