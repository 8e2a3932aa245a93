"""Photos without a pose in a scan with poses; `structure` estimates the missing poses."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.image_folders.image_files import extract_numbers, list_images
from scanloom.stages.scans.layouts.plain_photos import choose_camera
from scanloom.stages.scans.layouts.shared.posed_views import find_transparency_mask
from scanloom.stages.scans.model.scan import Camera, Frame, Scan, SkippedFrame


def add_unlisted_photos(scan: Scan) -> Scan:
    """Add photos that are in the folders of the scan's photos, but not part of the scan.

    Photos of the same size as most photos with poses have the same camera. All photos are sorted by name.
    """
    listed = {frame.color for frame in scan.frames if isinstance(frame.color, Path)}
    cameras = Counter(frame.camera for frame in scan.frames if frame.world_from_camera is not None)
    by_size: dict[tuple[int, int], Camera] = {}
    for camera, _ in cameras.most_common():
        by_size.setdefault((camera.width, camera.height), camera)
    frames, skipped = list(scan.frames), list(scan.skipped_frames)
    for folder in sorted({file.parent for file in listed}):
        for file in list_images(folder):
            if file in listed:
                continue
            try:
                guess = choose_camera(file, None)
                camera = by_size.get((guess.width, guess.height), guess)
                frames.append(Frame(file.stem, camera, color=file, mask=find_transparency_mask(file)))
            except InputError as error:
                skipped.append(SkippedFrame(file.stem, error.diagnostic))
    frames.sort(key=lambda frame: (extract_numbers(frame.name), frame.name))
    added = {frame.color for frame in frames if isinstance(frame.color, Path)}
    return replace(scan, frames=frames, skipped_frames=tuple(skipped), source_files=scan.source_files | added)
