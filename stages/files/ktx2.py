"""KTX2 images with Basis Universal compression, through the npm package `ktx2-encoder`.

Source: Khronos Group, "KHR_texture_basisu", 2021, and "KTX file format specification 2.0", 2021. The npm
package is Basis Universal compiled to WebAssembly. WebAssembly runs on every system with the same arithmetic,
and confines damaged images.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import InputError, StageError
from scanloom.stages.files.codes import FILE_TEXTURE_ENCODER_FAILED, FILE_TEXTURE_ENCODER_MISSING
from scanloom.stages.files.image_bytes import is_plausible_size, require_image_memory
from scanloom.stages.files.image_headers import read_header_size

KTX2_MIME, KTX2_SUFFIX = "image/ktx2", ".ktx2"
# Limit of the WebAssembly encoder.
MAX_ENCODED_TEXELS = 12 << 20
# KHR_texture_basisu requires image sides that are a multiple of this.
SIDE_MULTIPLE = 4
# Kinds of pixels: sRGB colours, normals of a normal map, and other linear values.
IMAGE_KINDS = ("color", "normal", "data")

_PACKAGE = "ktx2-encoder"
_SCRIPT = Path(__file__).with_name("ktx2_codec.mjs")
# The largest image needs about 3 minutes of processor time.
_ENCODER_LIMIT_S, _DECODER_LIMIT_S, _NPM_LIMIT_S = 3600.0, 300.0, 60.0
# ETC1S quality levels per step of a quality from 1 to 100.
_LEVELS_PER_QUALITY = 2.55
_ERROR_PREFIXES = ("Error: ", "FATAL ERROR: ")
_MAX_ERROR_CHARACTERS = 200


class _CodecFailedError(Exception):
    """Node ended with an error or did not finish in time."""


def require_ktx2_encoder() -> tuple[str, Path]:
    """Return the path of Node and the folder of `ktx2-encoder`.

    The package is looked up in the folders of NODE_PATH and among npm's global packages. A `node_modules` in
    the working folder is ignored, because a folder of scans must not choose which code runs.

    Raises
    ------
    InputError
        If one of both is missing; the message names the command that installs it.
    """
    node = shutil.which("node")
    if node is None:
        raise InputError(
            FILE_TEXTURE_ENCODER_MISSING,
            "KTX2 images require Node 20 or later and its package {package}",
            remedy="install Node, then run `npm install --global {package}`.",
            package=_PACKAGE,
        )
    folders = [Path(folder) for folder in os.environ.get("NODE_PATH", "").split(os.pathsep) if folder]
    for folder in folders:
        if _has_package(folder):
            return node, folder / _PACKAGE
    global_modules = _find_global_modules(shutil.which("npm"))
    if global_modules is None or not _has_package(global_modules):
        raise InputError(
            FILE_TEXTURE_ENCODER_MISSING,
            "KTX2 images require the Node package {package}",
            remedy=(
                "run `npm install --global {package}`, or set NODE_PATH to the `node_modules` that has it."
            ),
            package=_PACKAGE,
        )
    return node, global_modules / _PACKAGE


def _has_package(folder: Path) -> bool:
    return (folder / _PACKAGE / "package.json").is_file()


@cache
def _find_global_modules(npm: str | None) -> Path | None:
    """Return the folder of npm's global packages; None if unknown."""
    if npm is None:
        return None
    try:
        ran = subprocess.run(
            [npm, "root", "--global"],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            cwd=tempfile.gettempdir(),
            timeout=_NPM_LIMIT_S,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return Path(os.fsdecode(ran.stdout).strip())


def encode_ktx2(pixels: NDArray[np.uint8], kind: str, quality: int) -> bytes:
    """Encode an image with all its mip levels.

    Colours become ETC1S, which is small. Normals and other values become UASTC, which is accurate.

    Parameters
    ----------
    pixels : (h, w, 3) RGB or (h, w, 4) RGBA uint8, top row first, with sides that are multiples of
        SIDE_MULTIPLE and at most MAX_ENCODED_TEXELS texels.
    kind : one of IMAGE_KINDS.
    quality : 1 to 100, for colours.

    Raises
    ------
    InputError
        If the encoder is not installed.
    StageError
        If it fails.
    """
    height, width, channels = pixels.shape
    rgba = pixels if channels == 4 else np.dstack([pixels, np.full((height, width), 255, np.uint8)])
    options = {
        "width": width,
        "height": height,
        "kind": kind,
        "quality": round(_LEVELS_PER_QUALITY * quality),
    }
    try:
        return _run_codec("encode", np.ascontiguousarray(rgba).tobytes(), _ENCODER_LIMIT_S, options)
    except _CodecFailedError as error:
        raise StageError(
            FILE_TEXTURE_ENCODER_FAILED,
            "{package} could not encode an image of {width} × {height} texels ({error})",
            remedy="update it with `npm install --global {package}`, or write WebP.",
            package=_PACKAGE,
            width=width,
            height=height,
            error=error,
        ) from error


def decode_ktx2(data: bytes) -> NDArray[np.uint8] | None:
    """Decode the largest level of a KTX2 image as (h, w, 3) RGB or (h, w, 4) RGBA uint8.

    Returns None if the image is damaged, too large, or not compressed by Basis Universal.

    Raises
    ------
    InputError
        If the decoder is not installed.
    """
    size = read_header_size(data)
    if size is None or not is_plausible_size(size):
        return None
    require_image_memory(size)
    width, height = size
    try:
        pixels = _run_codec("decode", data, _DECODER_LIMIT_S)
    except _CodecFailedError:
        return None
    if len(pixels) != 4 * width * height:
        return None
    rgba = np.frombuffer(pixels, np.uint8).reshape(height, width, 4)
    has_alpha = bool((rgba[:, :, 3] < 255).any())
    return np.array(rgba if has_alpha else rgba[:, :, :3])


def _run_codec(
    verb: str, data: bytes, time_limit_s: float, options: Mapping[str, Any] | None = None
) -> bytes:
    """Run the script in a temporary folder and return the bytes that it writes."""
    node, package = require_ktx2_encoder()
    with tempfile.TemporaryDirectory(prefix="scanloom-", ignore_cleanup_errors=True) as folder:
        source, target = Path(folder, "source"), Path(folder, "target")
        source.write_bytes(data)
        words = [verb, str(source), str(target), *([] if options is None else [json.dumps(options)])]
        try:
            ran = subprocess.run(
                [node, str(_SCRIPT), str(package), *words],
                stdin=subprocess.DEVNULL,
                # The encoder prints its settings.
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                cwd=folder,
                timeout=time_limit_s,
                check=False,
            )
        except subprocess.TimeoutExpired as error:
            raise _CodecFailedError(f"no answer within {time_limit_s:.0f} s") from error
        except OSError as error:
            raise _CodecFailedError(str(error)) from error
        if ran.returncode != 0 or not target.is_file():
            raise _CodecFailedError(_find_error_line(ran.stderr.decode("utf-8", "replace"), ran.returncode))
        return target.read_bytes()


def _find_error_line(text: str, exit_code: int) -> str:
    """Return the line that states the error of the script or of Node, without its stack."""
    lines = [line.strip() for line in text.splitlines() if line.startswith(_ERROR_PREFIXES)]
    return lines[-1][:_MAX_ERROR_CHARACTERS] if lines else f"exit code {exit_code}"
