"""Table of all commands.

Each command is a function of the same name in a file of the same name in cli/commands/. A command is imported
when it runs, because importing all commands takes twice as long.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib import import_module

# Commands by heading of `scanloom --help`, in the order of the pipeline.
COMMANDS: dict[str, tuple[str, ...]] = {
    "From scan to mesh": ("inspect", "run", "batch", "worker"),
    "One stage at a time": (
        "depth",
        "register",
        "adjust",
        "fuse",
        "clean",
        "refine",
        "simplify",
        "texture",
        "lod",
        "export",
    ),
    "Measure and look": ("check", "compare", "coverage", "render", "view", "mesh"),
    "Settings and machine": ("config", "cache", "doctor", "lab"),
}


@dataclass(frozen=True)
class Group:
    """Commands under one name, such as `scanloom lod build`.

    Attributes
    ----------
    summary : its line in the help.
    files : module of each command in `scanloom.cli.commands`.
    """

    summary: str
    files: dict[str, str]


GROUPS = {
    "lod": Group(
        "Build levels of detail and 3D Tiles",
        {"build": "lod", "info": "lod", "cut": "lod", "tiles": "lod_tiles"},
    ),
    "mesh": Group(
        "Bake, remesh, certify, replay and examine meshes",
        {name: name for name in ("bake", "remesh", "decode", "certify", "tradeoff", "replay", "patches")},
    ),
    "cache": Group(
        "List, verify and prune cached results",
        dict.fromkeys(("ls", "verify", "prune"), "cache"),
    ),
    "lab": Group("Try experimental tools", {"probe": "probe"}),
}

# Commands without warnings, and those without --quiet because they have no progress or little.
_WITHOUT_WARNINGS = (("cache", "ls"), ("cache", "verify"), ("cache", "prune"), ("doctor",))
_WITHOUT_PROGRESS = (
    ("cache", "ls"),
    ("cache", "verify"),
    ("cache", "prune"),
    ("config",),
    ("lab", "probe"),
    ("lod", "info"),
    ("mesh", "decode"),
)

Path = tuple[str, ...]


def iterate_commands() -> Iterator[Path]:
    """Yield the words of every command: ("fuse",), ("lod", "build")."""
    for names in COMMANDS.values():
        for name in names:
            group = GROUPS.get(name)
            yield from [(name,)] if group is None else [(name, own) for own in group.files]


def load_command(words: Path) -> Callable[..., None]:
    """Import the function of a command."""
    *group, name = words
    file = GROUPS[group[0]].files[name] if group else name
    function: Callable[..., None] = getattr(import_module(f"scanloom.cli.commands.{file}"), name)
    return function


def can_warn(words: Path) -> bool:
    """Check if a command has --strict."""
    return words not in _WITHOUT_WARNINGS


def has_progress(words: Path) -> bool:
    """Check if a command has --quiet."""
    return words not in _WITHOUT_PROGRESS
