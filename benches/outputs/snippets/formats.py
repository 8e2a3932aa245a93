"""Write and read a mesh in every format: formats.py MESH.

The meshes that were read are saved as PLY.
"""

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
