"""What the page of a mesh file, or of a run's output folder, shows and tells."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import stages
from cli.mesh_arguments import read_file
from cli.output import Output
from cli.page_told import at, deviation_tables, told_of
from pipeline.photos import FILE as CAMERAS
from stages import Mesh
from stages.comparing.palette import colors_of
from stages.errors import InputError
from stages.files.documents import read_document
from stages.files.opening import content_of
from stages.files.replacing import replacing
from stages.picturing.page.one_file import PageCamera, PageModel, PageScale, one_file
from stages.picturing.page.standing import facing
from stages.surface.upright import turn_along_z

REPORT, PAGE = "report.json", "report.html"
# What a page of scanloom has in its first kilobyte.
_MARK = b'<meta name="generator" content="scanloom">'
_RESULTS = ("textured.glb", "simplified.glb", "simplified.ply")
# What the models of a page are made smaller by, until it is small enough.
_HALVINGS = 6
_LEAST_TRIANGLES = 2_000
# The first model is what a page is for, and is made lighter last; those beside it have at most so many.
_MOST_BESIDE = 150_000
_LAST = 2
_SAMPLES = 100_000
# Of the scale of deviations.
_STEPS = 40
# How far from a place the camera flies to, as a share of the model's size.
_NEAR = 0.25


def page_of(path: Path, out: Output, most_bytes: int) -> bytes:
    """Return the page of a mesh file, or of the OUT of a run, of so many bytes at most, if it can be.

    Raises
    ------
    InputError
        If it is neither.
    """
    if path.is_dir():
        models, told, cameras = _of_run(path, out)
    else:
        models = {path.stem: Shown(_standing(path, read_file(path, out)))}
        told, cameras = {}, []
    page = b""
    for halvings in range(_HALVINGS):
        page = one_file(path.resolve().name, list(_packed(models, halvings)), told, cameras)
        if len(page) <= most_bytes:
            return page
    out.warn(f"{path}: its page takes {len(page):,} bytes, more than {most_bytes:,}, as small as it gets.")
    return page


def write_page(folder: Path, out: Output, most_bytes: int, *, changed: bool) -> Path | None:
    """Write report.html into the OUT of a run; return it, or None where a file of others is in the way.

    Parameters
    ----------
    changed : whether a result is another one than before; else a page that is there stays.
    """
    target = folder / PAGE
    if target.exists():
        if not target.is_file() or _MARK not in content_of(target)[:1024]:
            out.warn(
                f"{target}: this is not a page of scanloom; it is left as it is, and no page is written."
            )
            return None
        if not changed:
            return target
    page = page_of(folder, out, most_bytes)
    with replacing(target) as draft:
        draft.write_bytes(page)
    return target


class Shown(NamedTuple):
    """A model of a page before it is packed; see `PageModel`."""

    mesh: Mesh
    note: str = ""
    scale: PageScale | None = None


Models = dict[str, Shown]


def _of_run(folder: Path, out: Output) -> tuple[Models, dict[str, Any], list[PageCamera]]:
    name = next((name for name in _RESULTS if (folder / name).is_file()), None)
    if name is None:
        known = ", ".join(_RESULTS)
        raise InputError(f"holds none of {known}, nor tiles; give a mesh file, or the OUT of a run.", folder)
    result = _standing(folder / name, read_file(folder / name, out))
    report = read_document(folder / REPORT) if (folder / REPORT).is_file() else {}
    told = told_of(report)
    models: Models = {"result": Shown(result, name)}
    if (folder / "clean.ply").is_file():
        clean = read_file(folder / "clean.ply", out).with_(up=result.up)
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
        told["tables"] = [*deviation_tables(figures, proven, places), *told["tables"]]
    return models, told, _cameras(folder, result)


def _standing(path: Path, mesh: Mesh) -> Mesh:
    if mesh.up is None and path.suffix.lower() in (".glb", ".gltf"):
        return mesh.with_(up=(0.0, 1.0, 0.0))
    return mesh


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
            web = stages.preset("web")
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
    path = folder / "pictures" / CAMERAS
    if not path.is_file():
        return []
    turn = _turn(mesh)
    cameras = []
    for one in read_document(path)["cameras"]:
        if "fx" not in one:
            continue
        pose = turn @ np.array(one["world_from_camera"]).reshape(4, 4)[:3]
        photo = None if one["photo"] is None else content_of(path.parent / one["photo"])
        focal, center = [one["fx"], one["fy"]], [one["cx"], one["cy"]]
        cameras.append(
            PageCamera(one["frame"], pose.round(6).ravel().tolist(), one["size"], focal, center, photo)
        )
    return cameras
