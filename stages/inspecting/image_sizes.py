"""Detection of images whose size differs within a stream."""

from __future__ import annotations

from pathlib import Path

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.images import image_size
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
                sizes.setdefault(_size_or_none(image), []).append(image)
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
        usual = max(sizes, key=lambda size: len(sizes[size]), default=None)
        odd = {size: paths for size, paths in sizes.items() if size != usual}
        if odd:
            _report_odd(stream, odd, usual)


def _report_odd(
    stream: str, odd: dict[tuple[int, int] | None, list[Path]], usual: tuple[int, int] | None
) -> None:
    count = sum(map(len, odd.values()))
    if len(odd) == 1:
        ((size, paths),) = odd.items()
        emit(
            SCAN_IMAGES_SIZES_DIFFER.warning(
                "{count} {stream} images have another size ({size}), the first is {first}",
                count=count,
                stream=stream,
                size=_size_words(size),
                first=paths[0].name,
            )
        )
        return
    emit(
        SCAN_IMAGES_SIZES_DIFFER.warning(
            "{count} {stream} images have {sizes} other sizes ({shown}) than most ({usual})",
            count=count,
            stream=stream,
            sizes=len(odd),
            shown=", ".join(map(_size_words, list(odd)[:3])) + (" …" if len(odd) > 3 else ""),
            usual=_size_words(usual),
        )
    )


def _size_words(size: tuple[int, int] | None) -> str:
    return "" if size is None else f"{size[0]}×{size[1]}"


def _size_or_none(path: Path) -> tuple[int, int] | None:
    try:
        return image_size(path)
    except InputError:
        return None
