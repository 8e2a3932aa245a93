"""Output: one JSON object for programs, aligned lines with units for people."""

from __future__ import annotations

import errno
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer

from scanloom import stages
from scanloom.cli.errors import explain_bug, explain_failure
from scanloom.cli.output import Output, format_lines, to_json, to_one_line
from scanloom.pipeline.run.schema import SCHEMA
from scanloom.stages.diagnostics.codes import MACHINE_BUG
from scanloom.stages.diagnostics.errors import (
    InputError,
    MeshError,
    StageError,
    UsageError,
    is_out_of_memory,
)


def test_json_output_has_no_nan_or_infinity() -> None:
    metrics = {
        "psnr_db": float("inf"),
        "nested": {"nan": float("nan"), "list": [1.0, -float("inf")]},
        "count": np.int64(3),
        "row": np.array([1.5, np.nan]),
        "file": Path("a.ply"),
    }
    read = json.loads(to_json(metrics), parse_constant=lambda name: pytest.fail(f"{name} is not JSON"))
    assert read == {
        "psnr_db": None,
        "nested": {"nan": None, "list": [1.0, None]},
        "count": 3,
        "row": [1.5, None],
        "file": "a.ply",
    }


@pytest.mark.parametrize(
    "words",
    [("config",), ("clean", "no-such.ply", "clean.ply"), ("clean", "--no-such-option")],
    ids=["result", "failure", "usage"],
)
def test_results_and_failures_begin_with_the_schema(scanloom: Callable[..., Any], words: tuple[str]) -> None:
    assert next(iter(scanloom(*words, "--json").json.items())) == ("schema", SCHEMA)


def test_bounds_are_rounded_up_and_attained_values_down() -> None:
    metrics = {
        "shape_bound_m": 0.00500001,
        "shape_attained_m": 0.00499999,
        "color_bound_levels": 19.9991,
        "max_shape_m": 0.00500001,
        "color_attained_levels": None,
    }
    assert format_lines(metrics).splitlines() == [
        "shape bound     0.005001 m",
        "shape attained  0.004999 m",
        "color bound     20 levels of 255",
        "max shape       0.005 m",
        "color attained  –",
    ]


def test_text_output_has_units() -> None:
    metrics = {
        "voxel_size_m": 0.0123456,
        "triangles": 1234567,
        "used_ratio": 0.25,
        "scale_m_per_level": 2.0,
        "manifold": True,
        "colour": {"psnr_db": None},
        "skipped": [{"frame": "7", "reason": "dark"}],
        "none": [],
    }
    assert format_lines(metrics).splitlines() == [
        "voxel size  0.01235 m",
        "triangles   1,234,567",
        "used        25 %",
        "scale       2 m per level",
        "manifold    yes",
        "colour",
        "  psnr  –",
        "skipped",
        "  frame   7",
        "  reason  dark",
        "none        –",
    ]


def test_json_is_alone_on_stdout_and_stderr_is_empty(capsys: pytest.CaptureFixture[str]) -> None:
    out = Output(as_json=True)
    out.remark("working")
    with out.progress("work") as progress:
        progress(1, 2)
    out.result({"triangles": 2}, "two triangles")
    captured = capsys.readouterr()
    assert json.loads(captured.out) == {"schema": SCHEMA, "triangles": 2}
    assert captured.err == ""


def test_no_progress_bar_without_a_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    with Output().progress("work") as progress:
        progress(1, 2)
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    ("error", "exit_code", "sentence"),
    [
        (InputError(MACHINE_BUG, "no image.", "a.png"), 3, "a.png: no image."),
        (MeshError(MACHINE_BUG, "bad index.", "a.ply"), 3, "a.ply: bad index."),
        (UsageError(MACHINE_BUG, "wrong."), 2, "wrong."),
        (StageError(MACHINE_BUG, "failed."), 1, "failed."),
        (KeyboardInterrupt(), 130, "Interrupted; finished results are kept."),
        (typer.Abort(), 130, "Interrupted; finished results are kept."),
        (FileNotFoundError(errno.ENOENT, "?", "a.ply"), 3, "a.ply: there is no such file or folder."),
        (PermissionError(errno.EACCES, "?", "out"), 3, "out: the permission is missing."),
        (OSError(errno.ENOSPC, "?", "b"), 1, "b: the disk is full; free some space and run again."),
    ],
)
def test_every_kind_of_failure_has_its_exit_code(error: BaseException, exit_code: int, sentence: str) -> None:
    failure = explain_failure(error)
    assert (failure.exit_code, failure.sentence) == (exit_code, sentence)


@pytest.mark.parametrize(
    "error",
    [
        MemoryError(),
        OSError(errno.ENOMEM, "Cannot allocate memory"),
        ImportError("libx.so: failed to map segment from shared object"),
        SyntaxError("expected ':'", (stages.__file__, 105, 1, "")),
        ImportError("libx.so: cannot create shared object descriptor: Cannot allocate memory"),
        RuntimeError("can't start new thread"),
        RuntimeError("[Open3D Error] (void* Malloc(size_t)) MemoryManagerCPU.cpp:20: CPU malloc failed"),
        RuntimeError(
            "[Open3D Error] VoxelBlockGridImpl.h:1423: Unable to allocate assistance mesh structure"
        ),
    ],
)
def test_out_of_memory_errors_are_explained(error: Exception) -> None:
    assert is_out_of_memory(error)
    failure = explain_failure(error)
    assert failure.exit_code == 1
    assert "memory" in failure.sentence


def test_a_syntax_error_of_foreign_text_is_not_out_of_memory() -> None:
    assert not is_out_of_memory(SyntaxError("expected ':'", ("<string>", 1, 1, "")))


def test_exhausted_static_tls_is_not_out_of_memory() -> None:
    assert not is_out_of_memory(ImportError("libx.so: cannot allocate memory in static TLS block"))


def test_an_unexpected_exception_is_reported_as_a_bug_in_one_line() -> None:
    failure = explain_bug(KeyError("a\nb"))
    assert failure.exit_code == 1
    assert "bug in scanloom" in failure.sentence
    assert "KeyError" in failure.sentence
    assert "--debug" in failure.sentence
    assert "\n" not in failure.sentence


def test_the_middle_of_a_very_long_message_is_omitted() -> None:
    message = to_one_line(f"mesh.ply: its format is {'{' * 1_000_000!r}; ascii is known.")
    assert len(message) < 2100
    assert message.startswith("mesh.ply: its format")
    assert message.endswith("ascii is known.")


NAMES = ("\x1b]0;owned\x07", "\x9b2J", "a\rb", "a\u202eb", "\x08\x08", "\u2028")


@pytest.mark.parametrize("name", NAMES)
def test_control_characters_of_names_are_escaped(capsys: pytest.CaptureFixture[str], name: str) -> None:
    out = Output()
    out.remark(f"room {name}: read")
    out.report(MACHINE_BUG.warning("the frame {frame} is odd", name, frame=name))
    out.result({"name": name}, f"{name}  done\nsecond {name}")
    out.result({"name": name})
    printed = "".join(capsys.readouterr())
    assert not re.search("[\x00-\x09\x0b-\x1f\x7f-\x9f\u2028\u202e]", printed)
    assert printed.count("\n") == 5
    assert name.encode("unicode_escape").decode() in printed
    Output(as_json=True).result({"name": name})
    printed = capsys.readouterr().out
    assert printed.isascii()
    assert json.loads(printed)["name"] == name
