"""Texture checks on rendered scans: readable AprilTags, and removal of a passer-by.

    python benches/rendered_scans.py [--ratio 0.1]

Makes scans with `samples/make_samples.py` and runs the pipeline on them. Prints a Markdown table:

- "tags": of the tags that decode in the photos, those that also decode in renderings of `textured.glb` from
  the same cameras. The tags are so small that decoding is partly random. For comparison, "all in renderings"
  includes tags that do not decode in the photo, and "shifted photos" counts tags that decode after a shift of
  the photo by half a pixel.
- "visitor": a person is in every tenth frame. The texture from all photos is compared with the texture from
  the same scan without the visitor, on the same mesh: ratio of surface samples that differ by more than ten
  levels in a channel.
- "visitor, whole run": the same for pixels of renderings of both runs, each with its own mesh.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np
from markdown_tables import print_head, print_row

from scanloom.pipeline.config import Config
from scanloom.pipeline.run.run import run
from scanloom.stages.comparing.mesh_rendering import render_from_pose
from scanloom.stages.scans.model.images import read_photo
from scanloom.stages.scans.model.scan import ColorImage
from scanloom.stages.scans.reader import read_scan
from scanloom.stages.surface.formats.ply import read_ply
from scanloom.stages.surface.mesh_files import read_mesh
from scanloom.stages.surface.raycasting import RaycastingSurface
from scanloom.stages.surface.surface_color import compute_surface_colors
from scanloom.stages.surface.topology import compute_areas
from scanloom.stages.texturing.texture import texture

SAMPLES = Path(__file__).resolve().parents[1] / "samples"
MAX_LEVELS, SAMPLE_COUNT = 10, 400_000


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--ratio", type=float, default=0.1)
    ratio = parser.parse_args().ratio
    with tempfile.TemporaryDirectory() as folder:
        scans = {name: make_scan(Path(folder) / name, *words) for name, *words in SCANS}
        results = {name: Path(folder) / f"{name}-out" for name in scans}
        for name, scan in scans.items():
            run(scan, results[name], Config().set([f"simplify.ratio={ratio}"]))
        print_head(["check", "result", "of", "ratio"], words=2)
        wanted, *others = count_tags(scans["tags"], results["tags"])
        for name, count in zip(("", ", all in renderings", ", shifted photos"), others, strict=True):
            print_row([f"tags{name}", f"{count} decoded", f"{wanted} in photos", f"{count / wanted:.1%}"])
        differing, places = count_texture_differences(scans, results["plain"])
        print_row(["visitor", f"{differing} differ", f"{places} points", f"{differing / places:.2%}"])
        differing, pixels = count_picture_differences(scans["plain"], results["plain"], results["visitor"])
        print_row(
            ["visitor, whole run", f"{differing} differ", f"{pixels} pixels", f"{differing / pixels:.2%}"]
        )


SCANS = (("plain",), ("tags", "--tags"), ("visitor", "--visitor"))


def make_scan(folder: Path, *words: str) -> Path:
    """Make an RGB-D scan; return its folder."""
    folder.mkdir()
    script = SAMPLES / "make_samples.py"
    subprocess.run([sys.executable, str(script), str(folder), "--only", "rgbd", *words], check=True)
    return folder / "rgbd"


def render_views(scan: Path, result: Path) -> list[tuple[ColorImage, ColorImage, np.ndarray]]:
    """Render a result from each camera of a scan.

    Returns photo, rendering (h, w, 3) uint8, and mask (h, w) of the pixels that show the mesh.
    """
    surface = RaycastingSurface(read_mesh(result / "textured.glb"))
    found = []
    for frame in read_scan(scan).frames:
        photo, camera, _ = read_photo(frame)
        seen = render_from_pose(surface, camera, np.asarray(frame.world_from_camera))
        found.append((photo, np.rint(seen.levels).clip(0, 255).astype(np.uint8), seen.hit_mask))
    return found


def count_tags(scan: Path, result: Path) -> tuple[int, int, int, int]:
    """Count decoded tags.

    Returns counts for photos, photos and renderings, renderings, and shifted photos.
    """
    family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    detector = cv2.aruco.ArucoDetector(family)

    def detect_tags(image: ColorImage) -> set[int]:
        _, found, _ = detector.detectMarkers(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY))
        return set() if found is None else {int(number) for number in found.ravel()}

    counts = np.zeros(4, int)
    move = np.array([[1, 0, 0.5], [0, 1, 0.5]])
    for photo, drawn, _ in render_views(scan, result):
        moved = cv2.warpAffine(photo, move, photo.shape[1::-1], flags=cv2.INTER_CUBIC)
        wanted, found = detect_tags(photo), detect_tags(drawn)
        counts += [len(wanted), len(wanted & found), len(found), len(wanted & detect_tags(moved))]
    return counts[0], counts[1], counts[2], counts[3]


def count_texture_differences(scans: dict[str, Path], plain: Path) -> tuple[int, int]:
    """Count surface samples that differ between textures with and without the visitor.

    Returns differing samples and all samples.
    """
    mesh = read_ply(plain / "simplified.ply")
    found = [texture(mesh, read_scan(scans[name]), format="png").mesh for name in ("visitor", "plain")]
    rng = np.random.default_rng(0)
    area = compute_areas(mesh.vertices, mesh.triangles)
    chosen = rng.choice(len(area), SAMPLE_COUNT, p=area / area.sum())
    weights = rng.dirichlet((1, 1, 1), SAMPLE_COUNT)
    one, other = (compute_surface_colors(textured, chosen, weights) for textured in found)
    return int((np.abs(one - other).max(axis=1) > MAX_LEVELS).sum()), SAMPLE_COUNT


def count_picture_differences(scan: Path, plain: Path, visited: Path) -> tuple[int, int]:
    """Count pixels that differ between renderings of two results.

    Returns differing pixels and all pixels that show both meshes.
    """
    differing = pixels = 0
    for (_, one, hit), (_, other, other_hit) in zip(
        render_views(scan, plain), render_views(scan, visited), strict=True
    ):
        both = hit & other_hit
        differing += int((np.abs(one.astype(int) - other).max(axis=2)[both] > MAX_LEVELS).sum())
        pixels += int(both.sum())
    return differing, pixels


if __name__ == "__main__":
    main()
