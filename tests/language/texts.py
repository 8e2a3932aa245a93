"""Docstrings, comments and prose of the repository, each with its file and line."""

from __future__ import annotations

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]
CODE_FOLDERS = ("stages", "pipeline", "cli", "scanloom", "benches", "docs", "samples", "packaging", "kernels")
IGNORED_FOLDERS = {"node_modules", "target", "__pycache__"}
# Directives for tools, which are no prose.
DIRECTIVE = re.compile(r"#(!| ?type:| ?noqa| ?ruff:| ?mypy:)")


class Text(NamedTuple):
    """One docstring, comment block or line of prose."""

    kind: str
    file: str
    line: int
    text: str


def list_files(suffix: str) -> list[Path]:
    """List the files with a suffix, without generated folders; Markdown also at the top."""
    found = [path for folder in CODE_FOLDERS for path in (ROOT / folder).rglob(f"*{suffix}")]
    if suffix == ".md":
        found += ROOT.glob("*.md")
    return sorted(path for path in found if not IGNORED_FOLDERS.intersection(path.relative_to(ROOT).parts))


def read_texts() -> Iterator[Text]:
    """Read every text that the check of phrases covers."""
    for path in list_files(".py"):
        yield from _read_python(path, "docstrings", "comments")
    for path in sorted((ROOT / "tests").rglob("*.py")):
        yield from _read_python(path, "docstrings of tests", "comments of tests")
    for path in list_files(".rs"):
        for line, text in _read_rust_comments(path.read_text(encoding="utf-8")):
            yield Text("Rust comments", path.relative_to(ROOT).as_posix(), line, text)
    for path in list_files(".md"):
        for line, text in _read_prose(path.read_text(encoding="utf-8")):
            yield Text("lines of documentation", path.relative_to(ROOT).as_posix(), line, text)


def _read_python(path: Path, docstrings: str, comments: str) -> Iterator[Text]:
    source = path.read_text(encoding="utf-8")
    name = path.relative_to(ROOT).as_posix()
    for line, text in _read_docstrings(source):
        yield Text(docstrings, name, line, text)
    for line, text in _read_comments(source):
        yield Text(comments, name, line, text)


def _read_docstrings(source: str) -> Iterator[tuple[int, str]]:
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            text = ast.get_docstring(node)
            if text:
                yield node.body[0].lineno, text


def _read_comments(source: str) -> Iterator[tuple[int, str]]:
    block: list[tuple[int, str]] = []
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type != tokenize.COMMENT or DIRECTIVE.match(token.string):
            continue
        line = token.start[0]
        if block and block[-1][0] != line - 1:
            yield block[0][0], " ".join(text for _, text in block)
            block = []
        block.append((line, token.string.lstrip("# ")))
    if block:
        yield block[0][0], " ".join(text for _, text in block)


def _read_rust_comments(source: str) -> Iterator[tuple[int, str]]:
    block: list[str] = []
    first = 0
    for number, line in enumerate([*source.splitlines(), ""], 1):
        found = re.match(r"\s*//[/!]?\s?(.*)", line)
        if found:
            first = first or number
            block.append(found[1])
        elif block:
            yield first, " ".join(block)
            block, first = [], 0


def _read_prose(source: str) -> Iterator[tuple[int, str]]:
    is_code = False
    for number, line in enumerate(source.splitlines(), 1):
        if line.lstrip().startswith("```"):
            is_code = not is_code
        elif not is_code and len(line.split()) > 4:
            yield number, line
