"""Advice for files and folders that are not scans: the next step towards a scan."""

from __future__ import annotations

import re
import shlex
from collections import defaultdict
from pathlib import Path

from scanloom.stages.scans.image_folders.image_files import (
    DEPTH_SUFFIXES,
    MASK_FOLDERS,
    extract_numbers,
    list_images,
)

# Videos that are not read; see `VIDEO_SUFFIXES` for the others.
_VIDEOS = (".ts", ".mts", ".m2ts", ".flv", ".ogv", ".insv", ".hevc", ".h264", ".h265")
# Photos that no library of the package decodes.
_UNREADABLE_PHOTOS = (".heic", ".heif", ".avif", ".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".jxl")
_ARCHIVES = (".zip", ".tar", ".tgz", ".gz", ".bz2", ".xz", ".7z", ".rar", ".zst")
_MESHES = (".glb", ".gltf", ".ply", ".obj", ".off", ".stl", ".fbx", ".usdz", ".usd", ".dae", ".3ds")
_CLOUDS = (".las", ".laz", ".e57", ".pcd", ".pts", ".xyz")
# Numbers of a file name, as placeholder of an image's place in its stream.
_NUMBERS = re.compile(r"\d+")
# Minimum number of images in each of two streams.
_MIN_STREAM_COUNT = 2


def describe_file(path: Path, *, is_scan_folder: bool) -> str:
    """Explain why a file is not a scan, and what to do next.

    Parameters
    ----------
    is_scan_folder : the folder of the file is a scan.
    """
    name, suffix = _quote(path.name), path.suffix.lower()
    folder = path.absolute().parent
    if is_scan_folder:
        return f"this is a file, not a scan folder. Its folder is a scan: give {folder}."
    if suffix in _VIDEOS:
        return (
            "this is a file, not a scan folder: a video whose format is not supported. To use it, "
            + describe_frame_extraction(path)
        )
    if suffix in _ARCHIVES:
        target = _quote(path.name.removesuffix(path.suffix))
        is_zip = suffix == ".zip"
        unpack = f"python -m zipfile -e {name} {target}" if is_zip else f"tar -xf {name}"
        return (
            "this is a file, not a scan folder: an archive. Unpack it into a new folder, such as with "
            f"`{unpack}`, and give that folder."
        )
    if suffix in _MESHES:
        return (
            "this is a file, not a scan folder: a mesh. `run` makes meshes from scans; for a mesh, use "
            f"`scanloom simplify {name} light.glb`, `scanloom check {name}` or `scanloom view {name}`."
        )
    if suffix in _CLOUDS:
        return (
            "this is a file, not a scan folder: a point cloud. `run` needs the frames of the camera; "
            f"`scanloom compare {name} mesh.ply` measures a mesh against this cloud."
        )
    if suffix in DEPTH_SUFFIXES:
        return (
            "this is a file, not a scan folder: a single image. Give the folder with all images of the "
            "scan: depth maps and colour images, stereo pairs, or photos with poses."
        )
    return (
        "this is a file, not a scan folder. Give the folder with the images, or a recording (.bag, .db3, "
        ".mcap, .sens, .r3d)."
    )


def describe_frame_extraction(video: Path) -> str:
    """Describe the extraction of photos from a video with FFmpeg."""
    photos = f"{video.stem}/images"
    return (
        f"create the folder {photos}/, extract frames into it, such as with `ffmpeg -i {_quote(video.name)} "
        f"-vf fps=2 -q:v 2 {_quote(photos)}/%05d.jpg`, and give {video.stem}."
    )


def describe_unreadable_photos(folder: Path) -> str | None:
    """Advise on photos in formats that are not decoded (HEIC, raw); None without such photos.

    Parameters
    ----------
    folder : folder that was given as a scan; subfolders are searched, too.
    """
    for place in (folder, *(one for one in sorted(folder.iterdir()) if one.is_dir())):
        photos = list_images(place, _UNREADABLE_PHOTOS)
        if len(photos) < _MIN_STREAM_COUNT or list_images(place):
            continue
        where = "it" if place == folder else f"{place.name}/"
        kind = photos[0].suffix
        return (
            f"{where} holds {len(photos):,} photos in a format that is not supported ({kind}). Convert them, "
            f"such as with `magick mogrify -format jpg -quality 95 {_quote(place.name)}/*{kind}` in the "
            "parent folder, and give the folder again. iPhones write JPEG with the setting Most Compatible."
        )
    return None


def describe_photos(folder: Path, photos: Path) -> str:
    """Advise on photos without poses.

    Parameters
    ----------
    folder : folder that was given as a scan.
    photos : folder of the photos, which may be the same.
    """
    where = f"{photos.name}/" if photos != folder else "it"
    command = _describe_colmap(folder, photos)
    return (
        f"unknown layout: {where} holds images without poses. Give a trajectory with scan.poses=FILE, "
        "estimate poses from at least three photos with scan.layout=photos (other files are ignored), or "
        f"estimate poses with {command} here, and give this folder again."
    )


def _describe_colmap(workspace: Path, photos: Path) -> str:
    return (
        f"`colmap automatic_reconstructor --dense 0 --workspace_path {_quote(workspace)} "
        f"--image_path {_quote(photos)}`, which writes sparse/"
    )


def _quote(path: Path | str) -> str:
    return shlex.quote(str(path))


def describe_streams(folder: Path) -> str | None:
    """Advise on two streams of images under unknown names; None if there are not exactly two.

    Streams are two subfolders, or two groups of names that differ in more than their numbers. Both have the
    same number of images.
    """
    folders = [one for one in sorted(folder.iterdir()) if one.is_dir() and not one.name.startswith(".")]
    counts = {one.name: len(list_images(one, DEPTH_SUFFIXES)) for one in folders}
    streams = {
        name: count
        for name, count in counts.items()
        if count >= _MIN_STREAM_COUNT and name not in MASK_FOLDERS
    }
    if len(streams) == 2 and len(set(streams.values())) == 1:
        a, b = streams
        return (
            f"unknown layout: {a}/ and {b}/ hold {streams[a]:,} images each. If they are the left and right "
            "images of a stereo camera, rename them to left/ and right/ and state the camera with "
            "scan.intrinsics=fx,fy,cx,cy and scan.baseline=METRES (or a calibration.json). If one holds "
            "depth maps, rename it to depth/ and the other to color/."
        )
    groups: dict[str, list[str]] = defaultdict(list)
    for path in list_images(folder, DEPTH_SUFFIXES):
        groups[_NUMBERS.sub("#", path.stem)].append(path.name)
    if len(groups) != 2 or any(not extract_numbers(files[0]) for files in groups.values()):
        return None
    first, second = sorted(groups.values())
    if len(first) != len(second) or len(first) < _MIN_STREAM_COUNT:
        return None
    return (
        f"unknown layout: the images are named like {first[0]} and {second[0]}, {len(first):,} of each. If "
        "they are the left and right images of a stereo camera, move them to left/ and right/ and state the "
        "camera with scan.intrinsics=fx,fy,cx,cy and scan.baseline=METRES (or a calibration.json). If one "
        "kind is depth maps, move it to depth/ and the other to color/."
    )
