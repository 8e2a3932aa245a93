"""Truncate a file to a ratio: cut.py FILE RATIO OUT."""

import sys
from pathlib import Path

path, share, out = sys.argv[1:]
whole = Path(path).read_bytes()
Path(out).write_bytes(whole[: int(float(share) * len(whole))])
