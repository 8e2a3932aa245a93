"""The keywords of `simplify`, for editors and type checkers: those of all methods, and those of each."""

from __future__ import annotations

from collections.abc import Sequence

from numpy.typing import ArrayLike

from stages.progress import Progress
from stages.simplification.certified.params import CertifiedKeywords
from stages.simplification.jia01.params import Jia01Keywords
from stages.simplification.planar.params import PlanarKeywords
from stages.simplification.quadric.params import QuadricKeywords
from stages.simplification.regions import Region
from stages.simplification.seams.params import SeamsKeywords
from stages.simplification.shared_params import GoalKeywords


class SimplifyKeywords(
    GoalKeywords,
    QuadricKeywords,
    CertifiedKeywords,
    SeamsKeywords,
    Jia01Keywords,
    PlanarKeywords,
    total=False,
):
    """SimplifyParams as keywords of `simplify`."""

    method: str


class _Call(GoalKeywords, total=False):
    lock: ArrayLike | None
    importance: ArrayLike | None
    regions: Sequence[Region]
    record: bool
    partial: bool
    progress: Progress


class QuadricCall(_Call, QuadricKeywords, total=False):
    """All that `simplify` takes for method `quadric`."""


class CertifiedCall(_Call, CertifiedKeywords, total=False):
    """All that `simplify` takes for method `certified`."""


class SeamsCall(_Call, SeamsKeywords, total=False):
    """All that `simplify` takes for method `seams`."""


class Jia01Call(_Call, Jia01Keywords, total=False):
    """All that `simplify` takes for method `jia01`."""


class PlanarCall(_Call, PlanarKeywords, total=False):
    """All that `simplify` takes for method `planar`."""
