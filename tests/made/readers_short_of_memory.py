"""File readers with decreasing memory limits, each run in a separate process.

`python -m tests.made.readers_short_of_memory` reads file names. For each it writes a line of JSON: outcome of
each run, by the number of bytes that the process could allocate; see `short_of_memory`. Libraries are
imported once, before the first run.
"""

from __future__ import annotations

import json
import sys
from functools import partial
from pathlib import Path

import numpy as np

from scanloom.stages.files.images import read_raw_depth, read_stored_image
from scanloom.stages.surface.mesh_files import MESH_EXTENSIONS, read_mesh
from tests.made.short_of_memory import Call, run_limited


def make_reader_call(file: Path) -> Call:
    if file.suffix in MESH_EXTENSIONS:
        return partial(read_mesh, file)
    return partial(read_raw_depth if file.suffix in (".npy", ".exr") else read_stored_image, file)


def main() -> None:
    # Libraries that readers import inside functions.
    import cv2  # noqa: F401
    import OpenEXR  # noqa: F401
    import scipy.sparse  # noqa: F401
    import trimesh.exchange.load  # noqa: F401

    # OpenBLAS restarts its threads after a fork. An ordinary process already has them from its imports.
    np.dot(np.eye(400), np.eye(400))
    megabytes = (800, 100, 80, 60, 50, 40, 30, 20, 15, 10, 5, 2, 1, 0)
    for line in sys.stdin:
        call = make_reader_call(Path(line.rstrip("\n")))
        sys.stdout.write(json.dumps({f"{m} MiB": run_limited(call, spare=m << 20) for m in megabytes}) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
