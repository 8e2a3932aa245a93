"""Break one rule of the kernels at a time, in a copy, and check that its test fails.

`python -m tests.campaign.mutants [NAME…]`: each mutant takes a compilation of about a minute. `--target
FOLDER` keeps compiled files for the next time. Exit code 1 if a mutant survives, or its test fails without
the mutant.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from tests.campaign.mutant_table import MUTANTS, Mutant

ROOT = Path(__file__).resolve().parents[2]


def main() -> int:
    """Run the named mutants, or all of them."""
    parser = argparse.ArgumentParser(prog="python -m tests.campaign.mutants", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(MUTANTS)}")
    parser.add_argument("--target", type=Path, help="folder for compiled files")
    chosen = parser.parse_args()
    if unknown := set(chosen.names) - set(MUTANTS):
        parser.error(f"there is no mutant {', '.join(sorted(unknown))}")
    with tempfile.TemporaryDirectory(prefix="mutants-") as made:
        target = (chosen.target or Path(made) / "target").resolve()
        copy = Path(made) / "checkout"
        shutil.copytree(ROOT / "kernels", copy / "kernels", ignore=shutil.ignore_patterns("target"))
        ends = [
            _print_result(name, _run_mutant(MUTANTS[name], copy, target)) for name in chosen.names or MUTANTS
        ]
    return int(any(end != "killed" for end in ends))


def _print_result(name: str, end: str) -> str:
    sys.stdout.write(f"{name}: {end} ({MUTANTS[name].rule}; {MUTANTS[name].test})\n")
    sys.stdout.flush()
    return end


def _run_mutant(mutant: Mutant, copy: Path, target: Path) -> str:
    """Return "killed" if the test passes without the mutant and fails with it, else the other outcome."""
    if not _passes(mutant.test, copy, target):
        return "the test fails without the mutant"
    path = copy / mutant.file
    source = path.read_text(encoding="utf-8")
    path.write_text(mutate(mutant, source), encoding="utf-8")
    try:
        if not _compiles(copy, target):
            return "does not compile"
        return "survived" if _passes(mutant.test, copy, target) else "killed"
    finally:
        path.write_text(source, encoding="utf-8")


def mutate(mutant: Mutant, source: str) -> str:
    """Return the source with the rule broken.

    Raises
    ------
    ValueError
        If the text does not occur exactly once.
    """
    if source.count(mutant.text) != 1:
        raise ValueError(f"{mutant.file} contains {source.count(mutant.text)} times: {mutant.text}")
    return source.replace(mutant.text, mutant.replacement)


def _compiles(copy: Path, target: Path) -> bool:
    return _run_cargo(copy, target, "--no-run").returncode == 0


def _passes(test: str, copy: Path, target: Path) -> bool:
    ended = _run_cargo(copy, target, test)
    return ended.returncode == 0 and "1 passed" in ended.stdout


def _run_cargo(copy: Path, target: Path, word: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        ["cargo", "test", "--locked", "--lib", "--tests", word],
        cwd=copy / "kernels",
        env={**os.environ, "CARGO_TARGET_DIR": str(target)},
        capture_output=True,
        text=True,
        check=False,
    )


if __name__ == "__main__":
    sys.exit(main())
