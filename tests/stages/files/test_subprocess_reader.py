"""Reader subprocesses contain crashes, memory and time limits of a library; results and errors return."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from scanloom.stages.diagnostics.collector import collecting
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.subprocess_reader import SubprocessDiedError, run_reader_subprocess

BODIES = {
    "warns": "emit(MACHINE_BUG.warning('{count} points are odd', words[0], count=2)); return {}",
    "answers": "return {'words': words}",
    "refuses": "raise InputError(MACHINE_BUG, 'is no cloud.', words[0])",
    "aborts": "import os; os.abort()",
    "fails": "raise RuntimeError('odd')",
    "fails_as_rust_does": "raise type('PanicException', (BaseException,), {})()",
    "leaves": "import os; os._exit(0)",
    "is_not_there": "return undefined",
}


def write_module(body: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    text = "from scanloom.stages.diagnostics.codes import MACHINE_BUG\n"
    text += "from scanloom.stages.diagnostics.collector import emit\n"
    text += "from scanloom.stages.diagnostics.errors import InputError\n"
    text += "from scanloom.stages.files.subprocess_reader import serve_request\n\n"
    text += f"def work(words):\n    {body}\n\ndef main():\n    serve_request(work)\n"
    (folder / "made_for_a_test.py").write_text(text)
    monkeypatch.syspath_prepend(str(folder))
    return "made_for_a_test"


def test_arguments_are_passed_and_a_result_returns(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    module = write_module(BODIES["answers"], tmp_path, monkeypatch)
    words = ["a b", "-c", "\u00e4\n'"]
    assert run_reader_subprocess(module, words, 20) == {"words": words}


def test_an_input_error_returns(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    module = write_module(BODIES["refuses"], tmp_path, monkeypatch)
    with pytest.raises(InputError, match=r"^a\.las: is no cloud\.$"):
        run_reader_subprocess(module, ["a.las"], 20)


def test_warnings_of_the_subprocess_are_emitted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    module = write_module(BODIES["warns"], tmp_path, monkeypatch)
    with collecting() as found:
        assert run_reader_subprocess(module, ["a.las"], 20) == {}
    assert [str(one) for one in found] == ["a.las: 2 points are odd"]
    assert found[0].values == {"count": 2}


@pytest.mark.parametrize("name", ["aborts", "fails", "fails_as_rust_does", "leaves"])
def test_a_dying_subprocess_raises_an_error(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    module = write_module(BODIES[name], tmp_path, monkeypatch)
    with pytest.raises(SubprocessDiedError):
        run_reader_subprocess(module, [], 20)


@pytest.mark.skipif(sys.platform != "linux", reason="memory and time are limited as Linux does it")
@pytest.mark.parametrize("body", ["bytearray(3 << 30)", "\n    while True: pass"])
def test_memory_and_time_are_limited(body: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    module = write_module(body, tmp_path, monkeypatch)
    with pytest.raises(SubprocessDiedError):
        run_reader_subprocess(module, [], 0.5)
