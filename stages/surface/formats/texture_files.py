"""Reading and writing of texture image files."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable
from pathlib import Path, PurePosixPath, PureWindowsPath

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.files.atomic_files import write_file_atomically
from scanloom.stages.files.image_headers import detect_image_type
from scanloom.stages.files.input_files import read_input_bytes
from scanloom.stages.files.ktx2 import KTX2_MIME
from scanloom.stages.surface.codes import MESH_COMPANION_MISSING, MESH_TEXTURE_DAMAGED
from scanloom.stages.surface.texture import Image

# File systems limit names to 255 bytes. The part limit leaves space for a prefix, a hash and an extension.
_MAX_NAME_BYTES = 255
_MAX_NAME_PART_BYTES = 80
# Windows reserves these device names, with any extension.
_DEVICE_NAMES = re.compile(r"^((?:con|prn|aux|nul|com\d|lpt\d)(?:\.|$))", re.IGNORECASE)


def resolve_companion(folder: Path, name: str) -> Path:
    """Resolve a file name in a mesh file to a path.

    The path is below the mesh's folder. An absolute path, or one that leaves the folder, comes from another
    machine; only its last part is used.
    """
    parts = PureWindowsPath(PurePosixPath(name)).parts
    inside = folder.joinpath(*parts)
    if parts and ".." not in parts and not PureWindowsPath(name).anchor and _is_file(inside):
        return inside
    return folder / (parts[-1] if parts else "")


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):  # ValueError: the name contains a null byte
        return False


def read_texture(path: Path, name: str) -> Image | None:
    """Read an image that the mesh file `path` refers to, keeping its bytes.

    A missing or undecodable file gives None and a warning.
    """
    file = resolve_companion(path.parent, name)
    try:
        data = read_input_bytes(file)
    except (OSError, ValueError):
        emit(
            MESH_COMPANION_MISSING.warning(
                "the texture image {name} is missing or cannot be read", path, name=name
            )
        )
        return None
    if not detect_image_type(data, file.name)[0]:
        emit(
            MESH_TEXTURE_DAMAGED.warning(
                "the texture image {name} has an unknown format or is damaged", path, name=name
            )
        )
        return None
    return Image(file.name, data)


def write_images(path: Path, images: Iterable[Image]) -> dict[int, str]:
    """Write images next to the mesh file `path`; return file names by `id(image)`.

    Images keep their bytes, and their names if these are free. Otherwise the name gets the mesh's name as
    prefix. Only files with such a prefixed name are overwritten with other content. KTX2 images become PNG
    next to other formats than glTF, whose programs do not read KTX2.
    """
    names: dict[int, str] = {}
    written: dict[str, bytes] = {}
    for number, image in enumerate(images):
        key = id(image)
        if image.mime == KTX2_MIME and path.suffix.lower() != ".gltf":
            image = Image(f"{PurePosixPath(image.name).stem}.png" if image.name else "", given=image.pixels)
        data, extension = image.file_bytes, image.extension
        name = _sanitize_name(image.name, extension)
        if not name or written.get(name, data) != data or _has_other_content(path.with_name(name), data):
            name = _prefix_name(path.stem, name or f"{number}{extension}")
        if written.get(name, data) != data:
            name = _prefix_name(path.stem, f"{number}{extension}")
        names[key] = name
        written[name] = data
        with write_file_atomically(path.with_name(name)) as part:
            part.write_bytes(data)
    return names


def _prefix_name(stem: str, rest: str) -> str:
    """Prefix an image name with the mesh's name, shortened to the file system's limit."""
    full_name = f"{stem}_{rest}"
    if len(full_name.encode("utf-8", "replace")) <= _MAX_NAME_BYTES:
        return full_name
    # The hash keeps shortened names of different meshes distinct.
    digest = hashlib.sha256(stem.encode("utf-8", "replace")).hexdigest()[:8]
    return f"{_truncate_name(stem, _MAX_NAME_PART_BYTES)}-{digest}_{rest}"


def _truncate_name(name: str, max_bytes: int) -> str:
    """Truncate a name to at most `max_bytes` bytes of UTF-8."""
    return name.encode("utf-8", "replace")[:max_bytes].decode("utf-8", "ignore")


def _sanitize_name(name: str, extension: str) -> str:
    """Return a file name that is valid on every system.

    Its extension matches the image format.
    """
    last = PureWindowsPath(PurePosixPath(name).name).name
    last = re.sub(r'[\x00-\x1f<>:"|?*]', "_", last).strip(" .")
    last = _DEVICE_NAMES.sub(r"_\1", last)
    last = _truncate_name(last, _MAX_NAME_PART_BYTES)
    known = {".jpeg": ".jpg", ".tiff": ".tif"}
    suffix = PurePosixPath(last).suffix.lower()
    fits = known.get(suffix, suffix) == extension or not extension
    return last if fits or not last else last + extension


def _has_other_content(file: Path, data: bytes) -> bool:
    try:
        return read_input_bytes(file) != data
    except FileNotFoundError:
        return False
    except OSError:
        return True
