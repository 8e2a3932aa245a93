"""OpenCV is not imported without enough memory, because its import would crash."""

import os
import subprocess
import sys

import pytest

LACKING = """
import numpy
from scanloom.stages.files.image_bytes import encode_png
from tests.made.short_of_memory import limit_memory
limit_memory({spare} << 20)
try:
    encode_png(numpy.zeros((4, 4, 3), numpy.uint8))
except MemoryError:
    print("memory")
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="the address space is limited as Linux does it")
@pytest.mark.parametrize("spare", [300, 200, 100])
def test_too_little_memory_for_opencv_raises_an_error(spare):
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    words = [sys.executable, "-c", LACKING.format(spare=spare)]
    run = subprocess.run(words, env=environment, capture_output=True, text=True)
    assert (run.returncode, run.stdout, run.stderr) == (0, "memory\n", "")
