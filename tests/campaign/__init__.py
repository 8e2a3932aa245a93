"""Campaign of random cases against readers, whole runs and kernels, for a given time.

`python -m tests.campaign --minutes 60` (`make campaign MINUTES=60`) draws four kinds of cases. `readers`:
valid files with damage that follows their structure. `runs`: the pipeline on a tiny scan: killed, with a full
disk, or two runs at once. `kernels`: random meshes through every kernel, with rules for the results.
`fusion`: random depth maps through the kernels of fusion. A failure is written to a file, which `--again
FILE` repeats.
"""
