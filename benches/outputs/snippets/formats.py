"""Read a mesh, write it in every format, and what comes back from each as PLY: formats.py MESH."""

import sys
from pathlib import Path

from scanloom import MeshError, StageError, UsageError, read_mesh, write_mesh

mesh = read_mesh(sys.argv[1])
print(*mesh.diagnostics, sep="\n")
for ending in ("ply", "obj", "off", "stl", "glb", "gltf"):
    folder = Path(ending)
    folder.mkdir()
    try:
        write_mesh(folder / f"mesh.{ending}", mesh)
        back = read_mesh(folder / f"mesh.{ending}")
    except (MeshError, StageError, UsageError) as error:
        print(f"{ending}: {error}")
        continue
    print(ending, *back.diagnostics, sep="\n")
    write_mesh(folder / "back.ply", back)
