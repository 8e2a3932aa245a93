"""What decides a stage's result beside its inputs and parameters: the RESULT_VERSION of all that it runs."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from typing import Any

from pipeline import levels
from pipeline.config import Config
from pipeline.depth_maps import measure_of
from pipeline.large import is_clean_large
from stages.adjusting.adjust import adjust
from stages.cleaning.clean import clean
from stages.comparing.certify import certify
from stages.comparing.compare import compare_surfaces
from stages.errors import UsageError
from stages.fusion.fuse import fuse
from stages.fusion.noise import depth_noise
from stages.inspecting.sanity import require_poses
from stages.inspecting.view_poses import require_view_poses
from stages.lod.build import build
from stages.normal_meshes.remesh import remesh
from stages.simplification.auto import chosen
from stages.simplification.methods import METHODS
from stages.simplification.simplify import simplify
from stages.simplification.simplify_in_pieces import simplify_in_pieces
from stages.stereo.by_network import network_of
from stages.stereo.depth import depth_scan
from stages.stereo.networks.network import Network
from stages.texturing.bake import bake

# Simplification bakes images, and measures their colours.
_SIMPLIFY = (simplify, bake, compare_surfaces)

Versions = Callable[[Mapping[str, Any], Config], Mapping[str, int]]


def _stated(*functions: Callable[..., Any]) -> dict[str, int]:
    """Return the RESULT_VERSION that stands beside each function, by the name of its file."""
    modules = [sys.modules[function.__module__] for function in functions]
    return {module.__name__.rpartition(".")[2]: module.RESULT_VERSION for module in modules}


def of(*functions: Callable[..., Any]) -> Versions:
    """Return what tells the versions of a stage that runs these functions, whatever is asked of it."""
    return lambda inputs, config: _stated(*functions)  # noqa: ARG005


def of_depth(inputs: Mapping[str, Any], config: Config) -> Mapping[str, int]:
    """Return the versions of what `depth` runs."""
    network = {} if config.depth.model is None else _stated(network_of, Network)
    scan = inputs["pairs"]
    is_checked = scan.is_views and config.scan.check_poses
    # Views are matched in pairs, each as depth_scan does it.
    return {
        **_stated(depth_scan, measure_of(scan)),
        **network,
        **(_stated(require_view_poses) if is_checked else {}),
    }


def of_adjust(inputs: Mapping[str, Any], config: Config) -> Mapping[str, int]:  # noqa: ARG001
    """Return the versions of what `adjust` runs."""
    return _stated(adjust, require_poses) if config.scan.check_poses else _stated(adjust)


def of_fuse(inputs: Mapping[str, Any], config: Config) -> Mapping[str, int]:  # noqa: ARG001
    """Return the versions of what `fuse` runs."""
    # Poses that are not looked at are not refused, and nothing is said of them.
    return _stated(fuse, require_poses) if config.scan.check_poses else _stated(fuse)


def of_clean(inputs: Mapping[str, Any], config: Config) -> Mapping[str, int]:  # noqa: ARG001
    """Return the versions of what `clean` runs."""
    # What is not proven is not repaired.
    return _stated(clean, certify) if config.clean.repair else _stated(clean)


def of_simplify(inputs: Mapping[str, Any], config: Config) -> Mapping[str, int]:
    """Return the versions of what `simplify` runs."""
    try:
        method = chosen(config.simplify)  # What clean leaves has neither texture nor parts.
    except UsageError:
        return _stated(simplify)  # No method runs: the stage says what is wrong.
    proof = _stated(certify) if method.proves else {}
    in_pieces = _stated(simplify_in_pieces) if is_clean_large(inputs) else {}
    # What clean leaves has no images: it is baked on request alone.
    simplification = _stated(*_SIMPLIFY) if config.simplify.bake else _stated(simplify)
    return {**simplification, **in_pieces, method.name: method.result_version, **proof}


def of_remesh(inputs: Mapping[str, Any], config: Config) -> Mapping[str, int]:  # noqa: ARG001
    """Return the versions of what `remesh` runs."""
    # A base that is never refined is a simplified mesh.
    return {**_stated(remesh, *_SIMPLIFY), **{method.name: method.result_version for method in METHODS}}


def of_lod(inputs: Mapping[str, Any], config: Config) -> Mapping[str, int]:  # noqa: ARG001
    """Return the versions of what `lod` runs."""
    noise = _stated(depth_noise) if config.lod.base_error is None else {}
    # A base is simplified by `certified`, whose version goes with those of all methods as for remesh.
    methods = {method.name: method.result_version for method in METHODS}
    return {**_stated(levels.make, build, *_SIMPLIFY), **methods, **noise}
