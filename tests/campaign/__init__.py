"""A campaign of random cases against readers, whole runs and kernels, for as long as one lets it run.

`python -m tests.campaign --minutes 60` (`make campaign MINUTES=60`) draws cases of three kinds. `readers`:
valid files, damaged by those who know their structure. `runs`: the pipeline on a tiny scan, killed, out of
disk, twice at once. `kernels`: random meshes through every kernel, with the rules their results are held to.
A failure is kept as a file, which `--again FILE` repeats.
"""
