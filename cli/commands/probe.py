"""Command `probe`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from scanloom.cli.output import Output
from scanloom.cli.paths import require_file
from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.atomic_files import write_file_atomically
from scanloom.stages.stereo.codes import DEPTH_NETWORK_SIDECAR_INVALID, DEPTH_NETWORK_UNIDENTIFIED
from scanloom.stages.stereo.networks.sidecar import format_sidecar, get_sidecar_path
from scanloom.stages.stereo.networks.sidecar_guessing import probe_network


def probe(
    network: Annotated[
        Path,
        typer.Argument(metavar="FILE.onnx", help="Network (ONNX) for depth --model.", show_default=False),
    ],
    out: Output,
    write: Annotated[
        bool,
        typer.Option(
            "--write",
            help="Write the result to FILE.toml, which must not exist.",
        ),
    ] = False,
) -> None:
    """Detect the inputs and outputs of a depth network.

    Runs the network on a pair of images with known disparity, and prints the TOML file that depth.model reads
    next to the network. Check it before use.

    Example: scanloom lab probe my_network.onnx --write
    """
    target = get_sidecar_path(require_file(network))
    if write and target.exists():
        raise InputError(
            DEPTH_NETWORK_SIDECAR_INVALID,
            "this file already exists",
            target,
            remedy="rename or remove it, or omit --write.",
        )
    with out.progress("probe", "ways") as progress:
        found = probe_network(network, progress=progress)
    text = format_sidecar(found.sidecar)
    if found.error_px is None:
        emit(
            DEPTH_NETWORK_UNIDENTIFIED.warning(
                "a network for single images cannot be probed: range, mean, std, unit and sign are guessed",
                remedy="compare them with the documentation of the network",
            )
        )
    if found.alternatives:
        out.remark(f"the image pair cannot distinguish this from {'; '.join(found.alternatives)}")
    if write:
        with write_file_atomically(target) as draft:
            draft.write_text(text, encoding="utf-8", newline="\n")
    output = {"output": str(target)} if write else {}
    out.result({**output, **found.to_dict()}, None if out.as_json or write else text)
