"""Buffers of OpenBLAS are reserved before their first use."""

import os
import subprocess
import sys

import pytest

LACKING = """
import numpy
from scanloom.stages.files import blas_memory
from tests.made.short_of_memory import limit_memory
limit_memory(30 << 20)
try:
    blas_memory.reserve_blas_buffers(4)
except MemoryError:
    print("memory")
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="the address space is limited as Linux does it")
def test_a_failed_reservation_raises_memory_error():
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    run = subprocess.run([sys.executable, "-c", LACKING], env=environment, capture_output=True, text=True)
    assert (run.returncode, run.stdout, run.stderr) == (0, "memory\n", "")
