"""Read text, JSON, TOML and YAML files from outside: each fault a plain sentence with the file's name.

Nothing in a file is executed or trusted: YAML goes through PyYAML's safe loader, sizes are bounded.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.codes import FILE_PATH_OUTSIDE, FILE_TEXT_INVALID, FILE_UNREADABLE
from scanloom.stages.files.inside import leads_inside
from scanloom.stages.files.opening import opened, text_in

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

# Half a gigabyte of text is more than any trajectory; a calibration is a page or two.
_MAX_TEXT_BYTES = 1 << 29
_MAX_DOCUMENT_BYTES = 1 << 22
# YAML is read at some 100 kB a second.
_MAX_YAML_BYTES = 1 << 19
_LONGEST_NAME = 255
_WIDE_MARKS = (b"\xff\xfe", b"\xfe\xff")
_NO_TEXT = re.compile("[\x00-\x08\x0e-\x1f\x7f-\x84\x86-\x9f]")
# Tables in tables: scans go ten deep.
_DEEPEST = 64
_TOO_DEEP = f"it is nested more than {_DEEPEST} deep"
_TOO_LONG = "it holds a whole number of more than 64 bits"
# No whole number in a document needs more: TOML has 64 bits, times in nanoseconds fit them.
_LONGEST_NUMBER = 400


def read_text(path: Path) -> str:
    """Return a text file's content, with a plain sentence when it cannot be read.

    UTF-8; UTF-16 where it begins with its mark, as Windows' shell writes it; else Latin-1, which older
    programs wrote, if there is nothing in it that no text has.
    """
    try:
        if path.stat().st_size > _MAX_TEXT_BYTES:
            raise InputError(FILE_TEXT_INVALID, "the file is too large for what it should hold.", path)
        with opened(path) as file:
            is_wide = file.read(2) in _WIDE_MARKS
        try:
            return text_in(path, "utf-16" if is_wide else "utf-8-sig")
        except UnicodeDecodeError:
            text = text_in(path, "latin-1")
            if is_wide or _NO_TEXT.search(text):
                raise
            return text
    except OSError as error:
        raise InputError(
            FILE_UNREADABLE, "the file cannot be read ({strerror}).", path, strerror=error.strerror
        ) from error
    except UnicodeDecodeError as error:
        raise InputError(FILE_TEXT_INVALID, "a text file is expected; this one is binary.", path) from error


def lines(path: Path) -> Iterator[tuple[int, str]]:
    """Yield line numbers (from 1) and the text on them, without `#` comments and empty lines."""
    for number, line in enumerate(read_text(path).splitlines(), 1):
        text = line.split("#")[0].strip().strip(",")
        if text:
            yield number, text


def require_inside(name: str, path: Path, where: str) -> str:
    r"""Return a file name that a list states: a path below a folder, of names that file systems allow.

    A `\` of Windows parts folders as `/` does.

    Raises
    ------
    InputError
        If it is something else. A scan is read from its own folder only: its lists may come from anywhere.
    """
    name = name.replace("\\", "/")
    parts = name.split("/")
    if (
        not all(parts)
        or not leads_inside(name)
        or max(len(part.encode("utf-8", "replace")) for part in parts) > _LONGEST_NAME
    ):
        raise InputError(
            FILE_PATH_OUTSIDE,
            "{place}: {name!r} is not a path inside the folder.",
            path,
            place=where,
            name=name[:100],
        )
    return name


def read_json(path: Path) -> object:
    """Return a JSON file's content; NaN and infinite numbers are let through for the checks that follow."""
    return parse_json(read_text(path), path)


def parse_json(text: str, path: Path) -> object:
    """Return the content of JSON text that comes from `path`, as `read_json` does."""
    try:
        document: object = json.loads(text)
        require_shallow(document)
    except (ValueError, RecursionError) as error:
        line = f"; look at line {error.lineno}" if isinstance(error, json.JSONDecodeError) else ""
        raise InputError(FILE_TEXT_INVALID, "the file is not valid JSON{line}.", path, line=line) from error
    return document


def require_shallow(document: object) -> None:
    """Raise ValueError for tables or lists nested so deep that a walk over them would not end well."""
    level: list[Any] = [document]
    for _ in range(_DEEPEST):
        level = [item for held in level for item in _held(held) if isinstance(item, (dict, list))]
        if not level:
            return
    raise ValueError(_TOO_DEEP)


def _held(value: object) -> Iterable[object]:
    return value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()


def read_document(path: Path) -> dict[str, Any]:
    """Return the content of a JSON, TOML or YAML file, or one of OpenCV's in YAML or XML, as a dictionary.

    Raises
    ------
    InputError
        If the file cannot be read or parsed, or holds no table of names and values.
    """
    most = _MAX_DOCUMENT_BYTES if path.suffix in (".json", ".toml", ".xml") else _MAX_YAML_BYTES
    if path.exists() and path.stat().st_size > most:
        raise InputError(FILE_TEXT_INVALID, "the file is too large for what it should hold.", path)
    text = read_text(path)
    try:
        if path.suffix == ".json":
            document = parse_json(text, path)
        elif path.suffix == ".toml":
            document = parse_toml(text)
        elif path.suffix == ".xml":
            document = _parse_xml(text)
        else:
            document = _parse_yaml(text)
    except (ValueError, RecursionError) as error:
        summary = " ".join(str(error).split())[:200]
        raise InputError(
            FILE_TEXT_INVALID, "the file does not parse: {summary}.", path, summary=summary
        ) from error
    if not isinstance(document, dict):
        raise InputError(FILE_TEXT_INVALID, "names with values are expected in it.", path)
    return document


def parse_toml(text: str) -> dict[str, Any]:
    """Return the content of a TOML document.

    Raises
    ------
    ValueError
        If it is none, or holds a whole number of more than 64 bits or tables nested far too deep; the message
        says which.
    """
    if sys.version_info >= (3, 11):
        import tomllib
    else:
        import tomli as tomllib

    # What stands between separators is a key or a value. The time that keys take grows with the square of
    # their dots.
    if any(piece.partition("#")[0].count(".") > _DEEPEST for piece in re.split(r"[,={}\[\]\n]", text)):
        raise ValueError(_TOO_DEEP)
    try:
        document: dict[str, Any] = tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        raise
    except ValueError as error:
        raise ValueError(_TOO_LONG) from error  # Python's limit on the digits it reads.
    except RecursionError as error:
        raise ValueError(_TOO_DEEP) from error
    require_shallow(document)
    _require_short_numbers(document)
    return document


def _require_short_numbers(value: object) -> None:
    # TOML has no others, and Python cannot even print some, in a message that refuses them.
    if isinstance(value, int) and not -(1 << 63) <= value < 1 << 63:
        raise ValueError(_TOO_LONG)
    if isinstance(value, (dict, list)):
        for item in value.values() if isinstance(value, dict) else value:
            _require_short_numbers(item)


def _parse_xml(text: str) -> object:
    """Return what OpenCV stores in XML: numbers, words, and matrices with their rows, cols and data."""
    from xml.etree import ElementTree

    # OpenCV writes none, and their entities can stand for billions of characters.
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise ValueError("a document type is declared, which is not supported")
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise ValueError(str(error)) from error
    if root.tag != "opencv_storage":
        raise ValueError(f"it is not OpenCV's: its outermost tag is {root.tag[:40]}")
    return {node.tag: _xml_value(node) for node in root}


def _xml_value(node: Element, depth: int = 0) -> object:
    if depth > _DEEPEST:
        raise ValueError(_TOO_DEEP)
    if node.get("type_id") == "opencv-matrix":
        fields = {field.tag: (field.text or "").strip() for field in node}
        return {**fields, "data": fields.get("data", "").split()}
    if len(node):
        return {field.tag: _xml_value(field, depth + 1) for field in node}
    words = (node.text or "").split()
    values = [_number_or_word(word) for word in words]
    return values[0] if len(values) == 1 else values


def _number_or_word(word: str) -> float | str:
    try:
        number = float(word)
    except ValueError:
        return word.strip('"')
    return int(number) if number.is_integer() else number


def _parse_yaml(text: str) -> object:
    import yaml

    class Loader(yaml.SafeLoader):
        """PyYAML's safe loader, with OpenCV's matrices and without aliases."""

        def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
            # Nested aliases of a few lines can stand for billions of values.
            if self.check_event(yaml.AliasEvent):
                raise yaml.YAMLError("aliases (*name) are not supported")
            return super().compose_node(parent, index)

        # Each level is looked at again for each word within it.
        def fetch_flow_collection_start(self, kind: type[yaml.Token]) -> None:
            require_shallow_at(self.flow_level)
            super().fetch_flow_collection_start(kind)

        def add_indent(self, column: int) -> bool:
            require_shallow_at(len(self.indents))
            return bool(super().add_indent(column))

    def require_shallow_at(depth: int) -> None:
        if depth > _DEEPEST:
            raise yaml.YAMLError(_TOO_DEEP)

    def number(loader: yaml.SafeLoader, node: yaml.ScalarNode) -> int | float | str:
        # YAML 1.1 takes 1:30 for ninety, and multiplies numbers of a million such places.
        if ":" in node.value:
            return str(node.value)
        if len(node.value) > _LONGEST_NUMBER:
            raise yaml.YAMLError(f"a number has {len(node.value):,} digits")
        is_whole = node.tag.endswith(":int")
        return loader.construct_yaml_int(node) if is_whole else loader.construct_yaml_float(node)

    def matrix(loader: yaml.SafeLoader, node: yaml.Node) -> dict[Any, Any]:
        if not isinstance(node, yaml.MappingNode):
            raise yaml.YAMLError("an opencv-matrix is not a mapping")
        return loader.construct_mapping(node, deep=True)

    Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", matrix)
    for kind in ("int", "float"):
        Loader.add_constructor(f"tag:yaml.org,2002:{kind}", number)
    try:
        # OpenCV's first line, `%YAML:1.0`, is no YAML directive (that would be `%YAML 1.0`).
        header = re.match(r"%YAML:?\s*[\d.]+", text)
        if header is not None:
            # OpenCV reads `PointSize:2` too, which would be a word.
            text = re.sub(
                r"^(\s*[A-Za-z_][\w.]*):(?=[^\s:])", r"\1: ", text[header.end() :], flags=re.MULTILINE
            )
        # What ROS echoes of a message ends with the start of a next one.
        document: object = yaml.load(re.sub(r"\n---\s*\Z", "\n", text), Loader)
    except yaml.MarkedYAMLError as error:
        where = "" if error.problem_mark is None else f"line {error.problem_mark.line + 1}: "
        raise ValueError(f"{where}{error.problem or error.context}") from error
    except yaml.YAMLError as error:
        raise ValueError(str(error)) from error
    return document
