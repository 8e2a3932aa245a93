"""A pipeline of three quick stages over a small scan, for tests of the engine and the cache.

As a program it processes a scan folder once: `python toy.py SCAN OUT [section.parameter=value]…`
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from scanloom.pipeline.cache.digest import compute_scan_digest
from scanloom.pipeline.cache.store import Cache
from scanloom.pipeline.run.engine import Engine, StageInput, StageOutcome
from scanloom.pipeline.run.events import RunEventHandler, ignore_run_event
from scanloom.pipeline.sections import Sections
from scanloom.pipeline.stage import AnyStage, Artifact, Context, Stage
from scanloom.stages.diagnostics.collector import listen_to_diagnostics
from scanloom.stages.params import check_parameters, param
from scanloom.stages.scans.model.scan import Camera, Frame, Scan


@dataclass(frozen=True, kw_only=True)
class MixParams:
    """Parameters of mixing the frames."""

    gain: float = param(0.5, "How much of the earlier frames stays.", low=0, high=1)
    threads: int = param(1, "Threads to use.", low=1, invalidates=False)

    def __post_init__(self) -> None:
        check_parameters(self)


@dataclass(frozen=True, kw_only=True)
class SoftParams:
    """Parameters of soft cuts."""

    width: float = param(0.1, "Width of the border.", unit="m", low=0)
    previews: int = param(0, "Pictures on the way.", low=0, invalidates=False)

    def __post_init__(self) -> None:
        check_parameters(self)


@dataclass(frozen=True, kw_only=True)
class CutParams:
    """Parameters of cutting off distant depth."""

    far: float | None = param(None, "Far limit; by default the mean.", unit="m", low=0, low_open=True)
    mode: str = param("hard", "How to cut.", choices=("hard", "soft"))
    soft: SoftParams = field(default=SoftParams())

    def __post_init__(self) -> None:
        check_parameters(self)


@dataclass(frozen=True, kw_only=True)
class CountParams:
    """Parameters of counting the remaining pixels."""

    bins: int = param(4, "Bins of the histogram.", low=1, high=64)
    exact: bool = param(True, "Count every pixel.")

    def __post_init__(self) -> None:
        check_parameters(self)


@dataclass(frozen=True)
class ToyConfig(Sections):
    mix: MixParams = field(default_factory=MixParams)
    cut: CutParams = field(default_factory=CutParams)
    count: CountParams = field(default_factory=CountParams)


@dataclass(frozen=True)
class Mixed(Artifact):
    NAME = "mixed"


@dataclass(frozen=True)
class Cut(Artifact):
    NAME = "cut"


@dataclass(frozen=True)
class Counts(Artifact):
    NAME = "counts"


@dataclass(frozen=True)
class MixInputs:
    frames: Scan


@dataclass(frozen=True)
class CutInputs:
    mixed: Mixed


@dataclass(frozen=True)
class CountInputs:
    cut: Cut


def mix(inputs: MixInputs, params: MixParams, context: Context) -> Mapping[str, Any]:
    scan = inputs.frames
    total = np.zeros((8, 8))
    (context.folder / "each").mkdir()
    for i, frame in enumerate(scan.frames):
        total = total * params.gain + np.frombuffer(frame.depth.read_bytes(), np.uint8).reshape(8, 8)
        (context.folder / "each" / f"{i:06d}.bin").write_bytes(total.tobytes())
        context.progress(i + 1, len(scan.frames))
    (context.folder / "mixed.bin").write_bytes(total.tobytes())
    return {"mean_m": total.mean(), "worst_m": np.inf}


def cut(inputs: CutInputs, params: CutParams, context: Context) -> Mapping[str, Any]:
    mixed = np.frombuffer((inputs.mixed.folder / "mixed.bin").read_bytes())
    far = mixed.mean() if params.far is None else params.far
    (context.folder / "cut.bin").write_bytes(np.minimum(mixed, far).tobytes())
    return {"far_m": float(far)}


def count(inputs: CountInputs, params: CountParams, context: Context) -> Mapping[str, Any]:
    left = np.frombuffer((inputs.cut.folder / "cut.bin").read_bytes())
    counts, _ = np.histogram(left, bins=params.bins)
    (context.folder / "tables").mkdir()
    (context.folder / "tables" / "counts.txt").write_text(" ".join(map(str, counts)))
    return {"bins": len(counts)}


def at(**versions: int) -> Callable[[Mapping[str, Any], Any], Mapping[str, int]]:
    """Make a version function that ignores inputs and configuration."""
    return lambda inputs, config: versions  # noqa: ARG005


PLAN: tuple[AnyStage, ...] = (
    Stage(
        name="mix",
        section=MixParams,
        inputs=MixInputs,
        artifact=Mixed,
        run=mix,
        versions=at(mix=1),
        libraries={"numpy": np.__version__},
        result_names=("mixed.bin",),
    ),
    Stage(
        name="cut",
        section=CutParams,
        inputs=CutInputs,
        artifact=Cut,
        run=cut,
        versions=at(cut=1),
        result_names=("cut.bin",),
    ),
    Stage(
        name="count",
        section=CountParams,
        inputs=CountInputs,
        artifact=Counts,
        run=count,
        versions=at(count=1),
        result_names=("tables/",),
    ),
)


def write_scan(folder: Path, frames: int = 3) -> Path:
    """Write a scan folder of raw depth files."""
    folder.mkdir(parents=True)
    rng = np.random.default_rng(7)
    for i in range(frames):
        (folder / f"{i:02d}.raw").write_bytes(rng.integers(0, 255, (8, 8), np.uint8).tobytes())
    return folder


def read_scan(folder: Path) -> Scan:
    camera = Camera(8, 8, 8.0, 8.0, 3.5, 3.5)
    frames = [
        Frame(path.stem, camera, depth=path, world_from_camera=np.eye(4))
        for path in sorted(folder.glob("*.raw"))
    ]
    return Scan("toy", frames, folder=folder)


def run(
    folder: Path,
    out: Path,
    *assignments: str,
    plan: tuple[AnyStage, ...] = PLAN,
    until: str = "count",
    force: tuple[str, ...] = (),
    cache: Path | None = None,
    events: RunEventHandler = ignore_run_event,
    warnings: list[str] | None = None,
    overwrite: bool = False,
) -> list[StageOutcome]:
    """Run the toy pipeline like scanloom.pipeline.run.run runs the real one."""
    out.mkdir(parents=True, exist_ok=True)
    scan = read_scan(folder)
    content = compute_scan_digest(scan)
    frames = StageInput(content.digest, scan, content.parts, content.require_unchanged)
    store = Cache(cache or out / "cache")
    store.remove_abandoned()
    config, sources = ToyConfig().set(assignments), {"frames": frames}
    said = [] if warnings is None else warnings
    with (
        listen_to_diagnostics(lambda one: said.append(str(one))),
        Engine(plan, config, sources, store, out, events, overwrite=overwrite) as engine,
    ):
        outcomes = list(engine.run(until, force))
        engine.remove_outdated(until)
        return outcomes


if __name__ == "__main__":
    run(Path(sys.argv[1]), Path(sys.argv[2]), *sys.argv[3:])
