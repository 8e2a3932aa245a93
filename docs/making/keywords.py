"""Generated keyword classes for type checkers, and the public names of `stages`.

    PYTHONPATH=.:docs python -m making.keywords

writes `stages/params/keywords.py` and the generated parts of `stages/__init__.py`. Tests compare them.
"""

from __future__ import annotations

import ast
import dataclasses
import importlib
import inspect
import re
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

from scanloom import stages
from scanloom.stages.params import describe_own, find_nested

ROOT = Path(__file__).resolve().parents[2]
KEYWORDS = ROOT / "stages" / "params" / "keywords.py"
PACKAGE = ROOT / "stages" / "__init__.py"

_HEAD = '''"""Fields of parameter classes as keywords of functions, for type checkers.

Written by `PYTHONPATH=.:docs python -m making.keywords`; do not edit.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, TypedDict

if TYPE_CHECKING:
'''
# Classes that are not parameter classes, but whose fields are keywords of functions.
_OTHERS = ("scanloom.stages.surface.mesh.Mesh",)
_BUILTIN = frozenset(("bool", "dict", "float", "int", "list", "object", "str", "tuple"))
_IMPORTS = re.compile(r"(?<=\nif TYPE_CHECKING:\n).*?(?=\n    __version__: str\n)", re.DOTALL)
_ALL = re.compile(r"(?<=\n__all__ = \[\n).*?(?=\])", re.DOTALL)


def find_classes() -> list[type]:
    """List the classes whose fields are keywords of functions, by name.

    Raises
    ------
    ValueError
        If two classes have the same name.
    """
    found: dict[str, type] = {}
    for path in sorted((ROOT / "stages").rglob("*.py")):
        if "param(" not in path.read_text(encoding="utf-8"):
            continue
        parts = ("scanloom", *path.relative_to(ROOT).with_suffix("").parts)
        module = importlib.import_module(".".join(parts).removesuffix(".__init__"))
        for name, cls in vars(module).items():
            if _is_declared_in(cls, module.__name__) and (describe_own(cls) or find_nested(cls)):
                if name in found:
                    raise ValueError(f"two parameter classes are called {name}")
                found[name] = cls
    for name in _OTHERS:
        module_name, _, own = name.rpartition(".")
        found[own] = getattr(importlib.import_module(module_name), own)
    return [found[name] for name in sorted(found)]


def write_keywords() -> str:
    """Write the source of the module of keywords."""
    classes = find_classes()
    imports: dict[str, set[str]] = {}
    written = []
    for cls in classes:
        lines = [
            f"class {get_keywords_name(cls)}(TypedDict, total=False):",
            f'    """Fields of `{cls.__name__}`."""',
            "",
        ]
        for field in dataclasses.fields(cls):  # type: ignore[arg-type]
            annotation, module = _get_annotation(cls, field.name)
            for name in _find_names(annotation):
                source, imported = _find_import(module, name)
                imports.setdefault(source, set()).add(imported)
            if field.name in find_nested(cls):
                annotation += f" | {get_keywords_name(find_nested(cls)[field.name])}"
            lines.append(f"    {field.name}: {annotation}")
        written.append("\n".join(lines))
    imported = [
        f"    import {module} {name}" if name.startswith("as ") else f"    from {module} import {name}"
        for module, names in sorted(imports.items())
        for name in sorted(names)
    ]
    return _format(_HEAD + "\n".join(imported) + "\n\n\n" + "\n\n\n".join(written) + "\n", KEYWORDS)


def write_package() -> str:
    """Write the source of `stages/__init__.py` with its generated parts.

    These are the imports and `__all__`, from the tables of public names.
    """
    text = PACKAGE.read_text(encoding="utf-8")
    imports = [
        f"    from scanloom.stages.{module} import {', '.join(names)}\n"
        for module, names in sorted(stages._NAMES_OF.items())
    ]
    listed = sorted({*stages._MODULE_OF, "__version__"})
    text = _IMPORTS.sub(lambda _: "".join(imports), text)
    text = _ALL.sub(lambda _: "".join(f'    "{name}",\n' for name in listed), text)
    return _format(text, PACKAGE)


def get_keywords_name(cls: type) -> str:
    """Return the name of the keyword class of a parameter class."""
    return f"{cls.__name__.removesuffix('Params')}Keywords"


def _is_declared_in(cls: Any, module: str) -> bool:
    return (
        inspect.isclass(cls)
        and cls.__module__ == module
        and dataclasses.is_dataclass(cls)
        and not cls.__name__.startswith("_")
    )


def _get_annotation(cls: type, name: str) -> tuple[str, str]:
    """Return a field's annotation as written, and the module that declares it."""
    owner = next(base for base in cls.__mro__ if name in vars(base).get("__annotations__", {}))
    annotation = owner.__annotations__[name]
    assert isinstance(annotation, str), f"{owner.__module__} lacks `from __future__ import annotations`"
    return annotation, owner.__module__


def _find_names(annotation: str) -> Iterator[str]:
    """Yield the names in an annotation that have to be imported."""
    for node in ast.walk(ast.parse(annotation, mode="eval")):
        if isinstance(node, ast.Name) and node.id not in _BUILTIN:
            yield node.id


def _find_import(module: str, name: str) -> tuple[str, str]:
    """Find the module and name to import for a used name.

    The name is "as NAME" if a whole module is imported under that name.
    """
    return _find_imports(module).get(name, (module, name))


@cache
def _find_imports(module: str) -> dict[str, tuple[str, str]]:
    source = inspect.getsource(importlib.import_module(module))
    found = {}
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom):
            found.update({alias.name: (node.module or "", alias.name) for alias in node.names})
        elif isinstance(node, ast.Import):
            names = [(alias.name, alias.asname or alias.name) for alias in node.names]
            found.update({own: (name, f"as {own}") for name, own in names})
    return found


def _format(text: str, path: Path) -> str:
    """Format a source with ruff, imports sorted."""
    for words in (["check", "--quiet", "--select=I", "--fix"], ["format", "--quiet"]):
        command = [sys.executable, "-m", "ruff", *words, f"--stdin-filename={path}", "-"]
        done = subprocess.run(
            command, input=text, capture_output=True, text=True, encoding="utf-8", check=True, cwd=ROOT
        )
        text = done.stdout
    return text


if __name__ == "__main__":
    KEYWORDS.write_text(write_keywords(), encoding="utf-8", newline="\n")
    PACKAGE.write_text(write_package(), encoding="utf-8", newline="\n")
