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
from outputs.differences import Difference, ExpectedDifference, find_differences, matches
from outputs.jobs import QUICK_PATTERNS, Job, list_jobs
from outputs.leaves import Leaves

# Expected differences: pattern of jobs, pattern of differences as printed ("changed 1 simplify:triangles",
# "moved 1 simplify:proven -> 1 simplify:details.proven", ...; `*` is any text), and the reason.
EXPECTED: tuple[ExpectedDifference, ...] = (
    ExpectedDifference("*", "moved * -> *details.*", "results of a single method are under details"),
    ExpectedDifference("*", "gone *attribute_scale_m_per_level*", "planar has no colour weight"),
    ExpectedDifference("*", "moved *.pinned -> *.locked", "vertices that stay are called locked"),
    ExpectedDifference("*", "moved *texture* -> *color*", "a bound on colour is max_color"),
    ExpectedDifference("*", "new *schema*", "JSON states the version of its names"),
    ExpectedDifference("*", "changed *schema*", "JSON states the version of its names"),
    ExpectedDifference("*", "moved *view -> *viewpoint", "views of pictures are called viewpoints"),
    ExpectedDifference("*", "moved *views -> *viewpoints", "views of pictures are called viewpoints"),
    ExpectedDifference("*", "new *largest_color_change_levels*", "a bound on colour is max_color"),
    ExpectedDifference("*", "new *max_color*", "a bound on colour is max_color"),
    ExpectedDifference("*", "gone *texture*_levels*", "a bound on colour is max_color"),
    ExpectedDifference("*", "new *is called*", "a former name is answered with the new one"),
    ExpectedDifference("*", "new *details.largest_patches*", "of two equal values, the moved one is unknown"),
    ExpectedDifference("*", "gone *largest_patches*", "of two equal values, the moved one is unknown"),
    ExpectedDifference("*", "*is not supported by method*", "the table of methods lists their parameters"),
    ExpectedDifference("*", "*collapses no edges*", "the table of methods lists their parameters"),
    ExpectedDifference("*", "changed *:error", "the table of methods lists their parameters"),
    ExpectedDifference(
        "run/*",
        "*simplify.params.simplify.*",
        "each method has a separate default",
    ),
    ExpectedDifference("run/*", "changed *reason", "each method has a separate default"),
    ExpectedDifference("run/*", "* cache: *", "cache keys depend on the versions of results"),
    ExpectedDifference("words/*", "*", "help, configuration and errors use the new names"),
    ExpectedDifference("records/*", "*cut.npz*", "all records have one format"),
    ExpectedDifference("records/*", "*record.npz*", "all records have one format"),
    ExpectedDifference("broken/*", "*light.glb*", "the third command is seams, which uses the common driver"),
    ExpectedDifference(
        "broken/*", "* 2 simplify:*", "the third command is seams, which uses the common driver"
    ),
    ExpectedDifference("kitchen/*", "* seams.ply*", "seams uses the common driver, region by region"),
    ExpectedDifference("kitchen/methods", "* 4 simplify:*", "seams uses the common driver, region by region"),
    ExpectedDifference(
        "kitchen/as_it_is", "* 1 simplify:*", "seams uses the common driver, region by region"
    ),
    ExpectedDifference("*/seams", "*", "seams uses the common driver, region by region"),
    ExpectedDifference("methods/*/auto", "*", "auto takes seams for textured models"),
    ExpectedDifference("textures/*", "*", "textured models are simplified by seams"),
)

SNIPPETS = Path(__file__).parent / "outputs" / "snippets"
_TIMEOUT_S = 900
_MAX_SHOWN = 25
# Number of a step in the name of a leaf.
_STEP_NUMBER = re.compile(r"\b\d+(?= \S+(:| exit code| stderr))")


@dataclass(frozen=True)
class Side:
    """One of the two compared checkouts, with the working folder of its jobs.

    Attributes
    ----------
    identity : digest of everything that determines the outputs; None if unknown.
    """

    checkout: Path
    work: Path
    identity: str | None = None

    def folder_of(self, job: Job) -> Path:
        """Return the output folder of a job."""
        return self.work / job.name / "outputs"


@dataclass(frozen=True)
class JobOutputs:
    """Outputs and duration of a job on one side."""

    leaves: Leaves
    seconds: float
    is_kept: bool = False


@dataclass(frozen=True)
class JobComparison:
    """Results of a job on both sides."""

    job: Job
    first: JobOutputs
    second: JobOutputs
    unexpected: tuple[Difference, ...]
    expected: tuple[tuple[ExpectedDifference, Difference], ...]


def main() -> int:
    """Print the table and the differences; return the exit code."""
    options = parse_arguments()
    jobs = [job for job in list_jobs(options.data) if is_wanted(job, options.only, options.quick)]
    if not jobs:
        sys.exit(f"no job matches {' or '.join(options.only)}")
    with tempfile.TemporaryDirectory() as scratch:
        kept = options.keep or Path(scratch)
        first = make_side(options.first, kept / "first")
        second = make_side(options.second, kept / "second")
        folders = {
            "data": options.data,
            "samples": options.first.resolve() / "samples",
            "inputs": clear_folder(kept / "inputs"),
        }
        inputs.write_inputs(folders["inputs"], folders["samples"] / "rgbd")
        print_head(["job", "leaves", "first s", "second s", "outputs"])
        with ThreadPoolExecutor(options.jobs) as pool:
            rows = list(pool.map(lambda job: print_job(compare_job(job, first, second, folders)), jobs))
    return conclude(rows)


def parse_arguments() -> argparse.Namespace:
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
    in_time = not quick or any(matches(pattern, job.name) for pattern in QUICK_PATTERNS)
    return in_time and any(matches(pattern, job.name) for pattern in only)


def make_side(checkout: Path, work: Path) -> Side:
    """Make a side, after checking that Python imports its code."""
    command = [
        sys.executable,
        "-c",
        "from scanloom import cli, stages; print(stages.__file__, cli.__file__, sep='\\n')",
    ]
    with tempfile.TemporaryDirectory() as elsewhere:
        found = subprocess.run(
            command, cwd=elsewhere, env=make_environment(checkout, work), capture_output=True, text=True
        )
    if found.returncode != 0:
        sys.exit(f"{checkout} does not start:\n{found.stderr}")
    for path in found.stdout.split():
        if not Path(path).is_relative_to(checkout):
            sys.exit(f"Python imports {path} instead of {checkout}")
    return Side(checkout, work, compute_identity(checkout))


def compute_identity(checkout: Path) -> str | None:
    """Compute a digest of commit, kernels and installed packages.

    Returns None if the working tree differs from the commit.
    """

    def run_git(*words: str) -> str:
        return subprocess.run(["git", "-C", str(checkout), *words], capture_output=True, text=True).stdout

    commit = run_git("rev-parse", "HEAD")
    if not commit or run_git("status", "--porcelain"):
        return None
    packages = sorted(f"{one.name}=={one.version}" for one in importlib.metadata.distributions())
    digest = hashlib.sha256("\n".join([commit, sys.version, *packages]).encode())
    for path in sorted((checkout / "stages").rglob("*.so")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


def make_environment(checkout: Path, work: Path) -> Mapping[str, str]:
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


def compare_job(job: Job, first: Side, second: Side, folders: Mapping[str, Path]) -> JobComparison:
    """Run a job on both sides and compare its outputs."""
    folders = {**folders, "first": first.folder_of(job)}
    work = compute_job_digest(job, folders)
    before = load_outputs(job, first, work) or run_job(job, first, folders, work)
    after = run_job(job, second, folders, work)
    unexpected, expected = [], []
    for difference in find_differences(before.leaves, after.leaves):
        reason = next((one for one in EXPECTED if one.covers(job.name, difference)), None)
        if reason is None:
            unexpected.append(difference)
        else:
            expected.append((reason, difference))
    if not unexpected:
        shutil.rmtree(second.work / job.name)
    return JobComparison(job, before, after, tuple(unexpected), tuple(expected))


def load_outputs(job: Job, one: Side, work: str) -> JobOutputs | None:
    """Load outputs of an earlier run of the same code and job.

    Returns None without such a run.
    """
    record = one.work / job.name / "made.json"
    if one.identity is None or not record.is_file():
        return None
    found = json.loads(record.read_text())
    if found["of"] != [one.identity, work]:
        return None
    return JobOutputs(found["leaves"], found["seconds"], is_kept=True)


def run_job(job: Job, one: Side, folders: Mapping[str, Path], work: str) -> JobOutputs:
    """Run the steps of a job and collect its outputs.

    A record of them is stored next to the output folder.
    """
    folder = clear_folder(one.folder_of(job))
    folder.mkdir(parents=True)
    # Placeholders for folder names that differ between the sides. {first} is the job's own folder on the
    # first side.
    placeholders = {str(path): f"{{{name}}}" for name, path in folders.items()}
    placeholders |= {
        str(one.checkout): "{checkout}",
        str(folder): "{folder}",
        str(folders["first"]): "{folder}",
    }
    placeholders[str(SNIPPETS)] = "{snippets}"
    found: Leaves = {}
    began = time.monotonic()
    for number, step in enumerate(job.steps, 1):
        found |= run_step(step, number, one, folder, folders, placeholders)
    seconds = time.monotonic() - began
    found |= leaves.collect_folder_leaves(folder, placeholders)
    record = {"of": [one.identity, work], "seconds": seconds, "leaves": found}
    (folder.parent / "made.json").write_text(json.dumps(record, indent=1))
    return JobOutputs(found, seconds)


def run_step(
    step: str,
    number: int,
    one: Side,
    folder: Path,
    folders: Mapping[str, Path],
    placeholders: Mapping[str, str],
) -> Leaves:
    """Run one step; return the leaves of its output and exit code."""
    words = shlex.split(step)
    for name, path in folders.items():
        words = [word.replace(f"{{{name}}}", str(path)) for word in words]
    is_snippet = words[:1] and words[0].endswith(".py")
    command = [str(SNIPPETS / words[0]), *words[1:]] if is_snippet else ["-m", "scanloom.cli.app", *words]
    name = f"{number} {words[0] if words else 'nothing'}"
    try:
        done = subprocess.run(
            [sys.executable, *command],
            cwd=folder,
            env=make_environment(one.checkout, one.work),
            capture_output=True,
            text=True,
            stdin=subprocess.DEVNULL,
            timeout=_TIMEOUT_S,
        )
    except subprocess.TimeoutExpired:
        return {f"{name} exit code": f"timed out after {_TIMEOUT_S} s"}
    return {
        f"{name} exit code": str(done.returncode),
        **leaves.collect_text_leaves(done.stdout, name, placeholders),
        **leaves.count_lines(done.stderr, f"{name} stderr", placeholders),
    }


def compute_job_digest(job: Job, folders: Mapping[str, Path]) -> str:
    """Compute a digest of a job's steps, snippets and inputs.

    The code of the checkout is not included.
    """
    digest = hashlib.sha256("\n".join([str(folders["data"]), *job.steps]).encode())
    sources = [Path(inputs.__file__), Path(leaves.__file__)]
    for path in [*sources, *(SNIPPETS / word for step in job.steps for word in step.split()[:1])]:
        if path.is_file():
            digest.update(path.read_bytes())
    return digest.hexdigest()


def clear_folder(path: Path) -> Path:
    """Delete a folder if it exists; return its path."""
    shutil.rmtree(path, ignore_errors=True)
    return path


def print_job(row: JobComparison) -> JobComparison:
    """Print the table row of a job; return the row."""
    words = [f"**{len(row.unexpected)} differ**"] if row.unexpected else []
    words += [f"{len(row.expected)} differ as expected"] if row.expected else []
    before = f"({row.first.seconds:.1f})" if row.first.is_kept else f"{row.first.seconds:.1f}"
    cells = (row.job.name, f"{len(row.first.leaves):,}", before, f"{row.second.seconds:.1f}")
    print_row([*cells, ", ".join(words) or "same"])
    return row


def conclude(rows: Sequence[JobComparison]) -> int:
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
        f"First {format_total(row.first for row in rows)}, second {format_total(row.second for row in rows)}."
    )
    return 1 if different else 0


def print_kinds(rows: Iterable[JobComparison]) -> None:
    """Print the number of jobs for each kind of unexpected difference.

    The list helps to write the patterns in EXPECTED.
    """
    kinds = Counter(
        kind for row in rows for kind in {_STEP_NUMBER.sub("*", str(one)) for one in row.unexpected}
    )
    print("\nNumber of jobs by kind of difference:")
    for kind, count in kinds.most_common(_MAX_SHOWN):
        print(f"- {count}: {kind}")


def print_differences(found: Iterable[Difference]) -> None:
    """Print differences, one per line, with the values of both sides."""
    lines = [f"- {one}: {one.values}" for one in found]
    print(*lines[:_MAX_SHOWN], sep="\n")
    if len(lines) > _MAX_SHOWN:
        print(f"- and {len(lines) - _MAX_SHOWN} more")


def format_total(made: Iterable[JobOutputs]) -> str:
    """Format the total seconds of one side."""
    return f"{sum(one.seconds for one in made):.0f} s"


if __name__ == "__main__":
    sys.exit(main())
