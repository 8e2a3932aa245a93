"""Identification of the compiled kernels without loading them."""

from __future__ import annotations

import hashlib
from importlib.util import find_spec

_MODULE = "scanloom.stages._kernels"


def identify_kernels_build() -> str:
    """Identify the build of the kernels by file name and digest.

    The start of the SHA-256 digest distinguishes builds with the same version. The kernels are not loaded,
    because `scanloom --version` must be fast.

    Raises
    ------
    ModuleNotFoundError
        If the kernels are not built.
    """
    spec = find_spec(_MODULE)
    if spec is None or spec.origin is None:
        raise ModuleNotFoundError(f"{_MODULE} is not built", name=_MODULE)
    digest = hashlib.sha256()
    with open(spec.origin, "rb", buffering=0) as file:  # noqa: PTH123 - pathlib takes 10 ms to import
        while block := file.read(1 << 20):
            digest.update(block)
    return f"{spec.origin.replace(chr(92), '/').rpartition('/')[2]} {digest.hexdigest()[:12]}"
