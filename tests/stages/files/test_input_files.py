"""Inputs are regular files: nothing else is opened, wherever an input is named."""

from __future__ import annotations

import ast
import json
import os
import socket
import sqlite3
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from coloured_meshes import ball
from seamed_meshes import wrapped_ball

from scanloom.pipeline.cache.digest import compute_file_digest
from scanloom.pipeline.config import Config
from scanloom.stages.diagnostics.errors import InputError, UsageError
from scanloom.stages.files import documents, images
from scanloom.stages.files.exr import read_exr, read_exr_size
from scanloom.stages.files.input_files import (
    open_input,
    read_input_bytes,
    read_input_text,
    require_regular_file,
)
from scanloom.stages.files.zip_archives import open_archive
from scanloom.stages.normal_meshes.normal_mesh import decode
from scanloom.stages.scans.calibration import camera_files as calibration
from scanloom.stages.scans.layouts.colmap import model_files as colmap
from scanloom.stages.scans.model.video import Video
from scanloom.stages.scans.reader import read_scan
from scanloom.stages.scans.recordings import sens
from scanloom.stages.scans.recordings.chunked import open_span as opened_recording
from scanloom.stages.scans.recordings.db3 import read_db3
from scanloom.stages.scans.trajectory import trajectory_formats as trajectories
from scanloom.stages.simplification.records.archive import read_arrays
from scanloom.stages.surface.mesh_files import read_mesh, write_mesh

ROOT = Path(__file__).parents[3]


def pipe(path: Path) -> None:
    os.mkfifo(path)


def a_socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as made:
        here = Path.cwd()
        os.chdir(path.parent)  # The address of a socket may be 107 bytes long.
        try:
            made.bind(path.name)
        finally:
            os.chdir(here)


def endless_device(path: Path) -> None:
    path.symlink_to("/dev/zero")


def folder(path: Path) -> None:
    path.mkdir()


KINDS = [pipe, a_socket, endless_device, folder]


@pytest.mark.parametrize("kind", KINDS)
def test_what_is_no_regular_file_is_refused_unopened(tmp_path: Path, kind: Callable[[Path], None]) -> None:
    path = tmp_path / "input"
    kind(path)
    for read in (
        open_input,
        read_input_bytes,
        require_regular_file,
        compute_file_digest,
        lambda path: read_input_text(path, "utf-8"),
    ):
        with pytest.raises(
            OSError, match=r"it is a (pipe|socket|device), not a file|Is a directory"
        ) as caught:
            read(path)
        assert caught.value.filename == str(path)


def test_regular_files_and_links_to_them_are_read(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"\xef\xbb\xbfa\r\nb\rc")
    (tmp_path / "link").symlink_to(tmp_path / "file")
    assert read_input_bytes(tmp_path / "link") == b"\xef\xbb\xbfa\r\nb\rc"
    assert read_input_text(tmp_path / "link", "utf-8-sig") == "a\nb\nc"
    with pytest.raises(FileNotFoundError):
        open_input(tmp_path / "none")


READERS = {
    "x.ply": read_mesh,
    "x.obj": read_mesh,
    "x.off": read_mesh,
    "x.stl": read_mesh,
    "x.glb": read_mesh,
    "x.gltf": read_mesh,
    "x.snm": decode,
    "x.npz": read_arrays,
    "x.json": documents.read_document,
    "x.yaml": documents.read_document,
    "x.toml": documents.read_document,
    "x.xml": documents.read_document,
    "lines.txt": lambda path: list(documents.iterate_lines(path)),
    "K.txt": lambda path: calibration.read_camera(path, 640, 480),
    "poses.txt": trajectories.read_trajectory,
    "x.png": images.read_image_size,
    "y.png": images.read_stored_image,
    "z.png": images.read_raw_depth,
    "x.npy": images.read_raw_depth,
    "x.exr": read_exr,
    "y.exr": read_exr_size,
    "x.r3d": open_archive,
    "x.mp4": Video,
    "x.sens": sens.read_sens,
    "x.db3": read_db3,
    "x.bag": lambda path: opened_recording(path).__enter__(),
    "depth.bin": colmap.read_depth_map,
}


@pytest.mark.parametrize("kind", KINDS[:3])
@pytest.mark.parametrize("name", READERS)
def test_every_reader_says_so_in_one_sentence(
    tmp_path: Path, name: str, kind: Callable[[Path], None]
) -> None:
    kind(tmp_path / name)
    with pytest.raises(InputError, match=rf"{name}: [^\n]+\.$"):
        READERS[name](tmp_path / name)


@pytest.mark.parametrize("kind", KINDS)
def test_a_configuration_is_a_file(tmp_path: Path, kind: Callable[[Path], None]) -> None:
    kind(tmp_path / "c.toml")
    with pytest.raises(UsageError, match=r"c\.toml: the config file cannot be read"):
        Config.load(tmp_path / "c.toml")


@pytest.mark.parametrize("kind", KINDS)
def test_files_that_a_mesh_names_are_files(tmp_path: Path, kind: Callable[[Path], None]) -> None:
    write_mesh(tmp_path / "a.gltf", ball())
    (tmp_path / "a.bin").unlink()
    kind(tmp_path / "a.bin")
    with pytest.raises(InputError, match=r"a\.gltf: refers to the file a\.bin, which "):
        read_mesh(tmp_path / "a.gltf")
    write_mesh(tmp_path / "b.obj", wrapped_ball(6, 8))
    [image] = tmp_path.glob("*.png")
    image.unlink()
    kind(image)
    assert any(image.name in str(note) for note in read_mesh(tmp_path / "b.obj").diagnostics)
    (tmp_path / "b.mtl").unlink()
    kind(tmp_path / "b.mtl")
    assert any("b.mtl" in str(note) for note in read_mesh(tmp_path / "b.obj").diagnostics)


@pytest.mark.parametrize("kind", KINDS[:3])
def test_images_of_a_scan_are_files(tmp_path: Path, kind: Callable[[Path], None]) -> None:
    frames = [{"depth": "0.png", "world_from_camera": np.eye(4).tolist()}]
    (tmp_path / "scan.json").write_text(json.dumps({"frames": frames}))
    kind(tmp_path / "0.png")
    with pytest.raises(InputError):
        read_scan(tmp_path)


# What opens files by itself, and who may: what is opened there is the program's own, or was looked at before.
ALLOWED = {
    "stages/files/input_files.py": {"fdopen", "open"},
    "stages/files/exr.py": {"File"},  # after content_of
    "stages/files/numpy_files.py": {"np.load"},  # require_regular
    "stages/files/subprocess_reader.py": {"read_text"},  # of the system
    "stages/stereo/networks/worker.py": {"fdopen"},  # a pipe of its own
    "stages/files/zip_archives.py": {"ZipFile", "open"},  # require_regular, entries
    "stages/files/atomic_files.py": {"open"},  # a draft of its own
    "stages/simplification/records/archive.py": {"open", "ZipFile"},  # what is opened already, and a draft
    "stages/surface/formats/gltf_writer.py": {"open"},  # drafts
    "stages/surface/formats/ply.py": {"open"},  # drafts
    "stages/surface/formats/obj.py": {"open"},  # drafts
    "stages/files/image_bytes.py": {"Image.open"},  # bytes in memory
    "stages/surface/formats/cloud_chunks.py": {"open", "fromfile"},  # in a folder of its own
    "stages/surface/formats/las.py": {"open"},  # what is opened already
    "stages/surface/mesh_files.py": {"load_scene"},  # bytes in memory
    "stages/scans/recordings/db3.py": {"connect"},  # after opened
    "stages/scans/model/video.py": {"VideoCapture"},  # after opened
    "stages/rendering/video.py": {"open"},  # an encoder, of a draft
    "pipeline/cache/store.py": {"open"},  # locks and marks of the cache
    "pipeline/cache/posix.py": {"open", "read_text"},  # locks, what is flushed; of the system
    "pipeline/cache/windows.py": {"open"},  # what is flushed
    "pipeline/artifacts/adjusted_cameras.py": {"read_text"},  # files of an entry, verified
    "pipeline/artifacts/poses.py": {"read_text"},  # files of an entry, verified
    "pipeline/batch/job_process.py": {"fdopen"},  # a pipe of its own
    "pipeline/batch/claims.py": {"open"},  # marks that are made, and never read
    "pipeline/batch/heartbeat.py": {"open"},  # a mark of its own, written
    "pipeline/batch/process_handle.py": {"open"},  # a log of its own, written
    "pipeline/batch/atomic_write.py": {"open"},  # a draft
    "stages/cleaning/chunked_clean.py": {"memmap"},  # in a folder of its own
    "stages/fusion/brick_stitching.py": {"np.load"},  # files of an entry, verified, or in a folder of its own
    "stages/simplification/boundary_strips.py": {"np.load"},  # in a folder of its own
    "stages/surface/chunked_ply.py": {"memmap", "open"},  # after opened, and a draft
    "cli/app.py": {"open"},  # the null device
    "cli/commands/doctor.py": {"ZipFile"},  # a draft
}
OPENERS = {
    *("open", "fdopen", "read_bytes", "read_text", "fromfile", "loadtxt", "genfromtxt", "memmap", "imread"),
    *("VideoCapture", "ZipFile", "load_scene", "load_mesh", "connect", "File", "FileStorage", "mmap_array"),
    *("read_triangle_mesh", "read_point_cloud", "read_image", "AnyReader"),
}
# Names that other things have, too: only these count.
WHOLE = {"np.load", "numpy.load", "Image.open", "trimesh.load"}


def opening_calls(nodes: list[ast.AST]) -> Iterator[str]:
    for node in nodes:
        if isinstance(node, ast.Call):
            whole = ast.unparse(node.func)
            name = whole.rpartition(".")[2]
            if whole in WHOLE:
                yield whole
            elif name in OPENERS and "documents." not in whole:
                yield name


def imported_from_ours(nodes: list[ast.AST]) -> set[str]:
    imports = (node for node in nodes if isinstance(node, ast.ImportFrom))
    ours = (node for node in imports if (node.module or "").startswith("scanloom."))
    return {alias.name for node in ours for alias in node.names}


@pytest.mark.slow
def test_nothing_else_opens_files() -> None:
    beyond: dict[str, set[str]] = {}
    for path in (
        path for room in ("stages", "pipeline", "cli") for path in sorted((ROOT / room).rglob("*.py"))
    ):
        nodes = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
        # Methods of a class of one's own, and functions that go through `opening`, have such names too.
        own = {node.name for node in nodes if isinstance(node, (ast.FunctionDef, ast.ClassDef))}
        name = path.relative_to(ROOT).as_posix()
        calls = set(opening_calls(nodes)) - own - imported_from_ours(nodes) - ALLOWED.get(name, set())
        if calls:
            beyond[name] = calls
    assert beyond == {}


@pytest.mark.parametrize("ending", ["-wal", "-journal", "-shm"])
def test_what_a_database_reads_beside_it_is_a_file(tmp_path: Path, ending: str) -> None:
    with sqlite3.connect(tmp_path / "a.db3") as connection:
        connection.execute("CREATE TABLE topics (id INTEGER)")
    connection.close()
    pipe(tmp_path / f"a.db3{ending}")
    with pytest.raises(InputError, match=r"a\.db3: the file cannot be read \(it is a pipe, not a file\)"):
        read_db3(tmp_path / "a.db3")
