"""Which stages a scan goes through, and why it does not go through the others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from pipeline.config import Config
from pipeline.engine import Stage
from pipeline.graph import HELD_OUT, LABELS, NETWORK, PHOTOS, STAGES
from stages.scans.scan import Scan


def plan_for(scan: Scan, config: Config) -> Sequence[Stage]:
    """Return the stages a scan goes through: not those of `left_out`, and what they write is not read."""
    stages = [stage for stage in STAGES if stage.name not in left_out(scan, config)]
    there = {source_of(scan, config), *(stage.writes for stage in stages)}
    if scan.held_out:
        there.add(HELD_OUT)
    if config.depth.model is not None:
        there.add(NETWORK)
    has_photos = config.texture.images is not None
    plan = []
    for stage in stages:
        if stage.name == "texture" and has_photos:
            plan.append(replace(stage, reads=("simplified", "standing", PHOTOS)))
            continue
        if stage.name == "tiles" and not config.tiles.images:
            stage = replace(stage, reads=tuple(name for name in stage.reads if name != "textured"))
        # Frames that the depth stage left are numbered, and have no times.
        labels = LABELS if source_of(scan, config) in stage.reads else ()
        plan.append(
            replace(stage, reads=tuple(name for name in stage.reads if name in there or name in labels))
        )
    return plan


def left_out(scan: Scan, config: Config) -> Mapping[str, str]:
    """Return the stages a scan does not go through, and why."""
    reasons = {}
    if source_of(scan, config) == "frames":
        reasons["depth"] = "is not a stage of this scan: it is RGB-D, its depth is measured already"
    if not is_registered(scan, config):
        why = (
            "is switched off"
            if config.register.enabled is False
            else "its frames have poses; adjust makes them better, and register.enabled=true finds others"
        )
        reasons["register"] = f"is not a stage of this scan: {why}"
    if not is_adjusted(scan, config):
        if config.adjust.enabled is False:
            why = "is switched off"
        elif scan.is_views:
            why = "is not a stage of this scan: its depth is found with the poses that it has"
        else:
            why = "is not a stage of this scan: its frames have no colour"
        reasons["adjust"] = why
    if not config.texture.enabled:
        reasons["texture"] = "is switched off; set texture.enabled=true"
    elif config.texture.images is None and not any(frame.color is not None for frame in scan.frames):
        reasons["texture"] = (
            "is not a stage of this scan: its frames have no colour; texture.images=FOLDER takes other photos"
        )
    if not config.bake.enabled:
        reasons["bake"] = "is not enabled; set bake.enabled=true"
    if not config.remesh.enabled:
        reasons["remesh"] = "is not enabled; set remesh.enabled=true"
    if not config.lod.enabled:
        reasons["lod"] = "is not enabled; set lod.enabled=true"
    if not config.tiles.enabled:
        reasons["tiles"] = "is switched off; set tiles.enabled=true"
    elif not config.lod.enabled:
        reasons["tiles"] = "is made of levels of detail, which are not enabled; set lod.enabled=true"
    if not config.coverage.enabled:
        reasons["coverage"] = "is not enabled; set coverage.enabled=true"
    if not config.report.enabled:
        reasons["report"] = "is switched off; set report.enabled=true"
    if "texture" not in reasons and not config.export.web:
        reasons["export"] = "has nothing to write: textured.glb is there; export.web=true makes a small one"
    return reasons


def is_registered(scan: Scan, config: Config) -> bool:
    """Return whether the poses of a scan are found: those it lacks, or all, if asked for."""
    if config.register.enabled is None:
        return not scan.has_poses or (config.register.refine and not is_adjusted(scan, config))
    return config.register.enabled


def is_adjusted(scan: Scan, config: Config) -> bool:
    """Return whether poses and colour camera are adjusted: where frames have colour and measured depth."""
    if config.adjust.enabled is False or scan.is_views:
        return False
    return any(frame.color is not None for frame in scan.frames)


def source_of(scan: Scan, config: Config) -> str:
    """Return the name under which stages read this scan."""
    is_measured = not (scan.is_stereo or scan.is_views)
    # A network fills in what was measured, too.
    return "frames" if is_measured and config.depth.model is None else "pairs"
