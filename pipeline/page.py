"""What the page of a mesh file, or of a run's output folder, shows and tells."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import stages
from pipeline.page_told import at, deviation_tables, told_of
from pipeline.photos import FILE as CAMERAS
from pipeline.results import REPORT
from stages import Mesh
from stages.comparing.palette import colors_of
from stages.errors import InputError
from stages.files.documents import read_json, require_inside
from stages.files.opening import content_of
from stages.picturing.page.one_file import PageCamera, PageModel, PageScale, one_file
from stages.picturing.page.standing import facing
from stages.surface.upright import turn_along_z

# Told what a person should know, in a sentence.
Warn = Callable[[str], None]

_RESULTS = ("textured.glb", "simplified.glb", "simplified.ply")
# What the models of a page are made smaller by, until it is small enough.
_HALVINGS = 6
_LEAST_TRIANGLES = 2_000
# The first model is what a page is for, and is made lighter last; those beside it have at most so many.
_MOST_BESIDE = 150_000
_LAST = 2
_SAMPLES = 100_000
# Of the page, photos may take one part of so many.
_PHOTOS_SHARE = 4
_JPEG = b"\xff\xd8\xff"
# Of the scale of deviations.
_STEPS = 40
# How far from a place the camera flies to, as a share of the model's size.
_NEAR = 0.25


def page_of_mesh(name: str, mesh: Mesh, most_bytes: int, warn: Warn) -> bytes:
    """Return the page of a mesh, of so many bytes at most, if it can be."""
    return _fitted(name, {name: Shown(mesh)}, {}, [], most_bytes, warn)


def page_of_run(folder: Path, most_bytes: int, warn: Warn) -> bytes:
    """Return the page of the output folder of a run, of so many bytes at most, if it can be.

    Raises
    ------
    InputError
        If it holds no result, or files that are not as runs write them.
    """
    name = next((name for name in _RESULTS if (folder / name).is_file()), None)
    if name is None:
        known = ", ".join(_RESULTS)
        raise InputError(f"holds none of {known}, nor tiles; give a mesh file, or the OUT of a run.", folder)
    result = standing(folder / name, _read(folder / name, warn))
    report, told = _reported(folder / REPORT)
    models: Models = {"result": Shown(result, name)}
    if (folder / "clean.ply").is_file():
        clean = _read(folder / "clean.ply", warn).with_(up=result.up)
        bound = at(report, "stages", "simplify", "params", "simplify", "max_shape")
        found = stages.deviations(clean, result, tolerance=bound, signed_samples=_SAMPLES)
        figures = found.figures()
        models["clean mesh"] = Shown(clean, "before simplification")
        models["deviation"] = Shown(found.painted, _range_in_words(figures), _scale(found))
        proven = at(report, "stages", "simplify", "figures", "details", "shape_bound_m")
        turn, away = _turn(result), _NEAR * float(np.linalg.norm(np.ptp(result.vertices, axis=0)))
        places = [
            {"target": (turn @ np.array(one["point_m"])).tolist(), "away": away} for one in figures["worst"]
        ]
        told["tables"] = [*deviation_tables(figures, proven, places), *told.get("tables", ())]
    cameras = _cameras(folder / "pictures", result)
    return _fitted(folder.resolve().name, models, told, cameras, most_bytes, warn)


def standing(path: Path, mesh: Mesh) -> Mesh:
    """Return a mesh with what is up, where its format says it."""
    if mesh.up is None and path.suffix.lower() in (".glb", ".gltf"):
        return mesh.with_(up=(0.0, 1.0, 0.0))
    return mesh


class Shown(NamedTuple):
    """A model of a page before it is packed; see `PageModel`."""

    mesh: Mesh
    note: str = ""
    scale: PageScale | None = None


Models = dict[str, Shown]


def _read(path: Path, warn: Warn) -> Mesh:
    mesh = stages.read_mesh(path)
    for note in mesh.notes:
        warn(f"{path}: {note}")
    return mesh


def _reported(path: Path) -> tuple[Mapping[str, Any], dict[str, Any]]:
    """Return report.json, and what the page tells of it."""
    if not path.is_file():
        return {}, {}
    with _as_runs_write(path):
        report = dict(read_json(path))  # type: ignore[call-overload]
        return report, told_of(report)


@contextmanager
def _as_runs_write(path: Path) -> Iterator[None]:
    """Say it in one sentence where a file does not hold what a run writes into it."""
    try:
        yield
    except (LookupError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise InputError("this is not as a run writes it; run once more, or move it away.", path) from error


def _fitted(
    title: str,
    models: Models,
    told: Mapping[str, Any],
    cameras: Sequence[PageCamera],
    most_bytes: int,
    warn: Warn,
) -> bytes:
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
                light = stages.simplify(mesh, triangles=target).mesh.with_(up=mesh.up)
                words = ", ".join(filter(None, (note, f"of {count:,}, for this page")))
            path = Path(folder) / "model.glb"
            # A page is looked at closely, and has room for it.
            web = replace(stages.preset("web"), position_bits=16, texel_steps=0, quality=85)
            size = max(web.image_size >> max(halvings - _LAST, 0), 512)
            stages.export(light, path, web, image_size=size)
            look = facing(light, _turn(mesh))
            yield PageModel(name, content_of(path), len(light.triangles), words, look, scale)


def _turn(mesh: Mesh) -> NDArray[np.float64]:
    """Return what turns a mesh z up, as the page's camera has it; unknown, it stands as glTF has it, y up."""
    return turn_along_z(np.array((0.0, 1.0, 0.0) if mesh.up is None else mesh.up))


def _range_in_words(told: Mapping[str, Any]) -> str:
    return "red outside, blue inside; green is near" if told["is_signed"] else "red far, green near"


def _scale(found: stages.Deviations) -> PageScale:
    most = found.color_range
    low = -most if found.is_signed else 0.0
    edges = np.linspace(low, most, _STEPS + 1)
    colors = colors_of((edges[1:] + edges[:-1]) / 2, found.within, most)
    # What lies beyond the scale has its last colours.
    shares = np.histogram(found.samples.clip(low, most), edges)[0] / len(found.samples)
    css = [f"rgb({r}, {g}, {b})" for r, g, b in colors.tolist()]
    return PageScale("mm", 1000 * low, 1000 * most, 1000 * found.within, css, shares.round(5).tolist())


def _cameras(folder: Path, mesh: Mesh) -> list[PageCamera]:
    """Return the cameras of the scan that a run has told of, standing as the models do."""
    path = folder / CAMERAS
    if not path.is_file():
        return []
    turn = _turn(mesh)
    with _as_runs_write(path):
        told: Any = read_json(path)
        return [_camera(one, path, turn) for one in told["cameras"] if "fx" in one]


def _camera(one: Mapping[str, Any], path: Path, turn: NDArray[np.float64]) -> PageCamera:
    pose = turn @ np.array(one["world_from_camera"], np.float64).reshape(4, 4)[:3]
    size = [int(one["size"][0]), int(one["size"][1])]
    focal, center = [float(one["fx"]), float(one["fy"])], [float(one["cx"]), float(one["cy"])]
    if not (np.isfinite(pose).all() and np.isfinite([*focal, *center]).all() and min(*size, *focal) > 0):
        raise ValueError(one)
    photo = None if one["photo"] is None else _photo(one["photo"], path)
    return PageCamera(str(one["frame"]), pose.round(6).ravel().tolist(), size, focal, center, photo)


def _photo(name: str, path: Path) -> bytes:
    """Return a photo that cameras.json names; the page is passed on, so nothing else may get into it."""
    photo = path.parent / require_inside(name, path, "photo")
    if not photo.resolve().is_relative_to(path.parent.resolve()):
        raise InputError(f"the photo {name[:100]!r} leads out of the folder.", path)
    if not photo.is_file():
        raise InputError("this photo is missing; run once more.", photo)
    content = content_of(photo)
    if not content.startswith(_JPEG):
        raise InputError("this is not a JPEG file.", photo)
    return content
