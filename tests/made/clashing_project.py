"""User project whose modules have the names of scanloom's packages."""

from pathlib import Path

# The script prints the folder of scanloom and the content of the modules of the project.
CODE = "script.py"
_SCRIPT = """
import cli, pipeline.steps, stages
import numpy as np
import scanloom
from scanloom import Mesh, pipeline as ours, simplify
from scanloom.pipeline.config import Config

print(scanloom.__file__)
print(stages.OWN, cli.OWN, pipeline.steps.OWN)
points = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], float)
mesh = Mesh(points, np.array([(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)], np.int32))
print(len(scanloom.clean(mesh).mesh.triangles), simplify(mesh, triangles=4).method, Config.__module__)
scanloom.write_mesh("mesh.ply", mesh)
"""


def write_clashing_project(folder: Path) -> Path:
    """Write the project into a folder."""
    (folder / "pipeline").mkdir(parents=True)
    for name in ("stages.py", "cli.py", "pipeline/__init__.py", "pipeline/steps.py"):
        (folder / name).write_text(f"OWN = {Path(name).stem!r}\n")
    (folder / CODE).write_text(_SCRIPT)
    return folder
