"""Malicious documents, which would stall or break a parser, give one error."""

from __future__ import annotations

from pathlib import Path

import pytest

from scanloom.pipeline.config import Config
from scanloom.stages.diagnostics.errors import InputError, UsageError
from scanloom.stages.files import documents
from scanloom.stages.files.documents import read_document, read_json
from scanloom.stages.files.number_rows import parse_number_row
from scanloom.stages.scans.image_folders.image_files import extract_numbers

MANY = 100_000
DEEP = {
    "flow.yaml": "[" * MANY,
    "pairs.yaml": "{a: " * MANY,
    "dashes.yaml": "- " * MANY,
    "questions.yaml": "? " * MANY,
    "indents.yaml": "\n".join(" " * i + "a:" for i in range(300)),
    "arrays.toml": "a=" + "[" * MANY,
    "tables.toml": "a=" + "{a=" * MANY,
    "dots.toml": "a." * MANY + "a=1",
    "heads.toml": "[" + "a." * MANY + "a]",
    "quoted.toml": '"a".' * MANY + "a=1",
    "a.json": '{"a":' * 900 + "1" + "}" * 900,
    "b.json": '{"a":' + "[" * 900 + "]" * 900 + "}",
    "c.json": '{"a":' * MANY,
    "a.xml": "<opencv_storage>" + "<a>" * 900 + "</a>" * 900 + "</opencv_storage>",
    "b.xml": "<opencv_storage>" + "<a>" * MANY + "</a>" * MANY + "</opencv_storage>",
}


@pytest.mark.parametrize("name", DEEP)
def test_deep_nesting_is_one_error(tmp_path: Path, name: str) -> None:
    """Such YAML took minutes to parse; such JSON exceeded the recursion limit of its readers."""
    (tmp_path / name).write_text(DEEP[name])
    message = "is not valid JSON" if name.endswith(".json") else "does not parse: it is nested"
    with pytest.raises(InputError, match=rf"{name}: the file {message}"):
        read_document(tmp_path / name)
    if name.endswith(".json"):
        with pytest.raises(InputError, match=rf"{name}: the file is not valid JSON"):
            read_json(tmp_path / name)
    if name.endswith(".toml"):
        with pytest.raises(UsageError, match=rf"{name}: this is not TOML \(it is nested"):
            Config.load(tmp_path / name)


def test_normal_nesting_is_accepted(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text("a: [[[[1, 2]]]]\nb:\n  - c:\n      - d: {e: {f: 1.5}}\n")
    assert read_document(tmp_path / "a.yaml") == {"a": [[[[1, 2]]]], "b": [{"c": [{"d": {"e": {"f": 1.5}}}]}]}
    (tmp_path / "a.toml").write_text("# " + "." * 100 + "\n" + f"a = [{'1.0, ' * 500}]\n[b.c.d]\ne = 'f.g'\n")
    assert read_document(tmp_path / "a.toml")["b"] == {"c": {"d": {"e": "f.g"}}}


LONG = {
    "decimal.yaml": ("a: " + "9" * 5000, "a number has 5,000 digits"),
    "hexadecimal.yaml": ("a: 0x" + "f" * 100_000, "a number has 100,002 digits"),
    "binary.yaml": ("a: 0b" + "1" * 100_000, "a number has 100,002 digits"),
    "decimal.toml": ("a = " + "9" * 5000, "it holds an integer of more than 64 bits"),
    "hexadecimal.toml": ("a = 0x" + "f" * 100_000, "it holds an integer of more than 64 bits"),
    "inside.toml": ("a = [[{b = 0x" + "f" * 17 + "}]]", "it holds an integer of more than 64 bits"),
}


@pytest.mark.parametrize("name", LONG)
def test_numbers_with_thousands_of_digits_are_one_error(tmp_path: Path, name: str) -> None:
    text, message = LONG[name]
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=rf"{name}: the file does not parse: {message}\.$"):
        read_document(tmp_path / name)
    if name.endswith(".toml"):
        with pytest.raises(UsageError, match=rf"{name}: this is not TOML \({message}\)\.$"):
            Config.load(tmp_path / name)


def test_sexagesimal_numbers_are_text(tmp_path: Path) -> None:
    """A file of 256 kB with such numbers took minutes, and 1:30 is not intended as 90."""
    lines = ("a: 1" + ":10" * 60_000, "b: 1:30", "c: 1:30.5", "d: 0x1f", "e: -1_0", "f: 1.5e+3")
    (tmp_path / "a.yaml").write_text("\n".join(lines))
    found = read_document(tmp_path / "a.yaml")
    assert isinstance(found["a"], str)
    assert [found[key] for key in "bcdef"] == ["1:30", "1:30.5", 31, -10, 1500.0]


@pytest.mark.parametrize("name", ["a.yaml", "a.toml", "a.json", "a.xml"])
def test_a_document_of_megabytes_is_refused_before_reading(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(b" " * (5 << 20))
    with pytest.raises(InputError, match="the file is too large: it has 5,242,880 bytes, and at most"):
        read_document(tmp_path / name)


def test_a_configuration_of_megabytes_is_refused_before_reading(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_bytes(b"\n" * (5 << 20))
    with pytest.raises(UsageError, match=r"a\.toml: the file is too large for a configuration"):
        Config.load(tmp_path / "a.toml")


def test_thousands_of_digits_in_a_name_are_truncated() -> None:
    assert extract_numbers("9" * 10_000) == (int("9" * 255),)
    assert extract_numbers("cam0_0012") == (0, 12)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "latin-1"])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_encodings_and_line_ends_of_all_systems_are_read(tmp_path, encoding, end):
    mark = {"utf-16-le": b"\xff\xfe", "utf-16-be": b"\xfe\xff"}.get(encoding, b"")
    text = f"# Gr\u00f6\u00dfe{end}1 2{end}3 4{end}"
    (tmp_path / "a.txt").write_bytes(mark + text.encode(encoding))
    assert list(documents.iterate_lines(tmp_path / "a.txt")) == [(2, "1 2"), (3, "3 4")]


@pytest.mark.parametrize("data", [b"\x00\x01\x02\xff", b"\xff\xfe\x00\xd8", b"1 2\x00\xe9"])
def test_binary_files_are_refused(tmp_path, data):
    (tmp_path / "a.txt").write_bytes(data)
    with pytest.raises(InputError, match="a text file is expected; this one is binary"):
        documents.read_text(tmp_path / "a.txt")


@pytest.mark.parametrize(
    ("line", "numbers"),
    [
        ("1 2.5 -3e2", [1, 2.5, -300]),
        ("1,2.5,-3e2", [1, 2.5, -300]),
        ("1, 2, 3", [1, 2, 3]),
        ("1;2.5;3;", [1, 2.5, 3]),
        ("0,7635 -1,5e-3 2", [0.7635, -0.0015, 2]),
        ("0,5;1,25", [0.5, 1.25]),
        ("1,0,0 0,1,0", [1, 0, 0, 0, 1, 0]),
        ("1,2", [1, 2]),
    ],
)
def test_number_rows_are_parsed(line, numbers):
    assert parse_number_row(line) == numbers


@pytest.mark.parametrize("line", ["1 a", "1,,2", "0,5 a", "1.5,5 0.3x"])
def test_text_in_a_number_row_is_an_error(line):
    with pytest.raises(ValueError, match="could not convert"):
        parse_number_row(line)


def test_backslashes_of_windows_are_path_separators(tmp_path):
    assert documents.require_inside("rgb\\1.png", tmp_path, "line 1") == "rgb/1.png"
    with pytest.raises(InputError, match="is not a path inside the folder"):
        documents.require_inside("..\\1.png", tmp_path, "line 1")


@pytest.mark.parametrize("name", ["a.json", "a.yaml"])
def test_integers_beyond_64_bits_are_floats(tmp_path: Path, name: str) -> None:
    """Their conversion to float64 raised OverflowError in many readers."""
    path = tmp_path / name
    for digits in ("9" * 19, "1" + "0" * 30, "9" * 399, "-" + "9" * 399):
        path.write_text(f'{{"a": [{digits}, 7]}}')
        number, seven = read_document(path)["a"]
        assert type(number) is float
        assert number == float(digits)
        assert type(seven) is int


def test_assignments_are_lines_with_a_name() -> None:
    text = "  a_1 = 2 = 3 \nb: 4\n= 5\na b = 6\n\nc=\na_1=7\n"
    assert documents.parse_assignments(text) == {"a_1": "7", "c": ""}
    assert documents.parse_assignments(text, ":=") == {"a_1": "7", "b": "4", "c": ""}
