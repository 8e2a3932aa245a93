"""Scaling benches: bricks of a large building, and workers of a batch.

    python benches/scale.py bricks [--frames 100 300 1000 3000 10000] [--memory 500] [--plot FILE]
    python benches/scale.py batch [--scans 1000] [--jobs 10000] [--seed 3]

Prints Markdown. See `benches/scale_bricks.py` and `benches/scale_batch.py`.
"""

from __future__ import annotations

import argparse

import scale_batch
import scale_bricks


def main() -> None:
    """Run the bench named on the command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    commands = parser.add_subparsers(required=True)
    scale_bricks.add_to(commands)
    scale_batch.add_to(commands)
    words = vars(parser.parse_args())
    words.pop("bench")(**words)


if __name__ == "__main__":
    main()
