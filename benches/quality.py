"""Cost and results of `--quality draft`, `standard` and `best`.

    python benches/quality.py SCAN [SCAN ...] [--truth MESH] [--quality draft ...]

Every tenth frame is held out, and its photo is compared with the result. A draft of a long scan uses fewer
frames, so fewer are compared. Seconds are CPU time of all threads, including report and page. With `--truth`,
the distance from a mesh in the scans' coordinates is reported as well.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path

from markdown_tables import print_head, print_row

from scanloom import Mesh, stages
from scanloom.pipeline.config import Config
from scanloom.pipeline.quality_presets import QUALITIES
from scanloom.pipeline.run.run import run

HOLD_OUT = 10
COLUMNS = (
    "scan",
    "quality",
    "CPU s",
    "voxel mm",
    "triangles",
    "GLB bytes",
    "photos",
    "PSNR dB",
    "SSIM",
)


def make_row(scan: Path, quality: str, truth: Mesh | None) -> list[str]:
    """Run a scan without a cache; return the cells of its row."""
    with tempfile.TemporaryDirectory() as folder:
        out, begun = Path(folder) / "out", time.process_time()
        report = run(scan, out, Config.from_quality(quality).set([f"scan.hold_out={HOLD_OUT}"])).report
        seconds = time.process_time() - begun
        photos, fused = report["held_out"], report["stages"]["fuse"]["metrics"]
        cells = [
            scan.resolve().name,
            quality,
            f"{seconds:.0f}",
            f"{1000 * fused['voxel_size_m']:.2g}",
            f"{report['mesh']['triangles']:,}",
            f"{(out / 'textured.glb').stat().st_size:,}",
            f"{photos['photos']}",
            f"{photos['psnr_affine_db']:.2f}",
            f"{photos['ssim']:.3f}",
        ]
        if truth is not None:
            found = stages.deviations(truth, stages.read_mesh(out / "simplified.ply")).to_dict()
            cells += [f"{1000 * found['rms_m']:.2f}", f"{1000 * found['absolute_percentiles_m']['95']:.2f}"]
        return cells


def main() -> None:
    """Print a Markdown table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scans", nargs="+", type=Path, metavar="SCAN")
    parser.add_argument("--truth", type=Path, metavar="MESH", help="the true surface of the scans")
    parser.add_argument("--quality", nargs="+", choices=tuple(QUALITIES), default=list(QUALITIES))
    options = parser.parse_args()
    truth = None if options.truth is None else stages.read_mesh(options.truth)
    print_head([*COLUMNS, *([] if truth is None else ["truth, RMS mm", "truth, 95 % mm"])], words=2)
    for scan in options.scans:
        for quality in options.quality:
            print_row(make_row(scan, quality, truth))


if __name__ == "__main__":
    main()
