"""Held-out photos compared with renderings of fused, simplified, baked and textured meshes.

    python benches/texture.py SCAN... [--hold-out 10] [--ratio 0.1 0.05 ...] [--open3d]

Each scan is processed by `scanloom run` without every tenth frame. Prints a Markdown table:

- PSNR as rendered, and after fitting gain and bias per channel ("affine"); SSIM; "sharpness" is gradient
  energy relative to the photo; "coverage" is the ratio of the photos' pixels that are compared.
- "seconds": duration of the stage that made the colours.
- "seams": visibility of borders between photos (`seam_ratio`), and in parentheses `seam_ratio_over_photos`.

For the first ratio all meshes are compared, for further ratios only the textured one. Photos are localised
against each mesh (see `scanloom.stages.comparing.held_out_views`). --open3d adds Open3D's
`project_images_to_albedo` with the same cameras, on the charts of `bake` in one image of 2048²; it takes
minutes.
"""

from __future__ import annotations

import argparse
import math
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from markdown_tables import print_head, print_row

from scanloom.pipeline.artifacts.adjusted_cameras import AdjustedCameras
from scanloom.pipeline.artifacts.poses import Poses
from scanloom.pipeline.config import Config
from scanloom.pipeline.evaluation.held_out_frames import transfer_neighbour_poses
from scanloom.pipeline.run.run import RunResult, run
from scanloom.stages._open3d import import_open3d
from scanloom.stages.comparing.held_out_views import evaluate_held_out_photos
from scanloom.stages.progress import ignore_progress
from scanloom.stages.scans.model.scan import Frame, Scan
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.reader import read_scan
from scanloom.stages.surface.formats.ply import read_ply
from scanloom.stages.surface.mesh import Image, Material, Mesh, Texture
from scanloom.stages.surface.mesh_files import read_mesh
from scanloom.stages.surface.topology import compute_areas
from scanloom.stages.texturing.atlas_layout import AtlasLayout, lay_out_smallest
from scanloom.stages.texturing.bake import bake
from scanloom.stages.texturing.photos import load_photo

COLUMNS = (
    "scan",
    "ratio",
    "mesh",
    "raw dB",
    "affine dB",
    "SSIM",
    "sharpness",
    "coverage",
    "photos",
    "localised",
    "seconds",
    "textured.glb, MB",
    "seams",
)
_OPEN3D_SIZE = 2048


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scans", type=Path, nargs="+", metavar="SCAN")
    parser.add_argument("--hold-out", type=int, default=10)
    parser.add_argument("--ratio", type=float, nargs="+", default=[0.1])
    parser.add_argument("--open3d", action="store_true")
    options = parser.parse_args()
    print_head(COLUMNS, words=3)
    for folder in options.scans:
        with tempfile.TemporaryDirectory() as out:
            for number, ratio in enumerate(options.ratio):
                words = [f"scan.hold_out={options.hold_out}", f"simplify.ratio={ratio}"]
                result = run(folder, out, Config().set(words))
                scan = read_scan(folder, ScanParams(hold_out=options.hold_out), complete=False)
                used = _apply_used_cameras(scan, result)
                held_out = transfer_neighbour_poses(scan.held_out, options.hold_out, scan.frames, used)
                others = () if number else _make_other_meshes(Path(out), result, used, options.open3d)
                for name, mesh, seconds in others:
                    _print_metrics([folder.name, f"{ratio:g}", name], mesh, held_out, seconds, ["", ""])
                textured = Path(out) / "textured.glb"
                stage = next(one for one in result.stages if one.stage == "texture")
                megabytes = f"{textured.stat().st_size / 1e6:.2f}"
                cells = [folder.name, f"{ratio:g}", "scanloom, texture"]
                names = ("seam_ratio", "seam_ratio_over_photos")
                seams, over = (
                    "–" if value is None else f"{value:.2f}" for value in map(stage.metrics.get, names)
                )
                _print_metrics(
                    cells,
                    read_mesh(textured),
                    held_out,
                    stage.seconds,
                    [megabytes, f"{seams} ({over})"],
                )


def _apply_used_cameras(scan: Scan, result: RunResult) -> Sequence[Frame]:
    """Return the frames with the cameras that later stages used."""
    folders = {one.stage: one.folder for one in result.stages}
    if "register" in folders:
        scan = Poses(folders["register"]).apply_to(scan)
    if "adjust" in folders:
        scan = AdjustedCameras(folders["adjust"]).apply_to(scan)
    return scan.frames


def _make_other_meshes(
    out: Path, result: RunResult, used: Sequence[Frame], with_open3d: bool
) -> Iterator[tuple[str, Mesh, float]]:
    seconds = {one.stage: one.seconds for one in result.stages}
    clean, light = (read_ply(out / f"{name}.ply") for name in ("clean", "simplified"))
    yield "fused, vertex colours", read_ply(out / "fused.ply"), seconds["fuse"]
    yield "simplified, vertex colours", light, seconds["simplify"]
    start = time.perf_counter()
    baked = bake(light, clean).mesh
    yield "simplified, baked", baked, time.perf_counter() - start
    if with_open3d:
        start = time.perf_counter()
        yield "Open3D project_images_to_albedo", _project_albedo(light, used), time.perf_counter() - start


def _project_albedo(mesh: Mesh, frames: Sequence[Frame]) -> Mesh:
    o3d = import_open3d()
    pages = _lay_out_one_page(mesh)
    open3d_mesh = o3d.t.geometry.TriangleMesh(
        o3d.core.Tensor(mesh.vertices.astype(np.float32)), o3d.core.Tensor(mesh.triangles)
    )
    open3d_mesh.triangle.texture_uvs = o3d.core.Tensor(pages.uvs.astype(np.float32))
    photos = [load_photo(frame) for frame in frames if frame.color is not None]
    images = [o3d.t.geometry.Image(o3d.core.Tensor(photo.image)) for photo in photos]
    cameras = [o3d.core.Tensor(photo.camera.matrix) for photo in photos]
    poses = [o3d.core.Tensor(photo.camera_from_world) for photo in photos]
    image = open3d_mesh.project_images_to_albedo(images, cameras, poses, tex_size=_OPEN3D_SIZE)
    pixels = np.ascontiguousarray(image.as_tensor().numpy()[:, :, :3])
    materials = (Material(name="albedo", image=Image(given=pixels), wrap=("clamp", "clamp")),)
    ids = np.zeros(len(mesh.triangles), np.int32)
    return mesh.with_(colors=None, texture=Texture(pages.uvs, ids, materials))


def _lay_out_one_page(mesh: Mesh) -> AtlasLayout:
    """Lay out a mesh in one image, as finely as possible."""
    texel_size = math.sqrt(compute_areas(mesh.vertices, mesh.triangles).sum()) / _OPEN3D_SIZE
    while True:
        found = lay_out_smallest(
            mesh, texel_size, max_side=_OPEN3D_SIZE, max_texels=math.inf, padding=8, progress=ignore_progress
        )
        if len(found.sizes) == 1:
            return found
        texel_size *= 1.1


def _print_metrics(
    first: list[str], mesh: Mesh, held_out: Sequence[Frame], seconds: float, last: list[str]
) -> None:
    found = evaluate_held_out_photos(mesh, held_out).to_dict()
    cells = [f"{found[f'psnr_{kind}_db']:.2f}" for kind in ("raw", "affine")]
    cells += [f"{found['ssim']:.3f}", f"{found['sharpness']:.2f}", f"{found['coverage_ratio']:.2f}"]
    print_row([*first, *cells, str(found["photos"]), str(found["placed"]), f"{seconds:.1f}", *last])


if __name__ == "__main__":
    main()
