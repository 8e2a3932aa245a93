"""How work spreads: over workers of a batch.

    python benches/scale.py batch [--scans 1000] [--jobs 10000] [--seed 3]

Prints Markdown; each bench says in its own module what it does: `benches/scale_batch.py`.
"""

from __future__ import annotations

import argparse

import scale_batch


def main() -> None:
    """Run the bench that is named."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    commands = parser.add_subparsers(required=True)
    scale_batch.add_to(commands)
    words = vars(parser.parse_args())
    words.pop("bench")(**words)


if __name__ == "__main__":
    main()
