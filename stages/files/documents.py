"""Read text, JSON, TOML and YAML files from outside: each fault a plain sentence with the file's name.

Nothing in a file is executed or trusted: YAML goes through PyYAML's safe loader, sizes are bounded.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any

from stages.errors import InputError

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

# Half a gigabyte of text is more than any trajectory; a calibration is a page or two.
_MAX_TEXT_BYTES = 1 << 29
_MAX_DOCUMENT_BYTES = 1 << 22
_LONGEST_NAME = 255


def read_text(path: Path) -> str:
    """Return a text file's content, with a plain sentence when it cannot be read."""
    try:
        if path.stat().st_size > _MAX_TEXT_BYTES:
            raise InputError("the file is too large for what it should hold.", path)
        return path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise InputError(f"the file cannot be read ({error.strerror}).", path) from error
    except UnicodeDecodeError as error:
        raise InputError("a text file is expected; this one is binary.", path) from error


def lines(path: Path) -> Iterator[tuple[int, str]]:
    """Yield line numbers (from 1) and the text on them, without `#` comments and empty lines."""
    for number, line in enumerate(read_text(path).splitlines(), 1):
        text = line.split("#")[0].strip().strip(",")
        if text:
            yield number, text


def require_inside(name: str, path: Path, where: str) -> str:
    """Return a file name that a list states: a path below a folder, of names that file systems allow.

    Raises
    ------
    InputError
        If it is something else. A scan is read from its own folder only: its lists may come from anywhere.
    """
    parts = name.split("/")
    if (
        not all(parts)
        or PurePosixPath(name).is_absolute()
        or ".." in parts
        or "\0" in name
        or max(len(part.encode("utf-8", "replace")) for part in parts) > _LONGEST_NAME
    ):
        raise InputError(f"{where}: {name[:100]!r} is not a path inside the folder.", path)
    return name


def read_json(path: Path) -> object:
    """Return a JSON file's content; NaN and infinite numbers are let through for the checks that follow."""
    return parse_json(read_text(path), path)


def parse_json(text: str, path: Path) -> object:
    """Return the content of JSON text that comes from `path`, as `read_json` does."""
    try:
        document: object = json.loads(text)
    except (ValueError, RecursionError) as error:
        line = f"; look at line {error.lineno}" if isinstance(error, json.JSONDecodeError) else ""
        raise InputError(f"the file is not valid JSON{line}.", path) from error
    return document


def read_document(path: Path) -> dict[str, Any]:
    """Return the content of a JSON, TOML or YAML file, or one of OpenCV's in YAML or XML, as a dictionary.

    Raises
    ------
    InputError
        If the file cannot be read or parsed, or holds no table of names and values.
    """
    if path.exists() and path.stat().st_size > _MAX_DOCUMENT_BYTES:
        raise InputError("the file is too large for what it should hold.", path)
    text = read_text(path)
    try:
        if path.suffix == ".json":
            document = read_json(path)
        elif path.suffix == ".toml":
            document = _parse_toml(text)
        elif path.suffix == ".xml":
            document = _parse_xml(text)
        else:
            document = _parse_yaml(text)
    except (ValueError, RecursionError) as error:
        summary = " ".join(str(error).split())[:200]
        raise InputError(f"the file does not parse: {summary}.", path) from error
    if not isinstance(document, dict):
        raise InputError("names with values are expected in it.", path)
    return document


def _parse_toml(text: str) -> object:
    if sys.version_info >= (3, 11):
        import tomllib
    else:
        import tomli as tomllib

    return tomllib.loads(text)


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


def _xml_value(node: Element) -> object:
    if node.get("type_id") == "opencv-matrix":
        fields = {field.tag: (field.text or "").strip() for field in node}
        return {**fields, "data": fields.get("data", "").split()}
    if len(node):
        return {field.tag: _xml_value(field) for field in node}
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

    def matrix(loader: yaml.SafeLoader, node: yaml.Node) -> dict[Any, Any]:
        if not isinstance(node, yaml.MappingNode):
            raise yaml.YAMLError("an opencv-matrix is not a mapping")
        return loader.construct_mapping(node, deep=True)

    Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", matrix)
    try:
        # OpenCV's first line, `%YAML:1.0`, is no YAML directive (that would be `%YAML 1.0`).
        text = re.sub(r"\A%YAML:?\s*[\d.]+", "", text)
        # What ROS echoes of a message ends with the start of a next one.
        document: object = yaml.load(re.sub(r"\n---\s*\Z", "\n", text), Loader)
    except yaml.MarkedYAMLError as error:
        where = "" if error.problem_mark is None else f"line {error.problem_mark.line + 1}: "
        raise ValueError(f"{where}{error.problem or error.context}") from error
    except yaml.YAMLError as error:
        raise ValueError(str(error)) from error
    return document
