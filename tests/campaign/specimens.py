"""Specimens: small valid files of every kind, and their readers; input of damage.

Each specimen is written into a separate folder, always with the same bytes.
"""

from __future__ import annotations

import io
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from collapse_records import make_record
from coloured_meshes import sheet
from seamed_meshes import wrapped_ball

from scanloom.pipeline.config import Config
from scanloom.stages.normal_meshes.remesh import remesh
from scanloom.stages.surface.formats.ply import write_ply
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.mesh_files import write_mesh
from tests.campaign.tiny_scans import SCANS
from tests.pipeline import toy


@dataclass(frozen=True)
class Specimen:
    """Reader of a specimen, the file or folder it reads, and a function that writes the specimen."""

    reader: str
    target: str
    write: Callable[[Path], None]


def _write_ascii_ply(folder: Path) -> None:
    mesh = sheet(3)
    assert mesh.colors is not None
    head = (
        f"ply\nformat ascii 1.0\ncomment made\nelement vertex {len(mesh.vertices)}\nproperty double x\n"
        "property double y\nproperty double z\nproperty uchar red\nproperty uchar green\n"
        f"property uchar blue\nelement face {len(mesh.triangles)}\n"
        "property list uchar int vertex_indices\nend_header\n"
    )
    rows = [
        f"{x} {y} {z} {r} {g} {b}\n"
        for (x, y, z), (r, g, b) in zip(mesh.vertices.tolist(), mesh.colors.tolist(), strict=True)
    ]
    faces = [f"3 {a} {b} {c}\n" for a, b, c in mesh.triangles.tolist()]
    (folder / "mesh.ply").write_text(head + "".join(rows + faces))


def _write_ascii_stl(folder: Path) -> None:
    mesh = sheet(2)
    corners = mesh.vertices[mesh.triangles]
    facets = "".join(
        "facet normal 0 0 1\nouter loop\n"
        + "".join(f"vertex {x} {y} {z}\n" for x, y, z in triangle)
        + "endloop\nendfacet\n"
        for triangle in corners.tolist()
    )
    (folder / "mesh.stl").write_text(f"solid made\n{facets}endsolid made\n")


def _write_polygons_obj(folder: Path) -> None:
    (folder / "mesh.mtl").write_text("newmtl a\nKd 1 0.5 0\nmap_Kd -s 1 1 1 none.png\nnewmtl b\nd 0.5\n")
    (folder / "mesh.obj").write_text(
        "mtllib mesh.mtl\no one\nv 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 1 1 0\nv 0 1 0\nv 0.5 2 0\nvt 0 0\nvt 1 0\n"
        "vt 1 1\nvn 0 0 1\nusemtl a\ns 1\nf 1/1/1 2/2/1 3/3/1 5/1/1 4/2/1\ng two\nusemtl b\nf -1 -2 -3\n"
        "f 1//1 2//1 3//1\nl 1 2\n"
    )


def _write_textured_ply(folder: Path) -> None:
    write_ply(folder / "mesh.ply", wrapped_ball(4, 6))


def _make_mesh_writer(extension: str, mesh: Callable[[], Mesh]) -> Callable[[Path], None]:
    return lambda folder: write_mesh(folder / f"mesh{extension}", mesh())


def _write_normal_mesh(folder: Path) -> None:
    remesh(sheet(12), levels=2, base_triangles=40, threads=1).save(folder / "mesh.snm")


def _make_record_writer(kind: str) -> Callable[[Path], None]:
    return lambda folder: make_record(kind).save(folder / "light.npz")


def _write_cached_results(folder: Path) -> None:
    toy.run(toy.write_scan(folder / "scan"), folder / "out")
    # No reader checks these frames, and the reader writes them again.
    shutil.rmtree(folder / "scan")


def _make_text_writer(name: str, text: str) -> Callable[[Path], None]:
    def write(folder: Path) -> None:
        (folder / name).write_text(text)

    return write


def _format_poses(layout: str) -> str:
    turned = np.array([[0, 0, 1, 1], [0, 1, 0, 2], [-1, 0, 0, 3], [0, 0, 0, 1.0]])
    out = io.StringIO()
    for number, pose in enumerate((np.eye(4), turned, np.eye(4))):
        if layout == "log":
            out.write(f"{number} {number} {number + 1}\n")
            np.savetxt(out, pose, "%.6f")
        else:
            np.savetxt(out, pose[:3].reshape(1, -1), "%.6f")
    return out.getvalue()


_CAMERA = (
    "width = 32\nheight = 24\nfx = 100.0\nfy = 100.0\ncx = 16.0\ncy = 12.0\ndistortion = [0.1, 0.01, 0, 0]\n"
)
_OPENCV_YAML = "".join(
    f"{name}: !!opencv-matrix\n   rows: {rows}\n   cols: {columns}\n   dt: d\n   data: [ {data} ]\n"
    for name, rows, columns, data in (
        ("K1", 3, 3, "100., 0., 16., 0., 100., 12., 0., 0., 1."),
        ("D1", 1, 5, "0., 0., 0., 0., 0."),
        ("K2", 3, 3, "100., 0., 16., 0., 100., 12., 0., 0., 1."),
        ("D2", 1, 5, "0., 0., 0., 0., 0."),
        ("R", 3, 3, "1., 0., 0., 0., 1., 0., 0., 0., 1."),
        ("T", 3, 1, "-0.1, 0., 0."),
    )
)
_KALIBR = "".join(
    f"cam{side}:\n  camera_model: pinhole\n  distortion_coeffs: [0.1, 0.0, 0.0, 0.0]\n"
    "  distortion_model: radtan\n  intrinsics: [100.0, 100.0, 16.0, 12.0]\n  resolution: [32, 24]\n"
    + ("  T_cn_cnm1:\n  - [1, 0, 0, -0.1]\n  - [0, 1, 0, 0]\n  - [0, 0, 1, 0]\n  - [0, 0, 0, 1]\n" * side)
    for side in (0, 1)
)
_OPENCV_XML = (
    '<?xml version="1.0"?>\n<opencv_storage>\n'
    + "".join(
        f'<{name} type_id="opencv-matrix"><rows>3</rows><cols>{columns}</cols><dt>d</dt>'
        f"<data>{data}</data></{name}>\n"
        for name, columns, data in (
            ("M1", 3, "100. 0. 16. 0. 100. 12. 0. 0. 1."),
            ("M2", 3, "100. 0. 16. 0. 100. 12. 0. 0. 1."),
            ("R", 3, "1. 0. 0. 0. 1. 0. 0. 0. 1."),
            ("T", 1, "-0.1 0. 0."),
        )
    )
    + "</opencv_storage>\n"
)

SPECIMENS: dict[str, Specimen] = {
    "binary PLY": Specimen("mesh", "mesh.ply", _make_mesh_writer(".ply", lambda: sheet(3))),
    "ASCII PLY": Specimen("mesh", "mesh.ply", _write_ascii_ply),
    "textured PLY": Specimen("mesh", "mesh.ply", _write_textured_ply),
    "OBJ": Specimen("mesh", "mesh.obj", _make_mesh_writer(".obj", lambda: wrapped_ball(4, 6))),
    "OBJ by hand": Specimen("mesh", "mesh.obj", _write_polygons_obj),
    "OFF": Specimen("mesh", "mesh.off", _make_mesh_writer(".off", lambda: sheet(3))),
    "binary STL": Specimen("mesh", "mesh.stl", _make_mesh_writer(".stl", lambda: sheet(3))),
    "ASCII STL": Specimen("mesh", "mesh.stl", _write_ascii_stl),
    "GLB": Specimen("mesh", "mesh.glb", _make_mesh_writer(".glb", lambda: wrapped_ball(4, 6))),
    "GLB with colours": Specimen("mesh", "mesh.glb", _make_mesh_writer(".glb", lambda: sheet(3))),
    "glTF": Specimen("mesh", "mesh.gltf", _make_mesh_writer(".gltf", lambda: wrapped_ball(4, 6))),
    "normal mesh": Specimen("normal mesh", "mesh.snm", _write_normal_mesh),
    "record": Specimen("record", "light.npz", _make_record_writer("vertices")),
    "record of corners": Specimen("record", "light.npz", _make_record_writer("wedges")),
    "kept results": Specimen("cache", ".", _write_cached_results),
    "config": Specimen("config", "my.toml", _make_text_writer("my.toml", Config().dumps())),
    "rig in TOML": Specimen(
        "calibration",
        "rig.toml",
        _make_text_writer(
            "rig.toml",
            f"R = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]\nT = [-0.1, 0, 0]\n[left]\n{_CAMERA}[right]\n{_CAMERA}",
        ),
    ),
    "rig in YAML": Specimen(
        "calibration", "rig.yaml", _make_text_writer("rig.yaml", "%YAML:1.0\n---\n" + _OPENCV_YAML)
    ),
    "rig in XML": Specimen("calibration", "rig.xml", _make_text_writer("rig.xml", _OPENCV_XML)),
    "rig of Kalibr": Specimen("calibration", "rig.yaml", _make_text_writer("rig.yaml", _KALIBR)),
    "trajectory of TUM": Specimen(
        "trajectory",
        "way.tum",
        _make_text_writer("way.tum", "# t x y z\n1.0 0 0 0 0 0 0 1\n2.0 1 2 3 0 0.6 0 0.8\n"),
    ),
    "trajectory of Redwood": Specimen(
        "trajectory", "way.log", _make_text_writer("way.log", _format_poses("log"))
    ),
    "trajectory of KITTI": Specimen(
        "trajectory", "way.txt", _make_text_writer("way.txt", _format_poses("rows"))
    ),
    "trajectory of EuRoC": Specimen(
        "trajectory",
        "way.csv",
        _make_text_writer("way.csv", "#t,x,y,z,w,x,y,z\n1000,0,0,0,1,0,0,0\n2000,1,2,3,0.8,0,0.6,0\n"),
    ),
    "trajectory in JSON": Specimen(
        "trajectory",
        "way.json",
        _make_text_writer(
            "way.json",
            '{"parameters": [{"extrinsic": [1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1]},'
            ' {"extrinsic": [1,0,0,0,0,1,0,0,0,0,1,0,1,2,3,1]}]}',
        ),
    ),
    **{f"scan: {name}": Specimen("scan", target, write) for name, (target, write) in SCANS.items()},
}


def write_all(folder: Path) -> None:
    """Write every specimen into a folder with its name."""
    for name, specimen in SPECIMENS.items():
        own = folder / name
        own.mkdir(parents=True)
        specimen.write(own)
