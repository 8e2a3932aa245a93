"""Detection of images whose size differs within a stream."""

from __future__ import annotations

from pathlib import Path

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.images import read_image_size
from scanloom.stages.inspecting.codes import SCAN_IMAGES_SIZES_DIFFER, SCAN_IMAGES_UNREADABLE
from scanloom.stages.scans.model.scan import Scan


def report_sizes(scan: Scan) -> None:
    """Warn about unreadable images and different image sizes within a stream.

    Only the headers of the images are read.
    """
    for stream in ("color", "right", "depth"):
        sizes: dict[tuple[int, int] | None, list[Path]] = {}
        for frame in scan.frames:
            image = getattr(frame, stream)
            if isinstance(image, Path):
                sizes.setdefault(_read_size_or_none(image), []).append(image)
        unread = sizes.pop(None, [])
        if unread:
            emit(
                SCAN_IMAGES_UNREADABLE.warning(
                    "{count} {stream} images cannot be read, the first is {first}",
                    count=len(unread),
                    stream=stream,
                    first=unread[0].name,
                )
            )
        common_size = max(sizes, key=lambda size: len(sizes[size]), default=None)
        different = {size: paths for size, paths in sizes.items() if size != common_size}
        if different:
            _report_different_sizes(stream, different, common_size)


def _report_different_sizes(
    stream: str, different: dict[tuple[int, int] | None, list[Path]], common_size: tuple[int, int] | None
) -> None:
    count = sum(map(len, different.values()))
    if len(different) == 1:
        ((size, paths),) = different.items()
        emit(
            SCAN_IMAGES_SIZES_DIFFER.warning(
                "{count} {stream} images have another size ({size}), the first is {first}",
                count=count,
                stream=stream,
                size=_format_size(size),
                first=paths[0].name,
            )
        )
        return
    emit(
        SCAN_IMAGES_SIZES_DIFFER.warning(
            "{count} {stream} images have {sizes} other sizes ({shown}) than most ({usual})",
            count=count,
            stream=stream,
            sizes=len(different),
            shown=", ".join(map(_format_size, list(different)[:3])) + (" …" if len(different) > 3 else ""),
            usual=_format_size(common_size),
        )
    )


def _format_size(size: tuple[int, int] | None) -> str:
    return "" if size is None else f"{size[0]}×{size[1]}"


def _read_size_or_none(path: Path) -> tuple[int, int] | None:
    try:
        return read_image_size(path)
    except InputError:
        return None
