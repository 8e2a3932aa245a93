"""Conversion of depth, stereo and photo scans to compact textured meshes.

>>> import scanloom
>>> fused = scanloom.fuse(scanloom.read_scan("my_scan"))
>>> cleaned = scanloom.clean(fused.mesh)
>>> simplified = scanloom.simplify(cleaned.mesh, ratio=0.1).mesh

The package exports all public names of `scanloom.stages`, and `show` and `Page` from `scanloom.pipeline`.
Names are imported on first use. `scanloom.pipeline` processes scan folders; `scanloom.cli` is the command
line.
"""

from __future__ import annotations

import sys
from importlib import import_module
from os import path

# Type checkers treat this name as true. `typing.TYPE_CHECKING` is avoided, because importing typing takes
# longer than this whole module.
TYPE_CHECKING = False
if TYPE_CHECKING:
    from importlib.machinery import ModuleSpec
    from types import CodeType, ModuleType
    from typing import Any

    from scanloom.pipeline.report.page.show import Page as Page
    from scanloom.pipeline.report.page.show import show as show
    from scanloom.stages import *
    from scanloom.stages import __version__ as __version__

_PACKAGES = ("stages", "pipeline", "cli")
# Modules of public names that are not in `scanloom.stages`.
_PIPELINE_NAMES = dict.fromkeys(("Page", "show"), "pipeline.report.page.show")

_FOLDER = path.dirname(__file__)
if not path.isdir(path.join(_FOLDER, "stages")):
    # In a checkout, the packages are siblings of this folder. The wheel build moves them into it.
    __path__.append(path.dirname(_FOLDER))


# Hidden from type checkers, which use the imports above.
if not TYPE_CHECKING:

    def __getattr__(name: str) -> Any:
        if name in _PACKAGES:
            return import_module(f"{__name__}.{name}")
        stages = import_module(f"{__name__}.stages")
        if name == "__all__":
            value = sorted([*stages.__all__, *_PIPELINE_NAMES])
        elif name in _PIPELINE_NAMES:
            value = getattr(import_module(f"{__name__}.{_PIPELINE_NAMES[name]}"), name)
        elif name in stages.__all__:
            value = getattr(stages, name)
        else:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        globals()[name] = value
        return value

    def __dir__() -> list[str]:
        return sorted({*_PACKAGES, *__getattr__("__all__")})


def add_alias(package: str) -> None:
    """Alias a top-level package of a checkout, such as `stages`, to `scanloom.stages`.

    Submodules are aliased, too, so that no module is loaded twice.
    """
    sys.modules[package] = import_module(f"{__name__}.{package}")
    sys.meta_path.insert(0, _AliasFinder(package))


class _AliasFinder:
    """Import hook that resolves `stages.x` to the module `scanloom.stages.x`."""

    def __init__(self, package: str) -> None:
        self._package = package

    def find_spec(self, name: str, _path: object = None, _target: object = None) -> ModuleSpec | None:
        is_ours = sys.modules.get(self._package) is sys.modules.get(f"{__name__}.{self._package}")
        if not (is_ours and name.startswith(f"{self._package}.") and _find_module_spec(name)):
            return None
        from importlib.util import spec_from_loader

        return spec_from_loader(name, self)  # type: ignore[arg-type]  # it has what Python calls

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        module = import_module(f"{__name__}.{spec.name}")
        # The import system overwrites `__spec__` after this call; `exec_module` restores it.
        spec.loader_state = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        if module.__spec__ is not None:
            module.__spec__ = module.__spec__.loader_state

    def get_code(self, name: str) -> CodeType | None:
        """Return the code of a module for `python -m`."""
        spec = _find_module_spec(name)
        if spec is None or spec.loader is None:
            return None
        code: CodeType | None = spec.loader.get_code(spec.name)  # type: ignore[attr-defined]
        return code


def _find_module_spec(name: str) -> ModuleSpec | None:
    from importlib.util import find_spec

    return find_spec(f"{__name__}.{name}")
