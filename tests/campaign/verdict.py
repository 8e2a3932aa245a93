"""Verdict of a case: accepted, refused with an error message, or failed."""

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
    """Outcome of a case, one of the four words above, and its message."""

    outcome: str
    message: str = ""

    def to_dict(self) -> dict[str, Any]:
        return asdict(self)


def judge(case: Callable[[], str]) -> Verdict:
    """Run a case. Errors of scanloom refuse it; any other error, and a broken rule, is a failure."""
    try:
        return Verdict(ACCEPTED, case())
    except ScanloomError as error:
        return Verdict(REFUSED, to_one_line(str(error)))
    except OSError as error:
        failure = explain_failure(error)
        if failure.exit_code == BAD_INPUT:
            return Verdict(REFUSED, failure.sentence)
        return Verdict(FAILED, _format_error(error))
    except BaseException as error:
        return Verdict(FAILED, _format_error(error))


def _format_error(error: BaseException) -> str:
    return "".join(traceback.format_exception(error))[-3000:]
