"""Point clouds from files: the same points from every format, and one-sentence errors."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from clouds import make_cloud, make_las, write_cloud

from scanloom import read_cloud
from scanloom.stages.diagnostics.errors import InputError, UsageError
from scanloom.stages.surface import point_cloud_files
from scanloom.stages.surface.formats.ply import write_ply
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.point_cloud_files import read_mesh_or_cloud

FAR = (432_100.0, 5_211_000.0, 310.0)


@pytest.fixture(scope="module")
def made() -> Mesh:
    rng = np.random.default_rng(1)
    points = rng.uniform(-2, 2, (400, 3)) + FAR
    normals = rng.normal(size=(400, 3))
    return make_cloud(points, rng.integers(0, 256, (400, 3), np.uint8), normals)


@pytest.mark.parametrize("name", ["a.ply", "a.las", "a.LAZ", "a.e57"])
def test_points_and_colours_are_read_back(name: str, made: Mesh, tmp_path: Path) -> None:
    path = write_cloud(tmp_path / name.lower(), made, FAR).rename(tmp_path / name)
    read = read_cloud(path)
    assert len(read.triangles) == 0
    assert read.diagnostics == ()
    np.testing.assert_allclose(read.vertices, made.vertices, atol=5.1e-5, rtol=0)
    np.testing.assert_array_equal(read.colors, made.colors)
    assert read.up == (None if name == "a.ply" else (0, 0, 1))
    if name != "a.e57":
        np.testing.assert_allclose(read.normals, made.normals, atol=1e-6)
    np.testing.assert_array_equal(read_mesh_or_cloud(path).vertices, read.vertices)


def test_flags_of_las_points_are_respected(made: Mesh, tmp_path: Path) -> None:
    data = make_las(made.with_(colors=None), FAR, point_format=3)
    withheld = np.zeros(len(data.x), bool)
    withheld[5:12] = True
    data.withheld = withheld
    data.write(str(tmp_path / "a.las"))
    read = read_cloud(tmp_path / "a.las")
    assert len(read.vertices) == len(made.vertices) - 7
    assert read.colors is None
    assert any("7 points are left out" in one.message for one in read.diagnostics)
    assert any("all of them are 0" in one.message for one in read.diagnostics)


def test_8_bit_colours_and_coordinates_in_feet_are_converted(made: Mesh, tmp_path: Path) -> None:
    from laspy.vlrs.known import WktCoordinateSystemVlr

    data = make_las(made, FAR)
    data.red, data.green, data.blue = made.colors.T
    data.header.vlrs.append(WktCoordinateSystemVlr('PROJCS["x",UNIT["US survey foot",0.3048006]]'))
    data.write(str(tmp_path / "a.las"))
    read = read_cloud(tmp_path / "a.las")
    np.testing.assert_array_equal(read.colors, made.colors)
    assert any("in feet" in one.message for one in read.diagnostics)


def test_e57_in_spherical_coordinates(tmp_path: Path) -> None:
    """Two scans with poses, the first in spherical coordinates; invalid points are skipped."""
    import pye57
    from pye57 import libe57

    rng = np.random.default_rng(2)
    places = rng.normal(size=(50, 3)) + np.array((3, 0, 0))
    with pye57.E57(str(tmp_path / "a.e57"), mode="w") as file:
        image = file.image_file
        scan, points = libe57.StructureNode(image), libe57.StructureNode(image)
        names = ("sphericalRange", "sphericalAzimuth", "sphericalElevation", "sphericalInvalidState")
        points.set(names[0], libe57.ScaledIntegerNode(image, 0, 0, 2**30, 1e-7, 0.5))
        for name in names[1:]:
            points.set(name, libe57.FloatNode(image, 0.0, libe57.E57_DOUBLE, -1e9, 1e9))
        # A rotation by 90° around x, with fields in an unusual order.
        half = np.sqrt(0.5)
        pose = libe57.StructureNode(image)
        for name, numbers in (
            ("rotation", {"z": 0.0, "x": 3 * half, "y": 0.0, "w": 3 * half}),
            ("translation", {"z": 30.0, "y": 20.0, "x": 10.0}),
        ):
            part = libe57.StructureNode(image)
            for key, value in numbers.items():
                part.set(key, libe57.FloatNode(image, value))
            pose.set(name, part)
        scan.set("pose", pose)
        vector = libe57.CompressedVectorNode(image, points, libe57.VectorNode(image, True))
        scan.set("guid", libe57.StringNode(image, "{1}"))
        scan.set("points", vector)
        file.data3d.append(scan)
        x, y, z = places.T
        level = np.hypot(x, y)
        values = [np.hypot(level, z), np.arctan2(y, x), np.arctan2(z, level), np.zeros(50)]
        values[3][:4] = 2
        buffers = libe57.VectorSourceDestBuffer()
        for name, column in zip(names, values, strict=True):
            buffers.append(libe57.SourceDestBuffer(image, name, column, 50, True, True))
        writer = vector.writer(buffers)
        writer.write(50)
        writer.close()
        data = dict(zip(("cartesianX", "cartesianY", "cartesianZ"), places.T, strict=True))
        file.write_scan_raw(data, translation=np.array((10.0, 0, 0)), rotation=np.array((1.0, 0, 0, 0)))
    read = read_cloud(tmp_path / "a.e57")
    turned = places[4:, [0, 2, 1]] * (1, -1, 1) + (10, 20, 30)
    np.testing.assert_allclose(read.vertices[:46], turned, atol=2e-7)
    np.testing.assert_allclose(read.vertices[46:], places + np.array((10, 0, 0)), atol=1e-5)
    assert any("4 points are left out" in one.message for one in read.diagnostics)


def test_a_mesh_is_read_as_cloud_or_mesh(tmp_path: Path) -> None:
    triangle = Mesh(np.eye(3), np.array([[0, 1, 2]], np.int32))
    write_ply(tmp_path / "a.ply", triangle)
    assert len(read_cloud(tmp_path / "a.ply").triangles) == 0
    assert len(read_mesh_or_cloud(tmp_path / "a.ply").triangles) == 1


def damage_las(data: bytearray, how: str) -> bytes:
    """Damage a LAS file; its point counts are at byte 107, and since version 1.4 at byte 247."""
    if how == "cut":
        return bytes(data[: len(data) // 2])
    if how == "cut within the header":
        return bytes(data[:90])
    if how == "many points":
        data[107:111] = struct.pack("<I", 2**31)
        data[247:255] = struct.pack("<Q", 2**40)
    elif how == "many records":
        data[100:104] = struct.pack("<I", 2**31)
    elif how == "another start":
        data[:4] = b"what"
    elif how == "noise":
        middle = len(data) // 2
        data[middle : middle + 200] = np.random.default_rng(3).bytes(200)
    return bytes(data)


CASES = [
    *(("a.laz", how) for how in ("cut", "cut within the header", "many points", "many records")),
    *(("a.las", how) for how in ("cut", "many points", "another start")),
    *(("a.e57", how) for how in ("cut", "another start", "noise")),
]


@pytest.mark.parametrize(("name", "how"), CASES)
def test_a_damaged_file_is_one_sentence(name: str, how: str, made: Mesh, tmp_path: Path) -> None:
    path = write_cloud(tmp_path / name, made, FAR)
    path.write_bytes(damage_las(bytearray(path.read_bytes()), how))
    with pytest.raises(InputError, match=r"damaged|declare|cut short|does not start with") as caught:
        read_cloud(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


def test_damage_without_checksum_is_detected_by_the_bounds(made: Mesh, tmp_path: Path) -> None:
    path = write_cloud(tmp_path / "a.las", made, FAR)
    path.write_bytes(damage_las(bytearray(path.read_bytes()), "noise"))
    assert any("file may be damaged" in one.message for one in read_cloud(path).diagnostics)


def test_missing_and_unsupported_files_are_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match="No such file"):
        read_cloud(tmp_path / "a.las")
    (tmp_path / "b.las").mkdir()
    with pytest.raises(InputError, match="Is a directory"):
        read_cloud(tmp_path / "b.las")
    with pytest.raises(InputError, match=r"known are \.ply, \.las, \.laz, \.e57"):
        read_cloud(tmp_path / "a.xyz")
    with pytest.raises(InputError, match=r"unknown format '.xyz'; known are .*\.glb.*\.e57"):
        read_mesh_or_cloud(tmp_path / "a.xyz")
    (tmp_path / "a.laz").write_bytes(b"LASF")
    monkeypatch.setattr(point_cloud_files, "find_spec", lambda name: None if name == "lazrs" else name)
    with pytest.raises(UsageError, match=r"\.laz requires lazrs; install scanloom\[clouds\]"):
        read_cloud(tmp_path / "a.laz")
