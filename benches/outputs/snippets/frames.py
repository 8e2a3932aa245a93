"""Match, fuse and register a scan in memory: frames.py SCAN EVERY."""

import json
import sys

import numpy as np

from scanloom import DepthMap, ScanParams, depth_scan, fuse, inspect, read_scan, register, write_mesh

path, every = sys.argv[1:]
scan = read_scan(path, ScanParams(every=int(every)))
frames = list(scan.frames)
if scan.is_stereo:
    matched = [(frame, found) for frame, found in depth_scan(scan) if isinstance(found, DepthMap)]
    frames = [frame for frame, _ in matched]
    np.savez(
        "depth.npz",
        depth=np.array([found.depth for _, found in matched]),
        confidence=np.array([found.confidence for _, found in matched]),
    )
fused = fuse(frames)
write_mesh("fused.ply", fused.mesh)
found = register(frames)
metrics = {"inspect": inspect(scan).to_dict(), "fuse": fused.to_dict(), "register": found.to_dict()}
print(json.dumps(metrics, default=str))
