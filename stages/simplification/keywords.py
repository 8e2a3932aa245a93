"""Keyword arguments of `simplify` by method, for editors and type checkers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from numpy.typing import ArrayLike

from scanloom.stages.progress import Progress
from scanloom.stages.simplification.certified.params import CertifiedParams
from scanloom.stages.simplification.jia01.params import Jia01Params
from scanloom.stages.simplification.planar.params import PlanarParams
from scanloom.stages.simplification.regions import Region
from scanloom.stages.simplification.seams.params import SeamsParams

if TYPE_CHECKING:
    from scanloom.stages.params.keywords import (
        CertifiedKeywords,
        Jia01Keywords,
        PlanarKeywords,
        SeamsKeywords,
        SharedKeywords,
    )

    class _Call(SharedKeywords, total=False):
        lock: ArrayLike | None
        importance: ArrayLike | None
        regions: Sequence[Region]
        record: bool
        keep_on_interrupt: bool
        progress: Progress

    class QuadricCall(_Call, total=False):
        """Keyword arguments of `simplify` for method `quadric`."""

    class CertifiedCall(_Call, total=False):
        """Keyword arguments of `simplify` for method `certified`."""

        certified: CertifiedParams | CertifiedKeywords

    class SeamsCall(_Call, total=False):
        """Keyword arguments of `simplify` for method `seams`."""

        seams: SeamsParams | SeamsKeywords

    class Jia01Call(_Call, total=False):
        """Keyword arguments of `simplify` for method `jia01`."""

        jia01: Jia01Params | Jia01Keywords

    class PlanarCall(_Call, total=False):
        """Keyword arguments of `simplify` for method `planar`."""

        planar: PlanarParams | PlanarKeywords
