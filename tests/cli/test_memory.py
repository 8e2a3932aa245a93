"""Commands within shrinking memory limits: one sentence and an exit code, never an aborted process."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from scanloom.cli.app import run_command
from scanloom.stages.surface.formats.ply import write_ply
from tests.made.coloured_meshes import sheet

SAMPLES = Path(__file__).resolve().parents[2] / "samples"
COMMANDS = {
    "quadric": "simplify mesh.ply out.ply --method quadric --ratio 0.1",
    "jia01": "simplify mesh.ply out.ply --method jia01 --ratio 0.3",
    "certified": "simplify mesh.ply out.ply --method certified --max-shape 0.01",
    "planar": "simplify mesh.ply out.ply --method planar --max-shape 0.01",
    "seams": "simplify mesh.ply out.ply --method seams --ratio 0.1",
    "remesh": "mesh remesh mesh.ply out.ply --save out.snm --levels 1",
    "decode": "mesh decode made.snm out.ply",
    "clean": "clean mesh.ply out.ply",
    "clean, with repairs": "clean mesh.ply out.ply --repair",
    "check": "check mesh.ply",
    "lod": "lod build mesh.ply out.slod --set lod.cell_triangles=1000",
    "lod tiles": "lod tiles made.slod tiles-{} --texture mesh.ply --set tiles.compress=meshopt",
    "lod cut": "lod cut made.slod out.glb --triangles 1000 --texture mesh.ply",
    "compare": "compare mesh.ply light.ply",
    "certify": "mesh certify light.ply mesh.ply",
    "patches": "mesh patches mesh.ply out.ply",
    "bake": "mesh bake mesh.ply light.ply out.glb",
    "export": "export mesh.ply out.glb --preset web",
    "view": "view mesh.ply -o page.html",
    "doctor": "doctor --bundle out.zip",
    "replay": "mesh replay made.npz out.ply --ratio 0.5",
    "render": "render mesh.ply out.png",
    "inspect": "inspect rgbd --picture out.png",
    "fuse": "fuse rgbd out.ply --voxel-size 0.01",
    "register": "register rgbd registered-{} --every 4",
    "depth": "depth stereo depth-{}",
    # All stages on a small scan, because the commands above cover the memory of each stage.
    "run": "run rgbd -o run-{} --set scan.every=4 --set fuse.voxel_size=0.03 --set texture.max_size=256 "
    "--set compare.samples=1000 --set report.viewpoints=1 --set report.width=100 --set report.photos=4",
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Prepare both samples, a mesh, and its simplified mesh, collapse record, normal mesh and levels."""
    folder = tmp_path_factory.mktemp("memory")
    for sample in ("rgbd", "stereo"):
        (folder / sample).symlink_to(SAMPLES / sample)
    write_ply(folder / "mesh.ply", sheet(60))
    files = {
        name: str(folder / name)
        for name in ("mesh.ply", "light.ply", "made.npz", "made.snm", "made.ply", "made.slod")
    }
    simplified = ["simplify", files["mesh.ply"], files["light.ply"], "--ratio", "0.1"]
    assert run_command([*simplified, "--save-record", files["made.npz"]]) == 0
    built = ["lod", "build", files["mesh.ply"], files["made.slod"], "--set", "lod.cell_triangles=1000"]
    assert run_command(built) == 0
    remeshed = ["mesh", "remesh", files["mesh.ply"], files["made.ply"], "--levels", "1"]
    assert run_command([*remeshed, "--save", files["made.snm"]]) == 0
    return folder


@pytest.fixture(scope="module")
def runs(folder: Path) -> Iterator[subprocess.Popen[str]]:
    """Start a process that imports the libraries of all commands, then runs command lines."""
    with subprocess.Popen(
        [sys.executable, "-m", "tests.made.commands_short_of_memory"],
        env={**os.environ, "MALLOC_ARENA_MAX": "1", "PYTHONPATH": os.pathsep.join(sys.path)},
        cwd=folder,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        yield process


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="the address space is limited as Linux does it")
@pytest.mark.parametrize("command", COMMANDS)
def test_too_little_memory_is_one_error(command: str, runs: subprocess.Popen[str]) -> None:
    assert runs.stdin is not None
    assert runs.stdout is not None
    runs.stdin.write(f"{COMMANDS[command]}\n")
    runs.stdin.flush()
    ends = json.loads(runs.stdout.readline())
    assert {code for code, _ in ends.values()} <= {0, 1}, ends
    assert ends["0 MiB"][0] == 1
    for code, text in ends.values():
        assert code == 0 or text.count("scanloom: ") == 1, text
        assert "bug in scanloom" not in text
        assert "Traceback" not in text
