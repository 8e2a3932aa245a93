"""Names of functions and classes: the share that begins with a verb, and class names that occur twice."""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from tests.language.texts import IGNORED_FOLDERS, ROOT

PACKAGES = ("stages", "pipeline", "cli")
_WORDS = Path(__file__).parent
VERBS = frozenset((_WORDS / "verbs.txt").read_text(encoding="utf-8").split())
# Operations that the field knows by one word, and the functions that are commands.
ONE_WORD = frozenset((_WORDS / "one_word.txt").read_text(encoding="utf-8").split())
# As a whole name these leave out the noun.
NO_NAMES = frozenset((_WORDS / "no_names.txt").read_text(encoding="utf-8").split())


class Function(NamedTuple):
    """A function whose name is judged."""

    file: str
    line: int
    name: str

    @property
    def begins_with_verb(self) -> bool:
        """True if the first word is a verb."""
        return self.name.strip("_").split("_")[0] in VERBS

    @property
    def lacks_noun(self) -> bool:
        """True for a lone participle, preposition or pronoun."""
        return self.name.strip("_") in NO_NAMES


def list_functions() -> Iterator[Function]:
    """List functions and methods, without dunders, properties, constructors and one-word operations."""
    for path, tree in _parse_modules():
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and not _is_exempt(node):
                yield Function(path, node.lineno, node.name)


def find_repeated_classes() -> dict[str, list[str]]:
    """Find class names that occur in several modules of `stages/`."""
    files = defaultdict(list)
    for path, tree in _parse_modules():
        for node in ast.walk(tree):
            if path.startswith("stages/") and isinstance(node, ast.ClassDef):
                files[node.name].append(f"{path}:{node.lineno}")
    return {name: found for name, found in sorted(files.items()) if len(found) > 1}


def _parse_modules() -> Iterator[tuple[str, ast.Module]]:
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            name = path.relative_to(ROOT)
            if not IGNORED_FOLDERS.intersection(name.parts):
                yield name.as_posix(), ast.parse(path.read_text(encoding="utf-8"))


def _is_exempt(node: ast.FunctionDef | ast.AsyncFunctionDef) -> bool:
    decorators = [ast.unparse(decorator) for decorator in node.decorator_list]
    bare = node.name.strip("_")
    return (
        node.name.startswith("__")
        or bare.startswith("from_")
        or bare in ONE_WORD
        or any("property" in one or one.endswith(".setter") or "overload" in one for one in decorators)
    )
