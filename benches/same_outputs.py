"""Comparison of the outputs of two checkouts, byte by byte.

    python benches/same_outputs.py FIRST SECOND [--data DATA] [--keep FOLDER] [--only 'methods/*'] [--quick]

FIRST and SECOND are checkouts with compiled kernels; both run with the current Python. Only their common
interface is used: the command line, and public names of `scanloom`. Each job (see outputs/jobs.py) runs on
both sides. Files are compared by bytes, archives by members, JSON by values. Seconds, dates and cache keys
are left out. Prints a Markdown table with the seconds of both sides and the differences. The exit code is 1
if a difference is not listed in EXPECTED.

With --keep, the outputs of FIRST stay in FOLDER/first. They are reused as long as FIRST has the same commit
and kernels, and Python the same packages. Outputs of SECOND are kept for jobs that differ. If SECOND is
FIRST, the bench checks if outputs are reproducible.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib.metadata
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

from markdown_tables import print_head, print_row
from outputs import inputs, leaves
from outputs.differences import Difference, Expected, differences, matches
from outputs.jobs import QUICK, Job, all_jobs
from outputs.leaves import Leaves

# Expected differences: pattern of jobs, pattern of differences as printed ("changed 1 simplify:triangles",
# "moved 1 simplify:proven -> 1 simplify:details.proven", ...; `*` is any text), and the reason.
EXPECTED: tuple[Expected, ...] = (
    Expected("*", "moved * -> *details.*", "results of a single method are under details"),
    Expected("*", "gone *attribute_scale_m_per_level*", "planar has no colour weight"),
    Expected("*", "moved *.pinned -> *.locked", "vertices that stay are called locked"),
    Expected("*", "moved *texture* -> *color*", "a bound on colour is max_color"),
    Expected("*", "new *schema*", "JSON states the version of its names"),
    Expected("*", "changed *schema*", "JSON states the version of its names"),
    Expected("*", "moved *view -> *viewpoint", "views of pictures are called viewpoints"),
    Expected("*", "moved *views -> *viewpoints", "views of pictures are called viewpoints"),
    Expected("*", "new *largest_color_change_levels*", "a bound on colour is max_color"),
    Expected("*", "new *max_color*", "a bound on colour is max_color"),
    Expected("*", "gone *texture*_levels*", "a bound on colour is max_color"),
    Expected("*", "new *is called*", "a former name is answered with the new one"),
    Expected("*", "new *details.largest_patches*", "of two equal values, the moved one is unknown"),
    Expected("*", "gone *largest_patches*", "of two equal values, the moved one is unknown"),
    Expected("*", "*is not supported by method*", "the table of methods lists their parameters"),
    Expected("*", "*collapses no edges*", "the table of methods lists their parameters"),
    Expected("*", "changed *:error", "the table of methods lists their parameters"),
    Expected(
        "run/*",
        "*simplify.params.simplify.*",
        "each method has a separate default",
    ),
    Expected("run/*", "changed *reason", "each method has a separate default"),
    Expected("run/*", "* cache: *", "cache keys depend on the versions of results"),
    Expected("words/*", "*", "help, configuration and errors use the new names"),
    Expected("records/*", "*cut.npz*", "all records have one format"),
    Expected("records/*", "*record.npz*", "all records have one format"),
    Expected("broken/*", "*light.glb*", "the third command is seams, which uses the common driver"),
    Expected("broken/*", "* 2 simplify:*", "the third command is seams, which uses the common driver"),
    Expected("kitchen/*", "* seams.ply*", "seams uses the common driver, region by region"),
    Expected("kitchen/methods", "* 4 simplify:*", "seams uses the common driver, region by region"),
    Expected("kitchen/as_it_is", "* 1 simplify:*", "seams uses the common driver, region by region"),
    Expected("*/seams", "*", "seams uses the common driver, region by region"),
    Expected("methods/*/auto", "*", "auto takes seams for textured models"),
    Expected("textures/*", "*", "textured models are simplified by seams"),
)

SNIPPETS = Path(__file__).parent / "outputs" / "snippets"
_LIMIT_S = 900
_SHOWN = 25
# Number of a step in the name of a leaf.
_NUMBER = re.compile(r"\b\d+(?= \S+(:| exit code| stderr))")


@dataclass(frozen=True)
class Side:
    """Checkout and working folder of its jobs.

    Attributes
    ----------
    identity : digest of everything that determines its outputs; None if unknown.
    """

    checkout: Path
    work: Path
    identity: str | None = None

    def folder_of(self, job: Job) -> Path:
        """Return the output folder of a job."""
        return self.work / job.name / "outputs"


@dataclass(frozen=True)
class Made:
    """Outputs and duration of a job on one side."""

    leaves: Leaves
    seconds: float
    is_kept: bool = False


@dataclass(frozen=True)
class Row:
    """Results of a job on both sides."""

    job: Job
    first: Made
    second: Made
    unexpected: tuple[Difference, ...]
    expected: tuple[tuple[Expected, Difference], ...]


def main() -> int:
    """Print the table and the differences; return the exit code."""
    options = arguments()
    jobs = [job for job in all_jobs(options.data) if is_wanted(job, options.only, options.quick)]
    if not jobs:
        sys.exit(f"no job matches {' or '.join(options.only)}")
    with tempfile.TemporaryDirectory() as scratch:
        kept = options.keep or Path(scratch)
        first = side(options.first, kept / "first")
        second = side(options.second, kept / "second")
        places = {
            "data": options.data,
            "samples": options.first.resolve() / "samples",
            "inputs": new_folder(kept / "inputs"),
        }
        inputs.make(places["inputs"], places["samples"] / "rgbd")
        print_head(["job", "leaves", "first s", "second s", "outputs"])
        with ThreadPoolExecutor(options.jobs) as pool:
            rows = list(pool.map(lambda job: told(compared(job, first, second, places)), jobs))
    return conclude(rows)


def arguments() -> argparse.Namespace:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("first", type=Path, help="checkout before the change")
    parser.add_argument("second", type=Path, help="checkout after the change")
    beside = Path(__file__).resolve().parents[2] / "shared" / "data"
    parser.add_argument("--data", type=Path, default=beside, help="folder of real scans and meshes")
    parser.add_argument("--keep", type=Path, help="folder that keeps outputs")
    parser.add_argument("--only", nargs="+", metavar="PATTERN", default=["*"], help="jobs, such as 'run/*'")
    parser.add_argument("--quick", action="store_true", help="run a few jobs of each kind")
    parser.add_argument("--jobs", type=int, default=1, help="number of parallel jobs")
    options = parser.parse_args()
    for name in ("first", "second", "data", "keep"):
        if getattr(options, name) is not None:
            setattr(options, name, getattr(options, name).resolve())
    return options


def is_wanted(job: Job, only: Sequence[str], quick: bool) -> bool:
    """Check if a job is selected by the command line."""
    in_time = not quick or any(matches(pattern, job.name) for pattern in QUICK)
    return in_time and any(matches(pattern, job.name) for pattern in only)


def side(checkout: Path, work: Path) -> Side:
    """Make a side, after checking that Python imports its code."""
    command = [
        sys.executable,
        "-c",
        "from scanloom import cli, stages; print(stages.__file__, cli.__file__, sep='\\n')",
    ]
    with tempfile.TemporaryDirectory() as elsewhere:
        found = subprocess.run(
            command, cwd=elsewhere, env=environment(checkout, work), capture_output=True, text=True
        )
    if found.returncode != 0:
        sys.exit(f"{checkout} does not start:\n{found.stderr}")
    for path in found.stdout.split():
        if not Path(path).is_relative_to(checkout):
            sys.exit(f"Python imports {path} instead of {checkout}")
    return Side(checkout, work, identity(checkout))


def identity(checkout: Path) -> str | None:
    """Compute a digest of commit, kernels and installed packages.

    Returns None if the working tree differs from the commit.
    """

    def git(*words: str) -> str:
        return subprocess.run(["git", "-C", str(checkout), *words], capture_output=True, text=True).stdout

    commit = git("rev-parse", "HEAD")
    if not commit or git("status", "--porcelain"):
        return None
    packages = sorted(f"{one.name}=={one.version}" for one in importlib.metadata.distributions())
    digest = hashlib.sha256("\n".join([commit, sys.version, *packages]).encode())
    for path in sorted((checkout / "stages").rglob("*.so")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def environment(checkout: Path, work: Path) -> Mapping[str, str]:
    """Make the environment variables of a checkout.

    They prevent Python from writing into the checkout.
    """
    unwanted = {"SCANLOOM_CACHE", "PYTHONDONTWRITEBYTECODE"}
    return {name: value for name, value in os.environ.items() if name not in unwanted} | {
        "PYTHONPATH": str(checkout),
        "PYTHONPYCACHEPREFIX": str(work / "pycache"),
        "COLUMNS": "120",
        "NO_COLOR": "1",
    }


def compared(job: Job, first: Side, second: Side, places: Mapping[str, Path]) -> Row:
    """Run a job on both sides and compare its outputs."""
    places = {**places, "first": first.folder_of(job)}
    work = work_of(job, places)
    before = kept(job, first, work) or made(job, first, places, work)
    after = made(job, second, places, work)
    unexpected, expected = [], []
    for difference in differences(before.leaves, after.leaves):
        reason = next((one for one in EXPECTED if one.covers(job.name, difference)), None)
        if reason is None:
            unexpected.append(difference)
        else:
            expected.append((reason, difference))
    if not unexpected:
        shutil.rmtree(second.work / job.name)
    return Row(job, before, after, tuple(unexpected), tuple(expected))


def kept(job: Job, one: Side, work: str) -> Made | None:
    """Load outputs of an earlier run of the same code and job.

    Returns None without such a run.
    """
    record = one.work / job.name / "made.json"
    if one.identity is None or not record.is_file():
        return None
    found = json.loads(record.read_text())
    if found["of"] != [one.identity, work]:
        return None
    return Made(found["leaves"], found["seconds"], is_kept=True)


def made(job: Job, one: Side, places: Mapping[str, Path], work: str) -> Made:
    """Run the steps of a job and collect its outputs.

    A record of them is stored next to the output folder.
    """
    folder = new_folder(one.folder_of(job))
    folder.mkdir(parents=True)
    # Placeholders for folder names that differ between the sides. {first} is the job's own folder on the
    # first side.
    named = {str(path): f"{{{name}}}" for name, path in places.items()}
    named |= {str(one.checkout): "{checkout}", str(folder): "{folder}", str(places["first"]): "{folder}"}
    named[str(SNIPPETS)] = "{snippets}"
    found: Leaves = {}
    began = time.monotonic()
    for number, step in enumerate(job.steps, 1):
        found |= step_leaves(step, number, one, folder, places, named)
    seconds = time.monotonic() - began
    found |= leaves.of_folder(folder, named)
    record = {"of": [one.identity, work], "seconds": seconds, "leaves": found}
    (folder.parent / "made.json").write_text(json.dumps(record, indent=1))
    return Made(found, seconds)


def step_leaves(
    step: str, number: int, one: Side, folder: Path, places: Mapping[str, Path], named: Mapping[str, str]
) -> Leaves:
    """Run one step; return the leaves of its output and exit code."""
    words = shlex.split(step)
    for name, path in places.items():
        words = [word.replace(f"{{{name}}}", str(path)) for word in words]
    is_snippet = words[:1] and words[0].endswith(".py")
    command = [str(SNIPPETS / words[0]), *words[1:]] if is_snippet else ["-m", "scanloom.cli.app", *words]
    name = f"{number} {words[0] if words else 'nothing'}"
    try:
        done = subprocess.run(
            [sys.executable, *command],
            cwd=folder,
            env=environment(one.checkout, one.work),
            capture_output=True,
            text=True,
            stdin=subprocess.DEVNULL,
            timeout=_LIMIT_S,
        )
    except subprocess.TimeoutExpired:
        return {f"{name} exit code": f"timed out after {_LIMIT_S} s"}
    return {
        f"{name} exit code": str(done.returncode),
        **leaves.of_output(done.stdout, name, named),
        **leaves.of_lines(done.stderr, f"{name} stderr", named),
    }


def work_of(job: Job, places: Mapping[str, Path]) -> str:
    """Compute a digest of a job's steps, snippets and inputs.

    The code of the checkout is not included.
    """
    digest = hashlib.sha256("\n".join([str(places["data"]), *job.steps]).encode())
    sources = [Path(inputs.__file__), Path(leaves.__file__)]
    for path in [*sources, *(SNIPPETS / word for step in job.steps for word in step.split()[:1])]:
        if path.is_file():
            digest.update(path.read_bytes())
    return digest.hexdigest()


def new_folder(path: Path) -> Path:
    """Delete a folder if it exists; return its path."""
    shutil.rmtree(path, ignore_errors=True)
    return path


def told(row: Row) -> Row:
    """Print the table row of a job; return the row."""
    words = [f"**{len(row.unexpected)} differ**"] if row.unexpected else []
    words += [f"{len(row.expected)} differ as expected"] if row.expected else []
    before = f"({row.first.seconds:.1f})" if row.first.is_kept else f"{row.first.seconds:.1f}"
    cells = (row.job.name, f"{len(row.first.leaves):,}", before, f"{row.second.seconds:.1f}")
    print_row([*cells, ", ".join(words) or "same"])
    return row


def conclude(rows: Sequence[Row]) -> int:
    """Print all differences and totals; return the exit code."""
    different = [row for row in rows if row.unexpected]
    for row in different:
        print(f"\n{row.job.name}:")
        print_differences(row.unexpected)
    if len(different) > 1:
        print_kinds(different)
    counts = Counter(reason for row in rows for reason, _ in row.expected)
    for one in EXPECTED:
        print(f"\nexpected, {counts[one] or 'but not'} seen: {one.job}: {one.what}: {one.reason}")
    print(
        f"\n{len(rows)} jobs, {sum(len(row.job.steps) for row in rows)} commands, "
        f"{sum(len(row.first.leaves) for row in rows):,} leaves; {len(different)} jobs differ. "
        f"First {total(row.first for row in rows)}, second {total(row.second for row in rows)}."
    )
    return 1 if different else 0


def print_kinds(rows: Iterable[Row]) -> None:
    """Print the number of jobs for each kind of difference.

    The list helps to write EXPECTED.
    """
    kinds = Counter(kind for row in rows for kind in {_NUMBER.sub("*", str(one)) for one in row.unexpected})
    print("\nNumber of jobs by kind of difference:")
    for kind, count in kinds.most_common(_SHOWN):
        print(f"- {count}: {kind}")


def print_differences(found: Iterable[Difference]) -> None:
    """Print differences, one per line, with the values of both sides."""
    lines = [f"- {one}: {one.values}" for one in found]
    print(*lines[:_SHOWN], sep="\n")
    if len(lines) > _SHOWN:
        print(f"- and {len(lines) - _SHOWN} more")


def total(made: Iterable[Made]) -> str:
    """Format the total seconds of one side."""
    return f"{sum(one.seconds for one in made):.0f} s"


if __name__ == "__main__":
    sys.exit(main())
