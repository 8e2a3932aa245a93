"""Inputs must be regular files; other files are never opened."""

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


def make_pipe(path: Path) -> None:
    os.mkfifo(path)


def make_socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as made:
        here = Path.cwd()
        os.chdir(path.parent)  # The address of a socket is limited to 107 bytes.
        try:
            made.bind(path.name)
        finally:
            os.chdir(here)


def make_endless_device(path: Path) -> None:
    path.symlink_to("/dev/zero")


def make_folder(path: Path) -> None:
    path.mkdir()


KINDS = [make_pipe, make_socket, make_endless_device, make_folder]


@pytest.mark.parametrize("kind", KINDS)
def test_special_files_are_refused_unopened(tmp_path: Path, kind: Callable[[Path], None]) -> None:
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
def test_every_reader_refuses_special_files_with_one_error(
    tmp_path: Path, name: str, kind: Callable[[Path], None]
) -> None:
    kind(tmp_path / name)
    with pytest.raises(InputError, match=rf"{name}: [^\n]+\.$"):
        READERS[name](tmp_path / name)


@pytest.mark.parametrize("kind", KINDS)
def test_a_configuration_must_be_a_regular_file(tmp_path: Path, kind: Callable[[Path], None]) -> None:
    kind(tmp_path / "c.toml")
    with pytest.raises(UsageError, match=r"c\.toml: the config file cannot be read"):
        Config.load(tmp_path / "c.toml")


@pytest.mark.parametrize("kind", KINDS)
def test_files_referenced_by_a_mesh_must_be_regular_files(
    tmp_path: Path, kind: Callable[[Path], None]
) -> None:
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
def test_images_of_a_scan_must_be_regular_files(tmp_path: Path, kind: Callable[[Path], None]) -> None:
    frames = [{"depth": "0.png", "world_from_camera": np.eye(4).tolist()}]
    (tmp_path / "scan.json").write_text(json.dumps({"frames": frames}))
    kind(tmp_path / "0.png")
    with pytest.raises(InputError):
        read_scan(tmp_path)


# Modules that may open files directly: files created by the program itself, or files checked before.
ALLOWED = {
    "stages/files/input_files.py": {"fdopen", "open"},
    "stages/files/exr.py": {"File"},  # after read_input_bytes
    "stages/files/numpy_files.py": {"np.load"},  # after require_regular_file
    "stages/files/subprocess_reader.py": {"read_text"},  # file of the operating system
    "stages/stereo/networks/worker.py": {"fdopen"},  # its own pipe
    "stages/files/zip_archives.py": {"ZipFile", "open"},  # after require_regular_file; entries
    "stages/files/atomic_files.py": {"open"},  # its own draft
    "stages/simplification/records/archive.py": {"open", "ZipFile"},  # a file opened before, and a draft
    "stages/surface/formats/gltf_writer.py": {"open"},  # drafts
    "stages/surface/formats/ply.py": {"open"},  # drafts
    "stages/surface/formats/obj.py": {"open"},  # drafts
    "stages/files/image_bytes.py": {"Image.open"},  # bytes in memory
    "stages/surface/formats/cloud_chunks.py": {"open", "fromfile"},  # in its own folder
    "stages/surface/formats/las.py": {"open"},  # a file opened before
    "stages/surface/mesh_files.py": {"load_scene"},  # bytes in memory
    "stages/scans/recordings/db3.py": {"connect"},  # after open_input
    "stages/scans/model/video.py": {"VideoCapture"},  # after open_input
    "stages/scans/layouts/plain_photos.py": {"Image.open"},  # after read_image_size
    "stages/registration/structure/incremental_mapping.py": {"open"},  # database in memory
    "stages/inspecting/kernels_build.py": {"open"},  # library that is imported
    "stages/rendering/video.py": {"open"},  # encoder of a draft
    "pipeline/cache/store.py": {"open"},  # locks and marks of the cache
    "pipeline/cache/posix.py": {"open", "read_text"},  # locks and flushed files; file of the operating system
    "pipeline/cache/windows.py": {"open"},  # flushed files
    "pipeline/artifacts/adjusted_cameras.py": {"read_text"},  # verified files of a cache entry
    "pipeline/artifacts/poses.py": {"read_text"},  # verified files of a cache entry
    "pipeline/batch/job_process.py": {"fdopen"},  # its own pipe
    "pipeline/batch/claims.py": {"open"},  # marks that are created and never read
    "pipeline/batch/heartbeat.py": {"open"},  # its own mark, written
    "pipeline/batch/process_handle.py": {"open"},  # its own log, written
    "pipeline/batch/atomic_write.py": {"open"},  # a draft
    "stages/cleaning/chunked_clean.py": {"memmap"},  # in its own folder
    "stages/fusion/brick_stitching.py": {"np.load"},  # verified files of a cache entry, or in its own folder
    "stages/simplification/boundary_strips.py": {"np.load"},  # in its own folder
    "stages/surface/chunked_ply.py": {"memmap", "open"},  # after open_input, and a draft
    "cli/app.py": {"open"},  # null device
    "cli/commands/doctor.py": {"ZipFile"},  # a draft
}
OPENERS = {
    *("open", "fdopen", "read_bytes", "read_text", "fromfile", "loadtxt", "genfromtxt", "memmap", "imread"),
    *("VideoCapture", "ZipFile", "load_scene", "load_mesh", "connect", "File", "FileStorage", "mmap_array"),
    *("read_triangle_mesh", "read_point_cloud", "read_image", "AnyReader"),
}
# Unspecific names, which count only with their module.
WHOLE = {"np.load", "numpy.load", "Image.open", "trimesh.load"}


def list_opening_calls(nodes: list[ast.AST]) -> Iterator[str]:
    for node in nodes:
        if isinstance(node, ast.Call):
            whole = ast.unparse(node.func)
            name = whole.rpartition(".")[2]
            if whole in WHOLE:
                yield whole
            elif name in OPENERS and "documents." not in whole:
                yield name


def list_own_imports(nodes: list[ast.AST]) -> set[str]:
    imports = (node for node in nodes if isinstance(node, ast.ImportFrom))
    ours = (node for node in imports if (node.module or "").startswith("scanloom."))
    return {alias.name for node in ours for alias in node.names}


@pytest.mark.slow
def test_no_other_module_opens_files_directly() -> None:
    beyond: dict[str, set[str]] = {}
    for path in (
        path for room in ("stages", "pipeline", "cli") for path in sorted((ROOT / room).rglob("*.py"))
    ):
        nodes = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
        # Methods of own classes, and functions based on `open_input`, have the same names.
        own = {node.name for node in nodes if isinstance(node, (ast.FunctionDef, ast.ClassDef))}
        name = path.relative_to(ROOT).as_posix()
        calls = set(list_opening_calls(nodes)) - own - list_own_imports(nodes) - ALLOWED.get(name, set())
        if calls:
            beyond[name] = calls
    assert beyond == {}


@pytest.mark.parametrize("ending", ["-wal", "-journal", "-shm"])
def test_companion_files_of_a_database_must_be_regular_files(tmp_path: Path, ending: str) -> None:
    with sqlite3.connect(tmp_path / "a.db3") as connection:
        connection.execute("CREATE TABLE topics (id INTEGER)")
    connection.close()
    make_pipe(tmp_path / f"a.db3{ending}")
    with pytest.raises(InputError, match=r"a\.db3: the file cannot be read \(it is a pipe, not a file\)"):
        read_db3(tmp_path / "a.db3")
