"""Command line of the campaign."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from tests.campaign.campaign import KINDS, Campaign, Counts, run_campaign
from tests.campaign.verdict import ACCEPTED, FAILED, REFUSED, SKIPPED


def main(words: Sequence[str] | None = None) -> int:
    """Run the campaign, or repeat one of its failures; return 1 if there are failures."""
    chosen = _parse_arguments(words)
    if chosen.again is not None:
        with Campaign(chosen.failures) as campaign:
            verdict = campaign.repeat(chosen.again)
        print(f"{verdict.outcome}: {verdict.message}")
        return int(verdict.outcome == FAILED)
    counts = run_campaign(
        chosen.failures,
        chosen.seed,
        chosen.only or KINDS,
        lambda text: print(text, flush=True),
        minutes=None if chosen.cases else chosen.minutes,
        cases=chosen.cases,
    )
    print(format_table(counts))
    failed = any(count[FAILED] for count in counts.values())
    return int(failed or not all(count.total() for count in counts.values()))


def format_table(counts: Counts) -> str:
    """Format the counts as a table; a kind without cases has a row of zeros."""
    names = (ACCEPTED, REFUSED, SKIPPED, FAILED)
    rows = [("kind", "cases", *names)]
    rows += [
        (kind, str(count.total()), *(str(count[name]) for name in names)) for kind, count in counts.items()
    ]
    return "\n".join(f"{row[0]:10}" + "".join(f"{cell:>10}" for cell in row[1:]) for row in rows)


def _parse_arguments(words: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m tests.campaign", description=__doc__)
    parser.add_argument("--minutes", type=float, default=2.0, help="duration (default: 2)")
    parser.add_argument("--cases", type=int, help="number of cases of each kind, instead of --minutes")
    parser.add_argument("--seed", type=int, default=0, help="the same seed gives the same cases (default: 0)")
    parser.add_argument("--only", action="append", choices=KINDS, help="kind of cases; may be repeated")
    parser.add_argument(
        "--failures", type=Path, default=Path("campaign-failures"), help="folder for failures"
    )
    parser.add_argument("--again", type=Path, metavar="FILE", help="repeat a stored failure")
    return parser.parse_args(words)


if __name__ == "__main__":
    sys.exit(main())
