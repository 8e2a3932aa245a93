"""Images of a stream that have another size than most."""

from __future__ import annotations

from pathlib import Path

from stages.diagnostics.errors import InputError
from stages.files.images import image_size
from stages.scans.scan import Scan


def odd_sizes(scan: Scan) -> list[str]:
    """Compare the sizes in the headers of all images of each stream."""
    warnings = []
    for stream in ("color", "right", "depth"):
        sizes: dict[tuple[int, int] | None, list[Path]] = {}
        for frame in scan.frames:
            image = getattr(frame, stream)
            if isinstance(image, Path):
                sizes.setdefault(_size_or_none(image), []).append(image)
        unread = sizes.pop(None, [])
        if unread:
            warnings.append(f"{len(unread)} {stream} images cannot be read, the first is {unread[0].name}")
        usual = max(sizes, key=lambda size: len(sizes[size]), default=None)
        odd = {size: paths for size, paths in sizes.items() if size != usual}
        if len(odd) == 1:
            ((size, paths),) = odd.items()
            warnings.append(
                f"{len(paths)} {stream} images have another size ({_size_words(size)}), the first is "
                f"{paths[0].name}"
            )
        elif odd:
            count = sum(map(len, odd.values()))
            shown = ", ".join(map(_size_words, list(odd)[:3])) + (" …" if len(odd) > 3 else "")
            warnings.append(
                f"{count} {stream} images have {len(odd)} other sizes ({shown}) than most "
                f"({_size_words(usual)})"
            )
    return warnings


def _size_words(size: tuple[int, int] | None) -> str:
    return "" if size is None else f"{size[0]}×{size[1]}"


def _size_or_none(path: Path) -> tuple[int, int] | None:
    try:
        return image_size(path)
    except InputError:
        return None
