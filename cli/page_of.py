"""What the page of a mesh file, or of a run's output folder, shows and tells."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import stages
from cli.mesh_arguments import read_file
from cli.output import Output
from stages import Mesh
from stages.errors import InputError
from stages.files.documents import read_document
from stages.files.opening import content_of
from stages.files.replacing import replacing
from stages.picturing.page.one_file import PageModel, one_file
from stages.picturing.page.standing import facing
from stages.printing import at_most
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
# How large a page is unless it is said.
PAGE_BYTES = 5_000_000
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
        models, told = _of_run(path, out)
    else:
        models, told = {path.stem: (_standing(path, read_file(path, out)), "")}, {}
    page = b""
    for halvings in range(_HALVINGS):
        page = one_file(path.resolve().name, list(_packed(models, halvings)), told)
        if len(page) <= most_bytes:
            return page
    out.warn(f"{path}: its page takes {len(page):,} bytes, more than {most_bytes:,}, as small as it gets.")
    return page


def write_page(folder: Path, out: Output, *, changed: bool) -> Path | None:
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
    page = page_of(folder, out, PAGE_BYTES)
    with replacing(target) as draft:
        draft.write_bytes(page)
    return target


Models = dict[str, tuple[Mesh, str]]


def _of_run(folder: Path, out: Output) -> tuple[Models, dict[str, Any]]:
    name = next((name for name in _RESULTS if (folder / name).is_file()), None)
    if name is None:
        known = ", ".join(_RESULTS)
        raise InputError(f"holds none of {known}, nor tiles; give a mesh file, or the OUT of a run.", folder)
    result = _standing(folder / name, read_file(folder / name, out))
    report = read_document(folder / REPORT) if (folder / REPORT).is_file() else {}
    told = _told(report)
    models: Models = {"result": (result, name)}
    if (folder / "clean.ply").is_file():
        clean = read_file(folder / "clean.ply", out).with_(up=result.up)
        bound = _at(report, "stages", "simplify", "params", "simplify", "max_shape")
        found = stages.deviations(clean, result, tolerance=bound, signed_samples=_SAMPLES)
        figures = found.figures()
        models["clean mesh"] = (clean, "before simplification")
        models["deviation"] = (found.painted, _range_in_words(figures))
        proven = _at(report, "stages", "simplify", "figures", "details", "shape_bound_m")
        told["tables"] = [*_deviation(figures, result, proven), *told["tables"]]
    return models, told


def _standing(path: Path, mesh: Mesh) -> Mesh:
    if mesh.up is None and path.suffix.lower() in (".glb", ".gltf"):
        return mesh.with_(up=(0.0, 1.0, 0.0))
    return mesh


def _packed(models: Models, halvings: int) -> Iterator[PageModel]:
    """Give the models as files, with fewer triangles and smaller images the more often they are halved."""
    with tempfile.TemporaryDirectory(prefix="scanloom-") as folder:
        for number, (name, (mesh, note)) in enumerate(models.items()):
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
            yield PageModel(name, content_of(path), len(light.triangles), words, look)


def _turn(mesh: Mesh) -> NDArray[np.float64]:
    """Return what turns a mesh z up, as the page's camera has it; unknown, it stands as glTF has it, y up."""
    return turn_along_z(np.array((0.0, 1.0, 0.0) if mesh.up is None else mesh.up))


def _told(report: Mapping[str, Any]) -> dict[str, Any]:
    """Return what report.json says, warnings first."""
    scan, ran = report.get("scan", {}), report.get("stages", {})
    warnings = list(scan.get("warnings", []))
    for stage, about in ran.items():
        said = [*_at(about, "figures", "warnings", otherwise=[]), *about.get("unmet", [])]
        warnings += [f"{stage}: {text}" for text in said]
    tables = []
    if ran:
        rows = [
            [
                stage,
                "cached" if about["cached"] else f"{about['seconds']:.1f} s",
                f"{about['made_in_s']:.1f} s",
                f"{about['peak_memory_mb']:,.0f} MB",
                about["reason"],
            ]
            for stage, about in ran.items()
        ]
        head = ["stage", "this run", "when it was made", "memory", "why it ran"]
        tables.append({"title": "Stages", "head": head, "rows": rows})
    skipped = scan.get("frames_skipped", [])
    if skipped:
        rows = [[one["frame"], one["reason"]] for one in skipped]
        tables.append({"title": "Frames that were skipped", "head": ["frame", "why"], "rows": rows})
    texts = []
    if ran:
        texts = [
            {"title": "All parameters, as TOML", "text": _toml(ran)},
            {"title": "report.json", "text": json.dumps(report, indent=1, ensure_ascii=False)},
        ]
    return {"warnings": warnings, "tables": tables, "texts": texts}


def _toml(ran: Mapping[str, Any]) -> str:
    lines: list[str] = []
    for about in ran.values():
        for section, values in about.get("params", {}).items():
            lines += ["", f"[{section}]"]
            lines += [f"{key} = {json.dumps(value)}" for key, value in values.items() if value is not None]
    return "\n".join(lines).strip() + "\n"


def _range_in_words(told: Mapping[str, Any]) -> str:
    most = 1000 * told["color_range_m"]
    sides = "red outside, blue inside" if told["is_signed"] else "red far"
    return f"{sides}, last colour at {most:.3g} mm; green is near"


def _deviation(told: Mapping[str, Any], result: Mesh, proven: float | None) -> list[dict[str, Any]]:
    rows = [[f"{p} % are within", f"{1000 * d:.4g} mm"] for p, d in told["absolute_percentiles_m"].items()]
    rows.append(["RMS", f"{1000 * told['rms_m']:.4g} mm"])
    if proven is not None:
        rows.append(["proven: no point is farther off than", f"{at_most(1000 * proven)} mm"])
    if told["share_within"] is not None:
        rows.append([f"within the bound of {1000 * told['tolerance_m']:g} mm", f"{told['share_within']:.2%}"])
    if told["delta_e_2000"] is not None:
        rows.append(["ΔE2000 of colours, on average", f"{told['delta_e_2000']['mean']:.3g}"])
    turn = _turn(result)
    away = _NEAR * float(np.linalg.norm(np.ptp(result.vertices, axis=0)))
    worst = told["worst"]
    return [
        {"title": "Deviation of the result from the clean mesh, by samples", "head": ["", ""], "rows": rows},
        {
            "title": "Where it is farthest off",
            "head": ["deviation", "at, in the axes of the scan, m", ""],
            "rows": [
                [f"{1000 * one['distance_m']:+.3g} mm", ", ".join(f"{x:.4g}" for x in one["point_m"])]
                for one in worst
            ],
            "places": [{"target": (turn @ np.array(one["point_m"])).tolist(), "away": away} for one in worst],
        },
    ]


def _at(document: Mapping[str, Any], *names: str, otherwise: Any = None) -> Any:
    found: Any = document
    for name in names:
        found = found.get(name) if isinstance(found, Mapping) else None
    return otherwise if found is None else found
