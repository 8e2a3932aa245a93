"""Command `simplify`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from scanloom import stages
from scanloom.cli.bake_output import TEXTURED_SUFFIXES, format_color_errors
from scanloom.cli.bounds_output import SaveBounds, write_bounds
from scanloom.cli.codes import SIMPLIFY_FILE_LARGER
from scanloom.cli.mesh_arguments import (
    MeshFile,
    NewMesh,
    locate_diagnostics,
    read_mesh_file,
    remark_written,
    write_mesh_file,
)
from scanloom.cli.output import Output
from scanloom.cli.paths import MESH_SUFFIXES, require_new_file
from scanloom.cli.rendering import option_name
from scanloom.cli.simplify_output import format_simplification
from scanloom.stages import ExportParams, Mesh, SimplificationResult, SimplifyParams, UsageError
from scanloom.stages.diagnostics.codes import USAGE_OPTIONS_CONFLICT
from scanloom.stages.diagnostics.collector import collecting, emit
from scanloom.stages.exporting.export import GLTF_SUFFIXES
from scanloom.stages.exporting.packing_detection import detect_packing, measure_stored_bytes
from scanloom.stages.params import resolve
from scanloom.stages.printing import format_upper_bound
from scanloom.stages.simplification.codes import SIMPLIFY_TEXTURE_LEFT_OUT
from scanloom.stages.simplification.method_selection import select_method
from scanloom.stages.simplification.methods import METHODS
from scanloom.stages.simplification.regions import parse_region
from scanloom.stages.surface.formats.gltf_packing import make_quantization_grid


def simplify(
    source: MeshFile,
    target: NewMesh,
    simplify: SimplifyParams,
    out: Output,
    region: Annotated[
        list[str] | None,
        typer.Option(
            metavar="REGION",
            help='Protect a region: "sphere x y z radius" or "box x y z x y z" (lowest and highest '
            "corner), in m, "
            "followed by an importance (factor of the squared error, or divisor of the bounds), lock, or "
            "both; may be repeated.",
            show_default=False,
        ),
    ] = None,
    save_record: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="File (.npz) for all collapses, for scanloom mesh replay.",
            show_default=False,
        ),
    ] = None,
    save_bounds: SaveBounds = None,
    keep_on_interrupt: Annotated[
        bool,
        typer.Option(
            "--keep-on-interrupt",
            help="On Ctrl-C, write the mesh simplified so far instead of discarding it. If bounds were "
            "given, its deviation is proven first.",
        ),
    ] = False,
) -> None:
    """Simplify a mesh to a size, or within error bounds.

    Size and bounds:

    - with --triangles or --ratio: to this size, with minimal error;
    - with --max-shape, --max-color or both: as far as these bounds are proven at every point;
    - with a size and bounds: to the size, but never beyond the bounds; "stopped by" names the first reached;
    - with neither: a textured model within 1/1000 of its size, other meshes within default bounds.

    Prints size, deviation and texture; --json prints all statistics.

    Textures are baked again if OUT is .glb, .obj or .ply. --keep-uv keeps images and texture coordinates, at
    the cost of shape; so does simplification to a size where baking loses much more colour, unless --bake is
    given. A quantized or compressed glTF file stays so if OUT is glTF.

    Most methods need a manifold mesh: run `scanloom clean` first.

    Example: scanloom simplify clean.ply light.ply --ratio 0.1

    Example: scanloom simplify clean.ply light.ply --max-shape 0.005 --max-color 20

    Example: scanloom simplify clean.ply light.ply --triangles 20000 --region "sphere 0 0 1.2 0.3 20"

    Example: scanloom simplify model.glb light.glb --ratio 0.1 --keep-uv
    """
    require_new_file(target, TEXTURED_SUFFIXES if simplify.bake else MESH_SUFFIXES)
    holds_texture = target.suffix.lower() in TEXTURED_SUFFIXES
    if not holds_texture and simplify.bake is None:
        simplify = replace(simplify, bake=False)
    if save_record is not None:
        require_new_file(save_record, (".npz",))
    if save_bounds is not None:
        require_new_file(save_bounds, (".ply",))
        if not select_method(simplify).proves_bounds:
            raise UsageError(
                USAGE_OPTIONS_CONFLICT,
                "--save-bounds needs a method that proves bounds; {how_to_prove}.",
                how_to_prove=_how_to_prove(),
            )
    regions = [parse_region(text) for text in region or ()]
    mesh = read_mesh_file(source)
    packing = detect_packing(source, mesh) if target.suffix.lower() in GLTF_SUFFIXES else ExportParams()
    simplify, packing = _fit_packing(mesh, simplify, packing)
    with (
        locate_diagnostics(source),
        collecting(forward=False) as diagnostics,
        out.progress("simplify", "triangles") as progress,
    ):
        simplified = stages.simplify(
            mesh,
            simplify,
            regions=regions,
            record=save_record is not None,
            keep_on_interrupt=keep_on_interrupt,
            progress=progress,
        )
    with locate_diagnostics(source):
        # `write_mesh_file` warns about formats without textures.
        emit(*(one for one in diagnostics if holds_texture or one.code != SIMPLIFY_TEXTURE_LEFT_OUT.name))
    rounding = 0.0
    source_bytes = measure_stored_bytes(source, mesh)
    if packing.compress == "none":
        write_mesh_file(target, simplified.mesh, out, original=None if holds_texture else mesh)
    else:
        target.parent.mkdir(parents=True, exist_ok=True)
        rounding = stages.export(simplified.mesh, target, packing).position_error
        remark_written(target, simplified.mesh, out)
    if simplified.record is not None and save_record is not None:
        save_record.parent.mkdir(parents=True, exist_ok=True)
        simplified.record.save(save_record)
    if save_bounds is not None:
        proven = simplified.details
        write_bounds(save_bounds, simplified.mesh, proven.shape_bound, proven.color_bound, out)
    target_bytes = measure_stored_bytes(target, simplified.mesh)
    metrics = {
        "output": str(target),
        **simplified.to_dict(),
        "input_bytes": source_bytes,
        "output_bytes": target_bytes,
        **({"position_error_m": rounding} if rounding else {}),
    }
    if target_bytes > source_bytes and source.suffix.lower() == target.suffix.lower():
        emit(
            SIMPLIFY_FILE_LARGER.warning(
                "larger than the input, {output_bytes:,} bytes instead of {input_bytes:,}.",
                target,
                output_bytes=target_bytes,
                input_bytes=source_bytes,
            )
        )
    # JSON has all statistics; text has what decides if the mesh can be used.
    text = "" if out.as_json else format_simplification(simplified, metrics, mesh)
    if simplified.default_max_shape is not None:
        text += f"\n\n{_default_bound(simplified)}"
    if simplified.kept_images is not None:
        kept = simplified.kept_images
        text += (
            f"\n\nOUT keeps the texture coordinates and images of IN: colour error {kept.rmse_levels:.3g} "
            f"levels, {kept.baked_rmse_levels:.3g} levels with baked images (--bake)."
        )
    if simplified.baked is not None:
        text += f"\n\n{format_color_errors(simplified.baked.to_dict())}"
    if rounding:
        text += (
            f"\n\nOUT is compressed like IN ({packing.compress}): positions are rounded by at most "
            f"{format_upper_bound(rounding)} m."
        )
    if simplified.details.describe():
        text += f"\n\n{simplified.details.describe()}"
    out.result(metrics, text)


def _fit_packing(
    mesh: Mesh, params: SimplifyParams, packing: ExportParams
) -> tuple[SimplifyParams, ExportParams]:
    """Subtract the rounding of positions in a compressed file from the bound on shape.

    A file is not compressed if rounding alone exceeds the bound.
    """
    if packing.compress == "none" or params.max_shape is None:
        return params, packing
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    margin = params.max_shape
    rounding = make_quantization_grid(
        np.stack([low - margin, high + margin]), packing.position_bits
    ).max_error
    if rounding >= params.max_shape:
        return params, ExportParams()
    return resolve(SimplifyParams, params, {"max_shape": params.max_shape - rounding}), packing


def _default_bound(simplified: SimplificationResult[Any]) -> str:
    assert simplified.default_max_shape is not None
    goal, details = format_upper_bound(simplified.default_max_shape), simplified.details
    kept = f"the shape stays within {goal} m, 1/1000 of the model's size"
    if not details.proven:
        proven = format_upper_bound(details.shape_bound_m)
        kept = f"the shape bound was {goal} m, 1/1000 of the model's size, but only {proven} m are proven"
    return f"Neither a size nor a bound was given: {kept}. Set --max-shape or --ratio to change this."


def _how_to_prove() -> str:
    """Return advice on options that lead to a method with proven bounds."""
    proving = [method for method in METHODS if method.proves_bounds]
    options = [
        option_name(name)
        for method in proving
        if method.requirement
        for name in method.requirement.parameters
    ]
    names = " or ".join(method.name for method in proving)
    return f"give {' or '.join(options)}, and no option that selects a method other than {names}"
