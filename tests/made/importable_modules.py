"""All modules of packages that this operating system can import."""

import pkgutil
import sys
from importlib import import_module
from types import ModuleType

OTHER_SYSTEM = "posix" if sys.platform == "win32" else "windows"


def import_modules(*packages: ModuleType) -> list[ModuleType]:
    """Import every module of some packages, except modules for other operating systems."""
    return [
        import_module(found.name)
        for package in packages
        for found in pkgutil.walk_packages(package.__path__, f"{package.__name__}.")
        if not found.name.rpartition(".")[2].startswith(OTHER_SYSTEM)
    ]
