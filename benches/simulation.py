"""Drop models of `export --preset sim` on a plane in MuJoCo, with their parts and with the full mesh.

    python benches/simulation.py MESH...

prints the number of parts, the proven excess, where a body comes to rest compared with the hull of its mesh,
and the processor time per step of the parts and of all triangles (a rigid flex). Requires `mujoco`.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from markdown_tables import print_head, print_row

from scanloom import export_simulation, read_mesh
from scanloom.stages.surface.mesh_files import set_default_up

_STEPS, _FINE_STEPS = 4000, 200
_TIMESTEP_S = 0.001


def main() -> None:
    """Print one row for each mesh file."""
    print_head(
        [
            "mesh",
            "triangles",
            "parts",
            "excess mm",
            "bytes",
            "moved mm",
            "turned °",
            "ms/step",
            "full ms/step",
        ]
    )
    for name in sys.argv[1:]:
        print_row(_measure(Path(name)))


def _measure(path: Path) -> list[str]:
    mesh = set_default_up(path, read_mesh(path))
    if mesh.up is None:
        mesh = mesh.with_(up=(0.0, 0.0, 1.0))
    with tempfile.TemporaryDirectory() as kept:
        folder = Path(kept) / "model"
        result = export_simulation(mesh, folder)
        (body,) = result.bodies
        points = _read_corners(folder)
        height = body.proof.excess_m - float(points[:, 2].min())
        parts = _drop(_load(folder, height))
        hull = _drop(_replace_parts(_load(folder, height), points))
        fine_s = _time_full_mesh(folder, height)
    cosine = (np.trace(parts[1].T @ hull[1]) - 1) / 2
    return [
        path.stem,
        f"{len(mesh.triangles):,}",
        str(len(body.parts)),
        f"{1000 * body.proof.excess_m:.2f}",
        f"{result.collision_bytes / result.visual_bytes:.1%}",
        f"{1000 * np.linalg.norm(parts[0] - hull[0]):.2f}",
        f"{np.degrees(np.arccos(np.clip(cosine, -1, 1))):.2f}",
        f"{1000 * parts[2]:.4f}",
        f"{1000 * fine_s:.4f}",
    ]


def _read_corners(folder: Path) -> np.ndarray:
    files = (folder / "meshes").glob("*_visual*.obj")
    lines = [line for file in files for line in file.read_text().splitlines()]
    return np.array([line.split()[1:4] for line in lines if line.startswith("v ")], float)


def _load(folder: Path, height: float) -> Any:
    spec = mujoco.MjSpec.from_file(str(folder / "model.xml"))
    spec.option.timestep = _TIMESTEP_S
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[10, 10, 0.1])
    spec.body("model").pos = [0, 0, height]
    return spec


def _replace_parts(spec: Any, points: np.ndarray) -> Any:
    for geom in list(spec.geoms):
        if "collision" in (geom.meshname or ""):
            spec.delete(geom)
    convex = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
    spec.add_mesh(name="hull", uservert=points.ravel(), inertia=convex)
    spec.body("model").add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="hull")
    return spec


def _drop(spec: Any) -> tuple[np.ndarray, np.ndarray, float]:
    """Return centre of mass and rotation at rest, and processor seconds per step."""
    model = spec.compile()
    data = mujoco.MjData(model)
    start = time.process_time()
    mujoco.mj_step(model, data, nstep=_STEPS)
    seconds = (time.process_time() - start) / _STEPS
    body = model.body("model").id
    return data.xipos[body].copy(), data.xmat[body].reshape(3, 3).copy(), seconds


def _time_full_mesh(folder: Path, height: float) -> float:
    """Return processor seconds per step if every triangle collides."""
    text = (folder / "model.xml").read_text()
    inertial = text[text.index("<inertial") :].partition("/>")[0] + "/>"
    shapes = "".join(
        f'<flexcomp name="f{number}" type="mesh" file="{file}" dim="2" rigid="true" radius="0.0001">'
        '<contact selfcollide="none"/></flexcomp>'
        for number, file in enumerate(sorted((folder / "meshes").glob("*_visual*.obj")))
    )
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep="{_TIMESTEP_S}"/><worldbody><geom type="plane" size="10 10 0.1"/>'
        f'<body name="model" pos="0 0 {height}"><freejoint/>{inertial}{shapes}</body></worldbody></mujoco>'
    )
    data = mujoco.MjData(model)
    start = time.process_time()
    mujoco.mj_step(model, data, nstep=_FINE_STEPS)
    return (time.process_time() - start) / _FINE_STEPS


if __name__ == "__main__":
    main()
