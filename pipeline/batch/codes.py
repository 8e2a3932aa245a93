"""Codes of the diagnostics of batches of scans, with explanations."""

from __future__ import annotations

from scanloom.stages.diagnostics.diagnostic import Code

BATCH_SCAN_STUCK = Code(
    "batch.scan-stuck",
    "A scan that gets no further",
    """
For `worker.timeout` seconds (an hour, if nothing is said) no new stage began, and no other share of the stage
was done. Copy a
file of the scan to see whether its drive answers; a process that the system cannot end goes when the
drive answers again,
or is gone for good (`umount -f`). If the machine is just slow, give a longer `worker.timeout`.
""",
    (
        "it got no further in fuse for 600 s and was ended; see whether the drive of its files "
        "answers, or give a longer --set worker.timeout, and run the batch again: it goes on from what is in "
        "the cache."
    ),
)
BATCH_PROCESS_ENDED = Code(
    "batch.process-ended",
    "A scan whose process ended",
    """
A scan is begun again from what is in the cache, and given up after two crashes, or after six ends in one
stage without
a result. `--memory` ends it in a sentence before the system does, and says which voxel size would fit.
What was printed
is in `queue/*/workers/*.log`.
""",
    (
        "the process that ran it was killed in simplify, as it is where memory ends; run this scan "
        "alone, or with larger voxels. Its output is in kitchen.log."
    ),
)
BATCH_WORKER_STOPPED = Code(
    "batch.worker-stopped",
    "A worker that was stopped",
    """
A worker was stopped (Ctrl-Z, a machine that slept, a drive that was gone) for longer than
`worker.worker_timeout`, and goes on.
Its scans are others' by now: it ends its own work on them, and nothing is lost. Give a longer
`worker.worker_timeout` if that
is usual.
""",
    "another worker has taken it over while this one gave no sign of life",
)
BATCH_ALREADY_EXISTS = Code(
    "batch.already-exists",
    "Another batch is there",
    """
The same command goes on with what is not finished, or joins those who are at it. Another one waits some
seconds for
signs of life, and takes the folder only if there are none. Workers of different versions may come to
different bytes:
let all be of one.
""",
    (
        "out: another batch is at work in it (worker pc7-4021); wait for its end, or name another "
        "output folder."
    ),
)
BATCH_DASK = Code(
    "batch.dask",
    "Dask",
    """
Dask's workers need scanloom in the same version, and must see the scans and OUT under the paths that are
given. Dask
gives a task up when several workers in a row died of it; `worker.threads=1` and workers with fewer threads
let a scan have
more memory. A batch that no worker is there for waits, and says so once: on SLURM, `squeue` shows whether
jobs are
pending; workers that ended at once, as where they cannot reach the scheduler, say so in their jobs' logs.
""",
    "--set batch.dask=slurm needs --jobs N: how many workers to ask it for.",
)
BATCH_QUEUE_DAMAGED = Code(
    "batch.queue-damaged",
    "The queue",
    """
What is finished is in OUT and in the cache, so writing the queue anew costs little. A queue that cannot
be written to
(a full disk, a folder that may only be read) ends the worker; its scans are left to others, or to the
next call.
""",
    (
        "the queue is damaged, or of another version; run scanloom batch again, "
        "which writes it anew and keeps all results."
    ),
)
BATCH_SCANS_NOT_DONE = Code(
    "batch.scans-not-done",
    "There are no scans, or some are not done",
    """
Exit code 3 where there is nothing to do, or no scan can be read; 1 where some are not done. `scanloom
inspect FOLDER`
says of one folder what it holds and what is missing; what helps `inspect` helps the batch, with the same
options.
""",
    "3 of 40 scans are not done: 2 failed, 1 unusable; the table has the reasons.",
)
