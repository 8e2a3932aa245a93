"""All available broken files, each in a separate process with limited time and memory.

Each gives a mesh that can be cleaned and simplified, or a one-sentence error with the file's name.
"""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from scanloom.stages.surface.mesh_files import MESH_EXTENSIONS

# Forks a process for each file on its command line; each prints one JSON object.
PARENT = """
import json, os, resource, sys, time, warnings

import scipy.sparse.csgraph, trimesh
from scanloom.stages.cleaning.clean import clean
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.surface.mesh_files import read_mesh
from scanloom.stages.simplification.simplify import simplify
from scanloom.stages.surface.topology import topology

def examine(path):
    resource.setrlimit(resource.RLIMIT_AS, (4 << 30, 4 << 30))
    resource.setrlimit(resource.RLIMIT_CPU, (20, 20))
    found = {"file": path}
    try:
        mesh = read_mesh(path)
        found["triangles"] = len(mesh.triangles)
        cleaned = clean(mesh, min_island_area=0.0).mesh
        kind = topology(simplify(cleaned, ratio=0.5).mesh)
        found["sound"] = kind.is_manifold and kind.is_oriented
    except InputError as error:
        found["sentence"] = str(error)
    found["peak_kb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    print(json.dumps(found), flush=True)

# Python warns of forks beside the threads of the linear algebra library; the children start none.
warnings.filterwarnings("ignore", message=".*fork.*")
for path in sys.argv[1:]:
    child = os.fork()
    if child == 0:
        examine(path)
        os._exit(0)
    _, status = os.waitpid(child, 0)
    if status:
        print(json.dumps({"file": path, "status": status}), flush=True)
"""

REFUSED = {
    "BoxWithInfinites.glb": "not finite",
    "IndexOutOfRange.gltf": "triangle 0 uses vertices",
    "MissingBin_BoxTextured.gltf": "BoxTextured0.bin, which is missing",
    "OutOfMemory.off": "damaged or cut short",
    "empty.obj": "holds no vertices",
    "empty.off": "damaged or cut short",
    "issue623.ply": "list of length",
    "malformed.obj": "triangle 0 uses vertices",
    "number_formats.obj": "'3.1+e2' is not a number",
    "obj_empty.obj": "holds no vertices",
    "obj_points.obj": "8 vertices but no triangles",
    "ply_empty_bin.ply": "holds no vertices",
    "ply_points_bin.ply": "8 vertices but no triangles",
    "stl_empty_bin.stl": "holds no vertices",
    "truncated_fox_made.ply": "ends within face 251 of 622",
}
READ = {
    "2triangles.off": 2, "Spider_ascii.stl": 1368, "beetle.obj": 2053, "box_longline.obj": 944,
    "bunny_nonmanifold.ply": 16301, "cow_nonmanifold.off": 5520, "cube_binary_header_with_RN_newline.ply": 12,
    "cube_usemtl.obj": 12, "fan3.obj": 3, "float-color.ply": 1, "igea_tristrips.ply": 268686,
    "joined_tetrahedra.obj": 8, "moebius.obj": 448, "multibody.stl": 32, "nancolor.obj": 12,
    "negative_indices.obj": 12, "notenoughindices.obj": 1, "obj_with_no_face_in_chunk.obj": 1,
    "only_a_part_of_vertexcolors.obj": 3, "platonic_shelf.obj": 80, "polygonfaces.obj": 3, "shared.STL": 24,
    "soup.stl": 100, "teapot.stl": 894, "triangle_with_empty_solid.stl": 1, "truncated_suzanne_made.obj": 716,
    "two_objects.obj": 16,
}  # fmt: skip


@pytest.fixture(scope="module")
def results(shared_data) -> dict[str, dict]:
    files = [str(shared_data / "broken" / name) for name in (*REFUSED, *READ)]
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", PARENT, *files],
        capture_output=True, text=True, timeout=300, check=True,
    )  # fmt: skip
    assert done.stderr == ""
    return {Path(found["file"]).name: found for found in map(json.loads, done.stdout.splitlines())}


@pytest.mark.parametrize("name", sorted(REFUSED))
def test_unusable_files_give_one_sentence(results, name):
    found = results[name]
    assert REFUSED[name] in found["sentence"]
    assert found["sentence"].startswith(found["file"] + ": ")
    assert "\n" not in found["sentence"]
    assert found["peak_kb"] < 500_000


@pytest.mark.parametrize("name", sorted(READ))
def test_unusual_files_are_read_cleaned_and_simplified(results, name):
    found = results[name]
    assert found.get("triangles") == READ[name], found
    assert found["sound"]
    assert found["peak_kb"] < 1_000_000


def test_every_broken_file_is_listed(shared_data):
    files = {p.name for p in (shared_data / "broken").iterdir() if p.suffix.lower() in MESH_EXTENSIONS}
    assert files == {*REFUSED, *READ}
