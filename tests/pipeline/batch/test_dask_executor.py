"""Batch with Dask: a real scheduler and workers, one killed during a job; another job hangs."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import pytest
from hanging_jobs import is_any_alive, make_hanging_environment
from small_scans import write_small_scans

from scanloom.pipeline.batch.dask_executor import run_with_dask
from scanloom.pipeline.batch.job_queue import BatchSettings, Job, create_queue, read_current_queue
from scanloom.pipeline.batch.job_records import JobRecords
from scanloom.pipeline.config import Config
from scanloom.pipeline.run.run import run
from scanloom.stages.diagnostics.errors import InputError, UsageError

pytest.importorskip("distributed")
pytestmark = pytest.mark.slow

WORDS = ("--quiet", "--until", "clean", "--set", "worker.worker_timeout=2")


def start_module(*words: object, **environment: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", *map(str, words)],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env=os.environ | environment,
    )


@pytest.fixture
def scheduler(tmp_path: Path) -> Iterator[str]:
    """Start a scheduler with two single-threaded workers, and return its address."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{probe.getsockname()[1]}"
    port = address.rpartition(":")[2]
    words = ("--nthreads", 1, "--no-dashboard", "--local-directory", tmp_path / "dask")
    running = [
        start_module(
            "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", port, "--no-dashboard"
        )
    ]
    running += [start_module("distributed.cli.dask_worker", address, *words) for _ in range(2)]
    yield address
    for one in reversed(running):
        one.terminate()
    for one in running:
        one.communicate(timeout=60)


def find_busy_worker(hook: Path, deadline: float) -> int:
    """Find the process of a Dask worker with a running job of this test, identified by its hook."""
    while time.monotonic() < deadline:
        for folder in Path("/proc").glob("[0-9]*"):
            try:
                is_job = b"scanloom.pipeline.batch.dask_task" in (folder / "cmdline").read_bytes()
                # Other tests run jobs as well.
                is_job = is_job and bytes(hook) in (folder / "environ").read_bytes()
                parent = re.search(r"PPid:\s*(\d+)", (folder / "status").read_text())
            except OSError:
                continue
            if is_job and parent is not None:
                return int(parent[1])
        time.sleep(0.05)
    raise AssertionError("no job was begun")


@pytest.fixture
def hung(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Make the fifth job hang, and return the file that lists its processes.

    Workers start jobs, so this fixture is used before `scheduler`.
    """
    variables = make_hanging_environment(
        tmp_path / "hook", "scan-0004/depth-2.png", "adjust", tmp_path / "out" / "cache"
    )
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    return tmp_path / "hook" / "hung"


def test_a_killed_worker_and_a_hanging_job_lose_no_scan(hung: Path, scheduler: str, tmp_path: Path):
    scans, out = write_small_scans(tmp_path / "scans", 5), tmp_path / "out"
    (scans / "scan-0003" / "scan.json").write_text("{")
    # Other jobs report progress in less than 20 s, even on a busy machine.
    words = (*WORDS, "--set", "worker.timeout=20", "--set", f"batch.dask={scheduler}")
    batch = start_module("scanloom.cli.app", "batch", scans, "-o", out, *words)
    killed = find_busy_worker(hung.parent, time.monotonic() + 240)
    os.kill(killed, signal.SIGKILL)
    message, _ = batch.communicate(timeout=240)
    assert batch.returncode == 1, message
    assert "2 of 5 scans are not done: 1 failed, 1 unusable" in message
    assert "scan-0004: ended after 20 s without progress in adjust" in message
    assert hung.exists()
    assert not is_any_alive(hung)

    queue = read_current_queue(out)
    assert queue is not None
    ends = Counter(claim.number for claim in JobRecords(queue.folder / "done").list_finished())
    assert sorted(ends) == [0, 1, 2, 3, 4]
    assert sum(count > 1 for count in ends.values()) <= 1
    for number in range(3):
        name = f"scan-{number:04d}"
        run(scans / name, tmp_path / "quiet" / name, Config(), until="clean")
        quiet = (tmp_path / "quiet" / name / "clean.ply").read_bytes()
        assert (out / name / "clean.ply").read_bytes() == quiet


def test_a_lost_scheduler_is_reported(tmp_path: Path):
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    words = ("--host", "127.0.0.1", "--port", port, "--no-dashboard")
    scheduler = start_module("distributed.cli.dask_scheduler", *words)
    write_small_scans(tmp_path / "scans", 1)
    words = (*WORDS, "--set", f"batch.dask=tcp://127.0.0.1:{port}")
    while scheduler.poll() is None and not _is_port_open(port):
        time.sleep(0.05)
    batch = start_module("scanloom.cli.app", "batch", tmp_path / "scans", "-o", tmp_path / "out", *words)
    assert scheduler.stdout is not None
    # The batch waits for a worker; none exists.
    while "Receive client connection" not in scheduler.stdout.readline():
        assert batch.poll() is None, batch.communicate()[0]
    time.sleep(1)
    scheduler.kill()
    scheduler.communicate()
    message, _ = batch.communicate(timeout=240)
    assert batch.returncode == 1, message
    assert message.splitlines()[-1].startswith(
        f"scanloom: the connection to the scheduler at tcp://127.0.0.1:{port} is lost; "
    )


def _is_port_open(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


SBATCH = """#!{python}
# Like SLURM: takes a script, prints the number of its job, and runs the job elsewhere.
import subprocess, sys
with open({log!r}, "ab", buffering=0) as log:
    job = subprocess.Popen(
        ["sh", sys.argv[1]], start_new_session=True, stdin=subprocess.DEVNULL, stdout=log, stderr=log
    )
    log.write(b"a worker's process: %d\\n" % job.pid)
print("Submitted batch job 7")
"""


@pytest.fixture
def slurm(tmp_path: Path) -> dict[str, str]:
    """Return environment variables for a fake SLURM, whose workers write to `log`."""
    if find_spec("dask_jobqueue") is None:
        pytest.skip("dask-jobqueue is not installed")
    (tmp_path / "bin").mkdir()
    for name, text in (
        ("sbatch", SBATCH.format(python=sys.executable, log=str(tmp_path / "log"))),
        ("scancel", "#!/bin/sh\n"),
    ):
        (tmp_path / "bin" / name).write_text(text)
        (tmp_path / "bin" / name).chmod(0o755)
    return {
        "PATH": f"{tmp_path / 'bin'}:{os.environ['PATH']}",
        "DASK_JOBQUEUE__SLURM__CORES": "1",
        "DASK_JOBQUEUE__SLURM__MEMORY": "2GB",
        "DASK_JOBQUEUE__SLURM__LOCAL_DIRECTORY": str(tmp_path / "dask"),
        # On a busy machine, a worker may take longer than a minute to start.
        "DASK_JOBQUEUE__SLURM__DEATH_TIMEOUT": "200",
    }


def list_started_workers(log: Path) -> list[int]:
    """List the process ids of all workers started so far."""
    return [int(found) for found in re.findall(r"a worker's process: (\d+)", log.read_text())]


def test_slurm_starts_workers_and_replaces_expired_ones(slurm: dict[str, str], tmp_path: Path):
    scans, out = write_small_scans(tmp_path / "scans", 3), tmp_path / "out"
    words = (*WORDS, "--set", "batch.dask=slurm", "--jobs", 1)
    batch = start_module(
        "scanloom.cli.app", "batch", scans, "-o", out, *words, **slurm, PYTHONFAULTHANDLER="1"
    )
    while batch.poll() is None and not (out / "scan-0000" / "clean.ply").is_file():
        time.sleep(0.05)
    (worker,) = list_started_workers(tmp_path / "log")
    os.killpg(worker, signal.SIGKILL)
    try:
        message, _ = batch.communicate(timeout=240)
    except subprocess.TimeoutExpired:
        batch.send_signal(signal.SIGABRT)
        pytest.fail(f"{batch.communicate()[0]}\n{(tmp_path / 'log').read_text()}")
    assert batch.returncode == 0, message
    assert all((out / f"scan-000{number}" / "clean.ply").is_file() for number in range(3))
    assert len(list_started_workers(tmp_path / "log")) == 2


def test_a_refusal_by_slurm_is_one_error(slurm: dict[str, str], tmp_path: Path):
    (tmp_path / "bin" / "sbatch").write_text("#!/bin/sh\necho no such partition >&2\nexit 1\n")
    write_small_scans(tmp_path / "scans", 1)
    words = (*WORDS, "--set", "batch.dask=slurm", "--jobs", 2)
    batch = start_module(
        "scanloom.cli.app", "batch", tmp_path / "scans", "-o", tmp_path / "out", *words, **slurm
    )
    message, _ = batch.communicate(timeout=240)
    assert batch.returncode == 3, message
    assert re.fullmatch(r"scanloom: slurm cannot start workers: .* no such partition; .*\n", message)


NO_WORKER = """
import sys
from pathlib import Path
import scanloom.pipeline.batch.dask_executor
from scanloom.pipeline.batch.job_queue import BatchSettings, Job, create_queue

def show(event):
    print(event.text, flush=True)
    if "no worker" in event.text:
        raise InterruptedError

scanloom.pipeline.batch.dask_executor._WORKER_CHECK_INTERVAL = 0.2
queue = create_queue(Path(sys.argv[1]), 1, BatchSettings(""), [Job(0, "x", "x")])
scanloom.pipeline.batch.dask_executor.run_with_dask(queue, "slurm", workers=1, on_event=show)
"""


def test_scans_that_wait_for_a_worker_are_reported(slurm: dict[str, str], tmp_path: Path):
    (tmp_path / "bin" / "sbatch").write_text("#!/bin/sh\necho Submitted batch job 7\n")
    words = [sys.executable, "-c", NO_WORKER, str(tmp_path)]
    child = subprocess.run(words, capture_output=True, text=True, timeout=120, env=os.environ | slurm)
    messages = child.stdout.splitlines()
    assert len(messages) == 2, child.stderr
    assert re.match(r"the scheduler at tcp://\S+ has no workers; 1 scans are waiting\. ", messages[1])


CTRL_C = """
import signal, sys
from pathlib import Path
from scanloom.pipeline.batch.dask_executor import run_with_dask
from scanloom.pipeline.batch.job_queue import BatchSettings, Job, create_queue
from scanloom.stages.diagnostics.errors import InputError

queue = create_queue(Path(sys.argv[1]), 1, BatchSettings(""), [Job(0, "x", "x")])
try:
    # The processor count of a worker is not configured.
    run_with_dask(queue, "slurm", workers=1)
except InputError:
    assert "dask_jobqueue" in sys.modules
    signal.raise_signal(signal.SIGINT)
"""


def test_ctrl_c_remains_a_keyboard_interrupt_after_dask(tmp_path: Path):
    if find_spec("dask_jobqueue") is None:
        pytest.skip("dask-jobqueue is not installed")
    words = [sys.executable, "-c", CTRL_C, str(tmp_path)]
    child = subprocess.run(words, capture_output=True, text=True, timeout=120)
    assert child.returncode == -signal.SIGINT, child.stderr
    assert child.stderr.strip().endswith("KeyboardInterrupt")


def test_bad_executors_are_one_error(tmp_path: Path):
    queue = create_queue(tmp_path, 1, BatchSettings(""), [Job(0, "x", "x")])
    assert queue is not None
    with pytest.raises(UsageError, match=r"batch\.dask=slurm needs --jobs N"):
        run_with_dask(queue, "slurm")
    with pytest.raises(InputError, match=r"no Dask scheduler answers at nowhere://x: "):
        run_with_dask(queue, "nowhere://x")
