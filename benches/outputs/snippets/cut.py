"""Keep the beginning of a file: cut.py FILE SHARE OUT."""

import sys
from pathlib import Path

path, share, out = sys.argv[1:]
whole = Path(path).read_bytes()
Path(out).write_bytes(whole[: int(float(share) * len(whole))])
