"""Prints the requirements of scanloom and its extra `dev`, one per line.

The Makefile installs them while the kernels compile.
"""

from __future__ import annotations

import sys
from pathlib import Path

if sys.version_info >= (3, 11):
    import tomllib
else:
    # Nothing is installed yet except pip.
    from pip._vendor import tomli as tomllib

PROJECT = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8"))["project"]

LINES = [*PROJECT["dependencies"], *PROJECT["optional-dependencies"]["dev"]]
sys.stdout.write("\n".join(LINES) + "\n")
