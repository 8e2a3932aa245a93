"""The command of the campaign."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from tests.campaign.campaign import KINDS, Campaign, Counts, hold
from tests.campaign.verdict import ACCEPTED, FAILED, REFUSED, SKIPPED


def main(words: Sequence[str] | None = None) -> int:
    """Run the campaign, or one of its failures again; return 1 where there are failures."""
    chosen = _arguments(words)
    if chosen.again is not None:
        with Campaign(chosen.failures) as campaign:
            verdict = campaign.again(chosen.again)
        print(f"{verdict.outcome}: {verdict.said}")
        return int(verdict.outcome == FAILED)
    counts = hold(
        chosen.failures,
        chosen.seed,
        chosen.only or KINDS,
        lambda text: print(text, flush=True),
        minutes=None if chosen.cases else chosen.minutes,
        cases=chosen.cases,
    )
    print(table(counts))
    failed = any(count[FAILED] for count in counts.values())
    return int(failed or not all(count.total() for count in counts.values()))


def table(counts: Counts) -> str:
    """Return the counts as a table; a kind without a single case has a line of zeros."""
    names = (ACCEPTED, REFUSED, SKIPPED, FAILED)
    rows = [("kind", "cases", *names)]
    rows += [
        (kind, str(count.total()), *(str(count[name]) for name in names)) for kind, count in counts.items()
    ]
    return "\n".join(f"{row[0]:10}" + "".join(f"{cell:>10}" for cell in row[1:]) for row in rows)


def _arguments(words: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m tests.campaign", description=__doc__)
    parser.add_argument("--minutes", type=float, default=2.0, help="how long it goes on (default: 2)")
    parser.add_argument("--cases", type=int, help="so many of each kind instead, however long they take")
    parser.add_argument("--seed", type=int, default=0, help="the same one gives the same cases (default: 0)")
    parser.add_argument("--only", action="append", choices=KINDS, help="a kind; may be given several times")
    parser.add_argument(
        "--failures", type=Path, default=Path("campaign-failures"), help="folder in which failures are kept"
    )
    parser.add_argument("--again", type=Path, metavar="FILE", help="repeat a failure that was kept")
    return parser.parse_args(words)


if __name__ == "__main__":
    sys.exit(main())
