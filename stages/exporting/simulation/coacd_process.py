"""Subprocess that runs the library CoACD, which aborts on some meshes and cannot be interrupted."""

from __future__ import annotations

from typing import Any

import numpy as np

from scanloom.stages.files.subprocess_reader import serve_request

# Settings of the tree search. On the scans of docs/exporting.md, the defaults take five times as long for a
# similar number of parts.
_SEARCH = {"mcts_iterations": 20, "mcts_nodes": 10, "mcts_max_depth": 2, "resolution": 1000, "seed": 0}


def main() -> None:
    """Run the process.

    Arguments: the file of the mesh, the file of the parts, the maximum concavity in metres, and the mode of
    CoACD's preprocessing.
    """
    serve_request(_decompose)


def _decompose(arguments: list[str]) -> dict[str, Any]:
    import coacd

    source, target, concavity, preprocessing = arguments
    coacd.set_log_level("off")
    with np.load(source) as mesh:
        found = coacd.run_coacd(
            coacd.Mesh(mesh["vertices"], mesh["triangles"]),
            threshold=float(concavity),
            real_metric=True,
            preprocess_mode=preprocessing,
            **_SEARCH,
        )
    parts = [np.asarray(points, np.float64) for points, _ in found]
    counts = np.array([len(points) for points in parts], np.int64)
    np.savez(target, points=np.concatenate([np.zeros((0, 3)), *parts]), counts=counts)
    return {"parts": len(parts)}
