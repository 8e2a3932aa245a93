"""What a case came to: accepted, refused with a sentence, or a failure, and what tells these apart."""

from __future__ import annotations

import traceback
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any

from scanloom.cli.errors import explain_failure
from scanloom.cli.exit_codes import BAD_INPUT
from scanloom.cli.output import to_one_line
from scanloom.stages.diagnostics.errors import ScanloomError

ACCEPTED, REFUSED, FAILED, SKIPPED = "accepted", "refused", "failed", "skipped"


@dataclass(frozen=True)
class Verdict:
    """How a case ended, one of the four words above, and what was said."""

    outcome: str
    said: str = ""

    def to_dict(self) -> dict[str, Any]:
        return asdict(self)


def judged(case: Callable[[], str]) -> Verdict:
    """Run a case. Scanloom's own errors refuse it; any other, and a broken rule, is a failure."""
    try:
        return Verdict(ACCEPTED, case())
    except ScanloomError as error:
        return Verdict(REFUSED, to_one_line(str(error)))
    except OSError as error:
        failure = explain_failure(error)
        if failure.exit_code == BAD_INPUT:
            return Verdict(REFUSED, failure.sentence)
        return Verdict(FAILED, _told(error))
    except BaseException as error:
        return Verdict(FAILED, _told(error))


def _told(error: BaseException) -> str:
    return "".join(traceback.format_exception(error))[-3000:]
