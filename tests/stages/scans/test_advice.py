"""Folders that are not scans: the advised next step is carried out, and leads to a scan."""

import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from small_scans import write_small_scan

from scanloom.cli.app import run_command
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.reader import read_scan
from scanloom.stages.surface.formats.gltf_writer import write_gltf
from scanloom.stages.surface.mesh import Mesh

# Two cameras of one COLMAP model, in its text format: camera_from_world, quaternions with the scalar first.
_CAMERAS = "1 PINHOLE 32 24 100 100 16.5 12.5\n"
_IMAGES = "{0} 1 0 0 0 0 0 0 1 {1}\n1 2 -1\n{2} 1 0 0 0 -0.1 0 0 1 {3}\n1 2 -1\n"


def refusal(path: Path) -> str:
    with pytest.raises(InputError) as caught:
        read_scan(path)
    return str(caught.value)


def play_colmap(command: str) -> None:
    """Write the model that `colmap automatic_reconstructor` writes into its workspace."""
    words = shlex.split(command)
    assert words[:2] == ["colmap", "automatic_reconstructor"]
    given = dict(zip(words[2::2], words[3::2], strict=True))
    photos = sorted(path.name for path in Path(given["--image_path"]).iterdir() if path.suffix == ".png")
    model = Path(given["--workspace_path"]) / "sparse" / "0"
    model.mkdir(parents=True)
    (model / "cameras.txt").write_text(_CAMERAS)
    (model / "images.txt").write_text(_IMAGES.format(1, photos[0], 2, photos[1]))
    (model / "points3D.txt").write_text("")


@pytest.fixture
def tiny_scan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_small_scan(tmp_path_factory.mktemp("made") / "tiny")


def commands(text: str) -> list[str]:
    return re.findall("`([^`]+)`", text)


@pytest.mark.parametrize("folder", ["images", "."])
def test_photos_without_poses_become_a_scan_by_colmap(tmp_path: Path, tiny, folder: str) -> None:
    for name in ("a.png", "b.png"):
        tiny.color(tmp_path / folder / name)
    text = refusal(tmp_path)
    assert "images without poses" in text
    (command,) = commands(text)
    play_colmap(command)
    assert [frame.name for frame in read_scan(tmp_path).frames] == ["a", "b"]


def test_a_video_of_an_unsupported_format_becomes_a_scan(
    tmp_path: Path, tiny, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "room.mts").write_bytes(b"G@\x11\x10")
    (extract,) = commands(refusal(Path("room.mts")))
    words = shlex.split(extract)
    assert words[:3] == ["ffmpeg", "-i", "room.mts"]
    for number in (1, 2, 3):
        tiny.color(Path(words[-1].replace("%05d.jpg", f"{number:05}.png")))
    scan = read_scan(Path("room"), complete=False)
    assert (scan.layout, len(scan.frames)) == ("photos", 3)


def test_an_archive_becomes_a_scan_even_with_a_folder_inside(
    tmp_path: Path, tiny_scan: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copytree(tiny_scan, tmp_path / "packed" / "tiny")
    shutil.make_archive("tiny", "zip", "packed")
    (unpack,) = commands(refusal(Path("tiny.zip")))
    python, *words = shlex.split(unpack)
    assert python == "python"
    subprocess.run([sys.executable, *words], check=True)
    scan = read_scan(Path("tiny"))
    assert scan.folder == Path("tiny/tiny")
    assert [one.message for one in scan.diagnostics if one.code == "scan.assumed"] == [
        "the only scan in this folder is tiny/ (plain-rgbd), which is read"
    ]


def test_the_only_scan_is_found_below_folders_that_hold_nothing_else(tmp_path: Path, tiny_scan: Path) -> None:
    shutil.copytree(tiny_scan, tmp_path / "a" / "b" / "c")
    (tmp_path / "__MACOSX").mkdir()
    assert read_scan(tmp_path).folder == tmp_path / "a" / "b" / "c"
    # A folder of a named layout is taken as it is.
    with pytest.raises(InputError):
        read_scan(tmp_path, ScanParams(layout="plain-rgbd"))
    shutil.copytree(tiny_scan, tmp_path / "a" / "b" / "d")
    assert "and so do" in refusal(tmp_path)


def test_a_mesh_is_taken_by_the_commands_that_are_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
    sides = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], np.int32)
    write_gltf(Path("box.glb"), Mesh(corners, sides))
    named = [one for one in commands(refusal(Path("box.glb"))) if one.startswith("scanloom ")]
    assert [one.split()[1] for one in named] == ["simplify", "check", "view"]
    for command in named:
        more = ["-o", "box.html"] if " view " in command else []
        assert run_command([*shlex.split(command)[1:], *more]) == 0, command
    capsys.readouterr()


def test_a_file_of_a_scan_points_to_its_folder(tiny_scan: Path) -> None:
    text = refusal(tiny_scan / "scan.json")
    folder = text.partition("give ")[2].removesuffix(".")
    assert read_scan(Path(folder)).frames


@pytest.mark.parametrize("names", [("cam_a/{}.png", "cam_b/{}.png"), ("a_{}.png", "b_{}.png")])
def test_pairs_under_unknown_names_become_a_stereo_scan(tmp_path: Path, tiny, names: tuple[str, str]) -> None:
    for number in (1, 2):
        for name in names:
            tiny.color(tmp_path / name.format(number))
    text = refusal(tmp_path)
    assert "left/ and right/" in text
    for name, side in zip(names, ("left", "right"), strict=True):
        (tmp_path / side).mkdir()
        for number in (1, 2):
            old = tmp_path / name.format(number)
            old.rename(tmp_path / side / f"{number}.png")
    for empty in ("cam_a", "cam_b"):
        if (tmp_path / empty).exists():
            (tmp_path / empty).rmdir()
    assert "scan.intrinsics=fx,fy,cx,cy" in text
    params = ScanParams(intrinsics=tiny.option, baseline=0.5)
    scan = read_scan(tmp_path, params, complete=False)
    assert scan.layout == "plain-stereo"
    assert [one.code for one in scan.missing] == ["pose.missing"], "run estimates them"


def test_depth_under_an_unknown_name_becomes_a_scan(tmp_path: Path, tiny) -> None:
    for number in (1, 2):
        tiny.color(tmp_path / "kinect_c" / f"{number}.png")
        tiny.depth(tmp_path / "kinect_d" / f"{number}.png", 1000)
    assert "rename it to depth/ and the other to color/" in refusal(tmp_path)
    (tmp_path / "kinect_c").rename(tmp_path / "color")
    (tmp_path / "kinect_d").rename(tmp_path / "depth")
    scan = read_scan(tmp_path, ScanParams(intrinsics=tiny.option), complete=False)
    assert (len(scan.frames), scan.is_stereo) == (2, False)


@pytest.mark.parametrize("place", ["images", "."])
def test_photos_of_phones_in_heic_are_converted(tmp_path: Path, tiny, place: str) -> None:
    photos = tmp_path / "walk" / place
    photos.mkdir(parents=True, exist_ok=True)
    for number in range(3):
        (photos / f"IMG_{number}.HEIC").write_bytes(b"\0\0\0\x18ftypheic")
    text = refusal(tmp_path / "walk")
    assert "3 photos in a format that is not supported (.HEIC)" in text
    (convert,) = commands(text)
    assert convert.endswith(f"{photos.name}/*.HEIC")
    for number in range(3):
        tiny.color(photos / f"IMG_{number}.png")
    scan = read_scan(tmp_path / "walk", complete=False)
    assert (scan.layout, len(scan.frames)) == ("photos", 3)
