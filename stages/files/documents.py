"""Readers for text, JSON, TOML, YAML and XML from untrusted sources.

Every error message names the file. YAML is read by PyYAML's safe loader, and the size and nesting of all
documents are limited.
"""

from __future__ import annotations

import json
import math
import re
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.codes import FILE_PATH_OUTSIDE, FILE_TEXT_INVALID, FILE_UNREADABLE
from scanloom.stages.files.input_files import open_input, read_input_text
from scanloom.stages.files.path_safety import is_safe_relative_path

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

# Bytes. The largest trajectories stay far below 512 MiB; calibrations are a few kilobytes.
_MAX_TEXT_BYTES = 1 << 29
_MAX_DOCUMENT_BYTES = 1 << 22
# Bytes; PyYAML parses only about 100 kB/s.
_MAX_YAML_BYTES = 1 << 19
_MAX_NAME_BYTES = 255
_UTF16_MARKS = (b"\xff\xfe", b"\xfe\xff")
_CONTROL_CHARACTERS = re.compile("[\x00-\x08\x0e-\x1f\x7f-\x84\x86-\x9f]")
# Maximum nesting depth; documents of scans have about ten levels.
_MAX_NESTING = 64
_TOO_DEEP = f"it is nested more than {_MAX_NESTING} levels deep"
_TOO_LONG = "it holds an integer of more than 64 bits"
# Maximum digits of a number in YAML. TOML integers and timestamps in nanoseconds fit 64 bits (19 digits).
_MAX_NUMBER_DIGITS = 400


def read_text(path: Path) -> str:
    """Read a text file as UTF-8, UTF-16 or Latin-1.

    UTF-16 is recognised by its byte order mark (PowerShell writes it). Bytes that are not UTF-8 are read as
    Latin-1, unless they contain control characters.

    Raises
    ------
    InputError
        If the file cannot be read, is larger than 512 MiB, or is binary.
    """
    try:
        size = path.stat().st_size
        if size > _MAX_TEXT_BYTES:
            raise InputError(
                FILE_TEXT_INVALID,
                "the file is too large: it has {size:,} bytes, and at most {limit:,} are expected.",
                path,
                size=size,
                limit=_MAX_TEXT_BYTES,
            )
        with open_input(path) as file:
            is_wide = file.read(2) in _UTF16_MARKS
        try:
            return read_input_text(path, "utf-16" if is_wide else "utf-8-sig")
        except UnicodeDecodeError:
            text = read_input_text(path, "latin-1")
            if is_wide or _CONTROL_CHARACTERS.search(text):
                raise
            return text
    except OSError as error:
        raise InputError(
            FILE_UNREADABLE, "the file cannot be read ({strerror}).", path, strerror=error.strerror
        ) from error
    except UnicodeDecodeError as error:
        raise InputError(FILE_TEXT_INVALID, "a text file is expected; this one is binary.", path) from error


def iterate_lines(path: Path) -> Iterator[tuple[int, str]]:
    """Yield (line number from 1, text) of each line with content.

    `#` comments, surrounding white space and commas are stripped; empty lines are skipped.
    """
    for number, line in enumerate(read_text(path).splitlines(), 1):
        text = line.split("#")[0].strip().strip(",")
        if text:
            yield number, text


def parse_assignments(text: str, separators: str = "=") -> dict[str, str]:
    """Parse lines `name = value` into a dictionary.

    The last value of a name is used. Other lines are ignored.

    Parameters
    ----------
    separators : characters that may stand between name and value.
    """
    found: dict[str, str] = {}
    for line in filter(None, text.split("\n")):
        at = min((k for k in map(line.find, separators) if k >= 0), default=-1)
        name = line[: max(at, 0)].strip()
        if name.replace("_", "a").isalnum():
            found[name] = line[at + 1 :].strip()
    return found


def require_inside(name: str, path: Path, location: str) -> str:
    r"""Validate a file name listed in a scan as a relative path.

    Scans come from untrusted sources, so their lists may only name files inside the scan folder. `\` is
    accepted as a separator (Windows) and replaced by `/`.

    Raises
    ------
    InputError
        If the name is absolute, contains `..`, or has a part of more than 255 bytes.
    """
    name = name.replace("\\", "/")
    parts = name.split("/")
    if (
        not all(parts)
        or not is_safe_relative_path(name)
        or max(len(part.encode("utf-8", "replace")) for part in parts) > _MAX_NAME_BYTES
    ):
        raise InputError(
            FILE_PATH_OUTSIDE,
            "{place}: {name!r} is not a path inside the folder.",
            path,
            place=location,
            name=name[:100],
        )
    return name


def read_json(path: Path) -> object:
    """Read a JSON file.

    NaN and infinity are accepted; callers check their numbers.

    Raises
    ------
    InputError
        If the file cannot be read, is not valid JSON, or is nested too deeply.
    """
    return parse_json(read_text(path), path)


def parse_json(text: str, path: Path) -> object:
    """Parse JSON text; `path` names its source in messages (see `read_json`)."""
    try:
        document: object = json.loads(text, parse_int=parse_short_integer)
        require_shallow(document)
    except (ValueError, RecursionError) as error:
        line = f" (line {error.lineno})" if isinstance(error, json.JSONDecodeError) else ""
        raise InputError(FILE_TEXT_INVALID, "the file is not valid JSON{line}.", path, line=line) from error
    return document


def parse_short_integer(digits: str) -> int | float:
    """Parse the digits of an integer; as a float if it has more than 64 bits.

    Longer integers cannot be converted to float64, which raises OverflowError in many places.
    """
    number = int(digits) if len(digits) < 20 else 1 << 64
    return number if -(1 << 63) <= number < 1 << 63 else float(digits)


def require_shallow(document: object) -> None:
    """Raise ValueError if a document is nested too deeply.

    Deeper nesting could overflow the stack of recursive functions.
    """
    level: list[Any] = [document]
    for _ in range(_MAX_NESTING):
        level = [item for held in level for item in _get_children(held) if isinstance(item, (dict, list))]
        if not level:
            return
    raise ValueError(_TOO_DEEP)


def _get_children(value: object) -> Iterable[object]:
    return value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()


def read_document(path: Path) -> dict[str, Any]:
    """Read a JSON, TOML, YAML or OpenCV XML file as a dictionary.

    The suffix selects the format; other suffixes than .json, .toml and .xml are read as YAML.

    Raises
    ------
    InputError
        If the file cannot be read or parsed, is too large, or is not a table of names and values.
    """
    max_bytes = _MAX_DOCUMENT_BYTES if path.suffix in (".json", ".toml", ".xml") else _MAX_YAML_BYTES
    if path.exists() and (size := path.stat().st_size) > max_bytes:
        raise InputError(
            FILE_TEXT_INVALID,
            "the file is too large: it has {size:,} bytes, and at most {limit:,} are expected.",
            path,
            size=size,
            limit=max_bytes,
        )
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
        raise InputError(FILE_TEXT_INVALID, "the file is not a table of names and values.", path)
    return document


def parse_toml(text: str) -> dict[str, Any]:
    """Parse a TOML document.

    Raises
    ------
    ValueError
        If the text is not TOML, holds an integer of more than 64 bits, or is nested too deeply. The message
        states the reason.
    """
    if sys.version_info >= (3, 11):
        import tomllib
    else:
        import tomli as tomllib

    # Between separators there is one key or value. The parser needs quadratic time in the dots of a key, so
    # keys with too many dots are rejected first.
    if any(piece.partition("#")[0].count(".") > _MAX_NESTING for piece in re.split(r"[,={}\[\]\n]", text)):
        raise ValueError(_TOO_DEEP)
    try:
        document: dict[str, Any] = tomllib.loads(text)
    except tomllib.TOMLDecodeError:
        raise
    except ValueError as error:
        raise ValueError(_TOO_LONG) from error  # raised by Python's limit on digits of an integer
    except RecursionError as error:
        raise ValueError(_TOO_DEEP) from error
    require_shallow(document)
    _require_short_numbers(document)
    return document


def _require_short_numbers(value: object) -> None:
    # TOML integers have at most 64 bits. Python refuses to print very long integers, even in an error
    # message.
    if isinstance(value, int) and not -(1 << 63) <= value < 1 << 63:
        raise ValueError(_TOO_LONG)
    if isinstance(value, (dict, list)):
        for item in value.values() if isinstance(value, dict) else value:
            _require_short_numbers(item)


def _parse_xml(text: str) -> object:
    """Parse OpenCV's XML storage.

    Values are numbers, words, and matrices with rows, cols and data.
    """
    from xml.etree import ElementTree

    # OpenCV writes no DOCTYPE; entities could expand to billions of characters.
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise ValueError("it declares a document type, which is not supported")
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise ValueError(str(error)) from error
    if root.tag != "opencv_storage":
        raise ValueError(f"it is not an OpenCV file: its root tag is {root.tag[:40]}, not opencv_storage")
    return {node.tag: _parse_xml_value(node) for node in root}


def _parse_xml_value(node: Element, depth: int = 0) -> object:
    if depth > _MAX_NESTING:
        raise ValueError(_TOO_DEEP)
    if node.get("type_id") == "opencv-matrix":
        fields = {field.tag: (field.text or "").strip() for field in node}
        return {**fields, "data": fields.get("data", "").split()}
    if len(node):
        return {field.tag: _parse_xml_value(field, depth + 1) for field in node}
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
        """PyYAML's safe loader with OpenCV matrices and without aliases."""

        def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
            # A few lines of nested aliases can expand to billions of values.
            if self.check_event(yaml.AliasEvent):
                raise yaml.YAMLError("aliases (*name) are not supported")
            return super().compose_node(parent, index)

        # PyYAML visits every open level again for each token, so depth is limited while parsing.
        def fetch_flow_collection_start(self, kind: type[yaml.Token]) -> None:
            require_shallow_at(self.flow_level)
            super().fetch_flow_collection_start(kind)

        def add_indent(self, column: int) -> bool:
            require_shallow_at(len(self.indents))
            return bool(super().add_indent(column))

    def require_shallow_at(depth: int) -> None:
        if depth > _MAX_NESTING:
            raise yaml.YAMLError(_TOO_DEEP)

    def parse_number(loader: yaml.SafeLoader, node: yaml.ScalarNode) -> int | float | str:
        # YAML 1.1 reads 1:30 as a base-60 number, and needs quadratic time for long ones.
        if ":" in node.value:
            return str(node.value)
        if len(node.value) > _MAX_NUMBER_DIGITS:
            raise yaml.YAMLError(f"a number has {len(node.value):,} digits")
        if not node.tag.endswith(":int"):
            return loader.construct_yaml_float(node)
        number: int = loader.construct_yaml_int(node)
        if -(1 << 63) <= number < 1 << 63:
            return number
        if number.bit_length() > 1000:
            return math.inf if number > 0 else -math.inf
        return float(number)

    def create_matrix(loader: yaml.SafeLoader, node: yaml.Node) -> dict[Any, Any]:
        if not isinstance(node, yaml.MappingNode):
            raise yaml.YAMLError("an opencv-matrix is not a mapping")
        return loader.construct_mapping(node, deep=True)

    Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", create_matrix)
    for kind in ("int", "float"):
        Loader.add_constructor(f"tag:yaml.org,2002:{kind}", parse_number)
    try:
        # OpenCV's first line, `%YAML:1.0`, is not a valid YAML directive (`%YAML 1.0` would be).
        header = re.match(r"%YAML:?\s*[\d.]+", text)
        if header is not None:
            # OpenCV accepts `PointSize:2` without a space; YAML would read it as a string.
            text = re.sub(
                r"^([ \t]*[A-Za-z_][\w.]*):(?=[^\s:])", r"\1: ", text[header.end() :], flags=re.MULTILINE
            )
        # `rostopic echo` ends each message with the separator of the next document.
        document: object = yaml.load(re.sub(r"\n---\s*\Z", "\n", text), Loader)
    except yaml.MarkedYAMLError as error:
        where = "" if error.problem_mark is None else f"line {error.problem_mark.line + 1}: "
        raise ValueError(f"{where}{error.problem or error.context}") from error
    except yaml.YAMLError as error:
        raise ValueError(str(error)) from error
    return document
