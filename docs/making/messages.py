"""What scanloom says when something is wrong: every place of the sources, and the pages that explain it.

A message is found by where it goes: into an error, or by an argument, a list or a function whose name says
that it holds what a person is told. Its form is its text with `…` for what differs. The pages in
docs/when-it-goes-wrong/ list these forms, each as a point of nothing but code.

    PYTHONPATH=.:docs python -m making.messages

prints what no page lists, ready to be put into one, and what a page lists that nothing says any more.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from making.markdown import code

ROOT = Path(__file__).resolve().parents[2]
ROOMS = ("cli", "pipeline", "stages")
# Where kernels say what is wrong; Python passes it on.
KERNELS = ("kernels/src/base/errors.rs", "kernels/src/snm/error.rs")
PAGES = ROOT / "docs" / "when-it-goes-wrong"

# What is called with a text that a person reads.
_CALLS = {
    "InputError", "MeshError", "OutgrownError", "StageError", "UsageError", "_MalformedError",
    "Failure", "NoMotion", "Refused", "SkippedFrame", "Warned",
    "_apart", "_refuse", "_warn", "explained", "note", "refuse", "tell", "unmet", "warn", "without_depth",
}  # fmt: skip
# Lists that such texts are put into, and variables and arguments that hold them.
_NAMES = {
    "NOT_METRES", "TEXTURE_LEFT_OUT", "_ADVICE", "_DAMAGED", "_KINDS", "_MACHINE_ERRORS", "_PATH_ERRORS",
    "_PUBLISHED", "_TOO_DEEP", "_TOO_LONG", "REASONS",
    "_notes", "alone", "doubts", "fault", "found", "lacking", "left_out", "lost", "message", "missing",
    "note", "notes", "problem", "reasons", "said", "skipped", "unregistered", "warnings", "what", "why",
    "wrong",
}  # fmt: skip
# Functions that return or yield them.
_FUNCTIONS = re.compile(
    "warnings|doubts|unmet|too_far|not_proven|crowded|lines_left_out|trouble|explain|guessed|why|reason"
    "|_least_confidence|least_confidence|about_order|unknown_place|misfit|depth_range|markers|least_sharp"
    "|odd_sizes|check_poses|_unregistered|strays|judged|refusal|unknown|without_images|drifted|pieces"
    "|largest|left_alone|repeating|without_surface|skipped|_camera$|_found$|_told$|_poses$|_path$|malformed"
)
# Layouts say what their folders look like, which nobody is warned of.
_NEVER = {"Layout", "Method", "Option", "Argument", "compile", "fullmatch", "match", "param", "search"}

# Texts that go the same ways and are no messages, or parts of one that is listed.
NOT_MESSAGES = {
    ", or lower depth.agreeing_views.",
    "; without, `scanloom run` finds them",
    "PRAGMA table_info(…)",
    "normals of corners",
    "nothing is recognised in both, and ",
    "poses and colour camera",
    "rgb.txt and depth.txt",
    "the base mesh",
    "text/html; charset=utf-8",
    "text/javascript; charset=utf-8",
    "text/plain; charset=utf-8",
    "…, at ……, the worst about ….",
}


@dataclass(frozen=True)
class Message:
    """One place that says something.

    Attributes
    ----------
    form : the text, with `…` for what differs.
    file, line : where it stands in the sources.
    """

    form: str
    file: str
    line: int


@dataclass(frozen=True)
class Entry:
    """A message as a page lists it.

    Attributes
    ----------
    form : the text, with `…` for what differs.
    page, heading : where it is explained.
    """

    form: str
    page: str
    heading: str


def messages() -> Iterator[Message]:
    """Return every message of the sources, by file."""
    for room in ROOMS:
        for path in sorted((ROOT / room).rglob("*.py")):
            yield from _in_file(path)
    for name in KERNELS:
        yield from _in_rust(ROOT / name)


def entries() -> Iterator[Entry]:
    """Return every message that the pages list, by page."""
    for path in sorted(PAGES.glob("*.md")):
        heading = ""
        for line in path.read_text(encoding="utf-8").splitlines():
            if line.startswith("#"):
                heading = line.strip("# ")
            elif point := re.fullmatch(r"- (`+) ?(.*?) ?\1", line):
                yield Entry(point[2], path.name, heading)


def unexplained() -> list[Message]:
    """Return the messages that no page lists."""
    listed = {entry.form for entry in entries()}
    return [message for message in messages() if message.form not in listed]


def outdated() -> list[Entry]:
    """Return what pages list and nothing says any more."""
    said = {message.form for message in messages()}
    return [entry for entry in entries() if entry.form not in said]


def _even(text: str) -> str:
    return re.sub(r"\s+", " ", text).strip()


def _in_file(path: Path) -> Iterator[Message]:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    above = {below: node for node in ast.walk(tree) for below in ast.iter_child_nodes(node)}
    for node in ast.walk(tree):
        form = _form(node)
        if form is None or isinstance(above[node], (ast.JoinedStr, ast.FormattedValue)):
            continue
        if _is_sentence(form) and _is_told(node, above):
            yield Message(_even(form), path.relative_to(ROOT).as_posix(), getattr(node, "lineno", 0))


def _in_rust(path: Path) -> Iterator[Message]:
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        for text in re.findall(r'"((?:[^"\\]|\\.)*)"', line.partition("//")[0]):
            form = re.sub(r"\{[^}]*\}", "…", text)
            if _is_sentence(form):
                yield Message(form, path.relative_to(ROOT).as_posix(), number)


def _is_sentence(form: str) -> bool:
    """Whether a text has more than a word or two, which are a name, or a part of what is said."""
    words = re.findall(r"[^\W\d_]{2,}", form)
    return len(words) > 2 and " " in form and form not in NOT_MESSAGES


def _form(node: ast.AST) -> str | None:
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    if isinstance(node, ast.JoinedStr):
        return "".join(str(part.value) if isinstance(part, ast.Constant) else "…" for part in node.values)
    return None


def _is_told(node: ast.AST, above: dict[ast.AST, ast.AST]) -> bool:
    """Whether a text goes to where a person is told of something."""
    is_returned = False
    below, up = node, above.get(node)
    while up is not None:
        if isinstance(up, ast.Call) and below is not up.func:
            called = _last_name(up.func)
            if called in _NEVER:
                return False
            if called in _CALLS or (called in ("append", "extend") and _owner(up.func) in _NAMES):
                return True
        elif isinstance(up, ast.keyword):
            if up.arg in _NAMES:
                return True
        elif isinstance(up, (ast.Assign, ast.AnnAssign, ast.AugAssign)):
            targets = up.targets if isinstance(up, ast.Assign) else [up.target]
            return any(_last_name(target) in _NAMES for target in targets)
        elif isinstance(up, (ast.Return, ast.Yield)):
            is_returned = True
        elif isinstance(up, ast.FunctionDef):
            return is_returned and _FUNCTIONS.search(up.name) is not None
        below, up = up, above.get(up)
    return False


def _owner(node: ast.AST) -> str:
    return _last_name(node.value) if isinstance(node, ast.Attribute) else ""


def _last_name(node: ast.AST) -> str:
    if isinstance(node, ast.Subscript):
        return _last_name(node.value)
    return node.id if isinstance(node, ast.Name) else getattr(node, "attr", "")


if __name__ == "__main__":
    for message in unexplained():
        sys.stdout.write(f"- {code(message.form)}  ({message.file}:{message.line})\n")
    for entry in outdated():
        sys.stdout.write(f"nothing says what {entry.page} has under {entry.heading}: {entry.form}\n")
