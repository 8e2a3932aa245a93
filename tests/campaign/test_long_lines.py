"""Long lines in text files: all patterns on foreign text take linear time."""

from __future__ import annotations

import contextlib
import random
import time
from pathlib import Path

import pytest

from scanloom.stages.diagnostics.errors import ScanloomError
from scanloom.stages.files import documents
from scanloom.stages.scans.calibration.headed_text import has_frame_headings, read_headed_text
from scanloom.stages.scans.calibration.named_text import parse_named_text
from scanloom.stages.scans.calibration.pair_names import find_distortion_pair
from scanloom.stages.scans.calibration.ros_text import parse_ros_text
from scanloom.stages.scans.layouts.kitti.projections import read_projections, resolve_rectified_size
from scanloom.stages.scans.layouts.shared.axis_alignment import apply_axis_alignment
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.reader import read_scan
from scanloom.stages.scans.trajectory.trajectory_formats import read_trajectory
from scanloom.stages.surface.mesh_files import read_mesh

ROOT = Path(__file__).resolve().parents[2]
_SIZE = 1 << 20
# Processor time, seconds. A quadratic pattern takes minutes.
_MAX_SECONDS = 8.0

# A start, a repeated text that fills a megabyte, and an end that makes a pattern fail.
LINES = {
    "blanks": ("a", " ", "!"),
    "line ends": ("a", "\n", "!"),
    "assignment of blanks": ("axisAlignment = ", " ", "\0"),
    "projection of blanks": ("P1_roi : ", " ", "\0"),
    "size of blanks": ("S_rect_00: 1", " ", "x y"),
    "box of blanks": ("bounding box (1 2 3)", " ", "x"),
    "names": ("mtllib ", "cam", ""),
    "libraries": ("mtllib a", ".mtl.", "b"),
    "frames": ("# frame", "0", " camera to world_"),
    "headings": ("# ", "intrinsi ", ""),
    "heads": ("[", "(", ""),
    "numbers": ("1 ", "1,", ";"),
    "digits": ("", "9", "x"),
    "marks": ("#", "> ", "1"),
    "words": ("%YAML:1.0\n", "left", "\n"),
}


def make_line(kind: str) -> str:
    start, run, end = LINES[kind]
    # Empty lines are shorter, because a megabyte of lines takes long even in linear time.
    size = _SIZE >> 4 if run == "\n" else _SIZE
    return start + run * (size // len(run)) + end + "\n"


@pytest.fixture(params=LINES)
def path(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    file = tmp_path / "a.txt"
    file.write_text(make_line(request.param))
    return file


def assert_within_time(*readers: object) -> None:
    for read in readers:
        assert callable(read)
        started = time.process_time()
        with contextlib.suppress(ScanloomError, ValueError):
            read()
        taken = time.process_time() - started
        assert taken < _MAX_SECONDS, f"{read} took {taken:.0f} s"


def test_readers_of_lines_take_linear_time(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert_within_time(
        lambda: documents.parse_assignments(text, ":="),
        lambda: has_frame_headings(text),
        lambda: read_headed_text(path),
        lambda: parse_named_text(text),
        lambda: parse_ros_text(text),
        lambda: read_projections(path),
        lambda: resolve_rectified_size(path, (4, 4)),
        lambda: read_trajectory(path),
        lambda: find_distortion_pair({text: [0, 0, 0, 0], "D2": [0, 0, 0, 0]}),
    )


def test_readers_of_documents_take_linear_time(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    half = text[: 1 << 18] + text[-20:]
    for suffix in (".yaml", ".toml", ".json", ".xml"):
        file = path.with_suffix(suffix)
        file.write_text(half if suffix == ".yaml" else text)
        assert_within_time(lambda file=file: documents.read_document(file))
    file = path.with_suffix(".yaml")
    file.write_text("%YAML:1.0\n" + half)
    assert_within_time(lambda: documents.read_document(file))


def test_readers_of_meshes_take_linear_time(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    triangle = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nusemtl m\nf 1/1 2/1 3/1\n"
    for name, content in (
        ("a.obj", f"mtllib a.mtl\n{triangle}{text}"),
        ("b.obj", f"mtllib {text.replace(chr(10), ' ')}\n{triangle}"),
        ("a.off", f"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n{text}"),
        ("a.stl", f"solid {text}"),
        ("a.ply", f"ply\nformat ascii 1.0\ncomment {text}"),
    ):
        (path.parent / name).write_text(content)
    (path.parent / "a.mtl").write_text(f"newmtl m\nmap_Kd {text}Kd {text}map_Bump -s {text}")
    for name in ("a.obj", "b.obj", "a.off", "a.stl", "a.ply"):
        assert_within_time(lambda name=name: read_mesh(path.parent / name))


@pytest.mark.parametrize(
    "scan", ["Middlebury", "Middlebury views", "Karlsruhe", "KITTI", "BundleFusion", "camera text"]
)
@pytest.mark.parametrize(
    "kind", ["blanks", "line ends", "assignment of blanks", "projection of blanks", "box of blanks"]
)
def test_layouts_with_patterns_take_linear_time(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, scan: str, kind: str
) -> None:
    monkeypatch.syspath_prepend(str(ROOT))
    from tests.campaign.tiny_scans import SCANS

    SCANS[scan][1](tmp_path)
    (tmp_path / "scene0000_00.txt").write_text(make_line(kind))
    for file in sorted(tmp_path.glob("*.txt")):
        whole = file.read_text()
        file.write_text(f"{make_line(kind)}{whole}{make_line(kind)}")
        assert_within_time(lambda: read_scan(tmp_path, complete=False))
        file.write_text(whole)
    assert_within_time(
        lambda: apply_axis_alignment(read_scan(tmp_path, ScanParams(), complete=False), tmp_path)
    )


@pytest.mark.slow
def test_long_lines_anywhere_in_a_text_file_take_linear_time(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.syspath_prepend(str(ROOT))
    from tests.campaign.reading import READERS
    from tests.campaign.specimens import SPECIMENS
    from tests.campaign.text_damage import lengthen_line

    draw = random.Random(11)
    for name, specimen in SPECIMENS.items():
        if specimen.reader not in ("mesh", "scan", "calibration", "trajectory", "config"):
            continue
        folder = tmp_path / name
        folder.mkdir()
        specimen.write(folder)
        for file in sorted(folder.rglob("*")):
            content = file.read_bytes() if file.is_file() else b"\0"
            for _ in range(0 if b"\0" in content else 6):
                file.write_text(lengthen_line(content.decode(), draw))
                assert_within_time(lambda s=specimen, f=folder: READERS[s.reader](f / s.target))
            if file.is_file():
                file.write_bytes(content)
