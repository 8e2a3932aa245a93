"""Diagnostic codes of batches, with explanations."""

from __future__ import annotations

from scanloom.stages.diagnostics.diagnostic import Code

BATCH_SCAN_STUCK = Code(
    "batch.scan-stuck",
    "Scan without progress",
    """
The scan made no progress for `worker.timeout` seconds (default: one hour). Copy a file of the scan to check
that its drive responds. A process that waits for an unresponsive drive cannot be killed: it ends when the
drive responds again, or is unmounted (`umount -f`). If the machine is just slow, increase `worker.timeout`.
""",
    (
        "ended after 600 s without progress in fuse; check that the drive of the scan responds, or "
        "increase worker.timeout, and run the batch again: it continues from the cache."
    ),
)
BATCH_PROCESS_ENDED = Code(
    "batch.process-ended",
    "Scan whose process ended",
    """
The scan is run again, continuing from the cache. It is given up after two crashes, or after six attempts
that end in the same stage. With `limits.memory`, a scan is stopped before the system kills its process, and
the message suggests a voxel size that fits. The output of the processes is in `queue/*/workers/*.log`.
""",
    (
        "the process of this scan was killed 6 times in simplify, possibly because memory ran out; run "
        "the scan alone, or with larger voxels. The output of the process is in kitchen.log."
    ),
)
BATCH_WORKER_STOPPED = Code(
    "batch.worker-stopped",
    "Worker that was unresponsive",
    """
The worker was stopped for longer than `worker.worker_timeout` (Ctrl-Z, a machine in standby, a disconnected
drive). Other workers have taken over its scans, so it stops working on them; no results are lost. If that
happens regularly, increase `worker.worker_timeout`.
""",
    "another worker has taken it over while this worker was unresponsive",
)
BATCH_ALREADY_EXISTS = Code(
    "batch.already-exists",
    "Output folder with another batch",
    """
Repeating the same command resumes an unfinished batch, or joins the workers that are running it. A
different batch first checks for some seconds that no worker of the old batch is running. All workers
should use the same version of scanloom, because results of different versions can differ.
""",
    (
        "out: another batch is running in this folder (worker pc7-4021); wait for its end, or choose "
        "another output folder."
    ),
)
BATCH_DASK = Code(
    "batch.dask",
    "Dask",
    """
Dask workers need the same version of scanloom, and must be able to access the scans and OUT under the
given paths. Dask gives up a scan if several workers died while running it; `worker.threads=1`, and workers
with fewer threads, leave more memory per scan. If no worker is available, the batch waits and prints a
notice: on SLURM, `squeue` shows if the jobs are pending. Workers that end at once, e.g. because they
cannot reach the scheduler, log the reason.
""",
    "--set batch.dask=slurm needs --jobs N: how many workers to ask it for.",
)
BATCH_QUEUE_DAMAGED = Code(
    "batch.queue-damaged",
    "Damaged or read-only queue",
    """
Finished results are in OUT and in the cache, so rewriting the queue costs little. If the queue cannot be
written to (full disk, read-only folder), the worker ends; its scans are left to other workers, or to the
next call.
""",
    (
        "the queue is damaged, or was written by another version; run `scanloom batch` again: it "
        "rewrites the queue and keeps all results."
    ),
)
BATCH_QUEUE_REFUSED = Code(
    "batch.queue-refused",
    "Queue or job that a worker refuses",
    """
Everybody who can write to OUT can change the queue. A worker therefore only runs what `scanloom batch` could
have written: scans under relative paths, results below OUT without links that lead elsewhere, known stages, a
valid configuration, and a cache in OUT or in a folder that already is one. The files of the queue must belong
to you, to root, or to the owner of OUT, and none may be a link.
""",
    "out/queue/0001: the queue contains a link; if you trust the folder, run `scanloom batch` again: it "
    "rewrites the queue and keeps all results.",
)
BATCH_SCANS_NOT_DONE = Code(
    "batch.scans-not-done",
    "No scans, or unfinished scans",
    """
Exit code 3 if there are no scans, or none can be read; 1 if some scans are not done. `scanloom inspect
FOLDER` shows what a folder contains and what is missing. Options that solve a problem with `inspect` also
work for the batch.
""",
    "3 of 40 scans are not done: 2 failed, 1 unusable; the table has the reasons.",
)
