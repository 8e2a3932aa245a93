"""Method table: derived parameters and commands, selection by `auto`, and a sixth row."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from coloured_meshes import sheet

from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.params import describe_all, describe_own, find_nested, resolve
from scanloom.stages.simplification.method_selection import select_method
from scanloom.stages.simplification.methods import METHODS, Method
from scanloom.stages.simplification.params import SimplifyParams
from scanloom.stages.simplification.seams.params import SeamsParams
from scanloom.stages.simplification.simplify import simplify

ROOT = Path(__file__).parents[3]


# -- parameters derived from the table --------------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS, ids=lambda method: method.name)
def test_parameters_of_a_method_are_in_the_field_with_its_name(method: Method[Any, Any]) -> None:
    assert find_nested(SimplifyParams).get(method.name) is method.params
    assert set(method.shared) <= set(describe_own(SimplifyParams))


def test_parameter_names_are_unique_among_methods() -> None:
    names = [name.rpartition(".")[2] for name in describe_all(SimplifyParams)]
    assert len(names) == len(set(names))


def test_a_method_gets_its_own_parameters() -> None:
    seams = next(method for method in METHODS if method.name == "seams")
    assert seams.get_own_params(SimplifyParams()) == SeamsParams()
    own = SeamsParams(texture_weight=2.0)
    assert seams.get_own_params(SimplifyParams(seams=own, max_shape=1.0)) is own


def test_parameters_of_a_method_can_be_an_object_or_a_dict() -> None:
    given = SimplifyParams(ratio=0.5, seams=SeamsParams(duplicate_penalty=0.0, part_border_penalty=2.0))
    assert resolve(SimplifyParams, None, {"ratio": 0.5, "seams": given.seams}) == given
    assert resolve(SimplifyParams, given, {"seams": {"duplicate_penalty": 0.2}}).seams == SeamsParams(
        duplicate_penalty=0.2, part_border_penalty=2.0
    )
    mesh = sheet(12)
    one, other = (simplify(mesh, ratio=0.5, seams=own) for own in (given.seams, dict(vars(given.seams))))
    assert one.method == other.method == "seams"
    assert np.array_equal(one.mesh.vertices, other.mesh.vertices)


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        (
            {"planar": {"crease_angle": 95.0}},
            "planar.crease_angle is 95 degrees; it must be at most 90 degrees.",
        ),
        ({"planar": {"angle": 1.0}}, "unknown parameter 'planar.angle'; did you mean patch_angle?"),
        (
            {"planar": {"crease_angel": 1.0}},
            "unknown parameter 'planar.crease_angel'; did you mean crease_angle?",
        ),
        ({"crease_angle": 9.0}, "unknown parameter 'crease_angle'; did you mean planar.crease_angle?"),
        ({"planar": 9.0}, "planar is 9.0; it must be of type PlanarParams."),
        ({"planar": SeamsParams()}, "it must be of type PlanarParams."),
    ],
)
def test_mistakes_in_parameters_of_a_method_are_named(given: dict[str, Any], sentence: str) -> None:
    with pytest.raises(UsageError) as refused:
        resolve(SimplifyParams, None, given)
    assert sentence in str(refused.value)


# -- selection by auto ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("given", "plain", "in_pieces"),
    [
        ({}, "jia01", "jia01"),
        ({"ratio": 0.5}, "quadric", "seams"),
        ({"triangles": 5, "fit": False}, "quadric", "seams"),
        ({"ratio": 0.5, "attribute_scale": 0.0}, "quadric", "seams"),
        ({"ratio": 0.5, "seams": {"duplicate_penalty": 0.0}}, "seams", "seams"),
        ({"ratio": 0.5, "max_shape": 0.1}, "certified", "certified"),
        ({"max_color": 0.0}, "certified", "certified"),
        ({"max_color": 9.0, "certified": {"tight_bounds": True}}, "certified", "certified"),
        ({"max_shape": 0.1, "jia01": {"paper_rule": False}}, "certified", "certified"),
        ({"ratio": 0.5, "jia01": {"resolution": 0.1}}, "jia01", "jia01"),
        ({"jia01": {"paper_rule": True}}, "jia01", "jia01"),
    ],
)
def test_auto_selects_the_first_method_that_supports_all_parameters(
    given: dict[str, Any], plain: str, in_pieces: str
) -> None:
    params = resolve(SimplifyParams, None, given)
    assert select_method(params).name == plain
    assert select_method(params, has_corner_attributes=True).name == in_pieces


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        (
            {"certified": {"tight_bounds": True}},
            "certified.tight_bounds belongs to method certified, which needs max_shape or max_color.",
        ),
        (
            {"seams": {"texture_weight": 0.0}},
            "seams.texture_weight belongs to method seams, which needs triangles or ratio.",
        ),
        (
            {"max_shape": 0.1, "planar": {"patch_angle": 9.0}},
            "planar.patch_angle belongs to method planar, which auto never selects; give method planar, too.",
        ),
        (
            {"max_shape": 0.1, "certified": {"tight_bounds": True}, "jia01": {"resolution": 1.0}},
            "certified.tight_bounds belongs to method certified, which does not support jia01.resolution",
        ),
        (
            {"method": "jia01", "fit": True, "planar": {"patch_angle": 9.0}},
            "planar.patch_angle is not supported by method jia01",
        ),
        ({"method": "planar", "attribute_scale": 1.0}, "attribute_scale is not supported by method planar"),
        (
            {"method": "planar", "triangles": 9},
            "method planar stops only at its bounds; leave out triangles",
        ),
        ({"method": "seams"}, "method seams needs a triangle count; give triangles or ratio."),
        (
            {"method": "certified"},
            "method certified needs an error bound; give max_shape, max_color or both.",
        ),
    ],
)
def test_unsupported_combinations_are_reported(given: dict[str, Any], sentence: str) -> None:
    with pytest.raises(UsageError) as refused:
        select_method(resolve(SimplifyParams, None, given))
    assert sentence in str(refused.value)


def test_an_unsupported_parameter_is_reported_with_the_methods_that_support_it() -> None:
    mesh = sheet(8)
    with pytest.raises(
        UsageError, match=r"^record is not supported by method planar, only by quadric, .*\.$"
    ):
        simplify(mesh, method="planar", record=True)
    with pytest.raises(UsageError, match="jia01, only by quadric, certified and seams"):
        simplify(mesh, method="jia01", importance=[2.0] * len(mesh.vertices))


# -- a sixth method --------------------------------------------------------------------------------------

# The added row and field.
_IMPORTS = """from scanloom.stages.simplification.sixth import run as cut
from scanloom.stages.simplification.sixth.details import CutDetails
from scanloom.stages.simplification.sixth.params import CutParams
"""
_ROW = """    Method(
        name="cut",
        text="what is above a height falls away.",
        params=CutParams,
        details=CutDetails,
        run=cut.run,
        requirement=Requirement("a height", ("cut.max_height",), "give cut.max_height"),
        capabilities=Capabilities(importance=False, record=False),
    ),
"""
_PARAMS = "from scanloom.stages.simplification.sixth.params import CutParams\n"
_FIELD = "    cut: CutParams = CutParams()\n"
_CALLS = """
import contextlib, io, json, sys
import numpy as np
from scanloom.cli.app import run_command
from scanloom.pipeline.config import Config
from scanloom.stages import UsageError, simplify, write_mesh
from scanloom.stages.surface.mesh import Mesh

y, x = np.mgrid[:5, :5]
at = np.arange(25).reshape(5, 5)
squares = np.stack([at[:-1, :-1], at[:-1, 1:], at[1:, 1:], at[1:, :-1]], 2).reshape(-1, 4)
triangles = np.concatenate([squares[:, [0, 1, 2]], squares[:, [0, 2, 3]]]).astype(np.int32)
mesh = Mesh(np.stack([x, y, y], 2).reshape(-1, 3).astype(float), triangles)
write_mesh("sheet.ply", mesh)

def run(*words):
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = run_command(words)
    return [code, out.getvalue(), err.getvalue()]

def refused(**given):
    try:
        simplify(mesh, **given)
    except UsageError as error:
        return str(error)

config = Config.loads("[simplify.cut]\\nmax_height = 2.0\\nslope = 0.5\\n")
json.dump({
    "removed": simplify(mesh, cut={"max_height": 2.0, "slope": 0.0}).details.removed,
    "method": simplify(mesh, config.simplify).method,
    "toml": config.dumps(),
    "help": run("simplify", "--help"),
    "json": run("simplify", "sheet.ply", "out.ply", "--max-height", "2", "--json"),
    "text": run("simplify", "sheet.ply", "again.ply", "--max-height", "2", "--set", "simplify.cut.slope=0"),
    "refused": [
        refused(cut={"slope": 1.0}),
        refused(method="cut"),
        refused(method="quadric", ratio=0.5, cut={"max_height": 1.0}),
        refused(cut={"max_height": 1.0}, importance=[2.0] * 25),
        refused(method="sixth"),
    ],
}, sys.stdout)
"""


@pytest.fixture(scope="module")
def six(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Run a copy of the package with one folder and one table row more; return its output."""
    copy = tmp_path_factory.mktemp("six")
    for package in ("scanloom", "stages", "pipeline", "cli"):
        shutil.copytree(ROOT / package, copy / package, ignore=shutil.ignore_patterns("__pycache__", "*.so"))
    for kernels in (ROOT / "stages").glob("_kernels*.so"):
        (copy / "stages" / kernels.name).symlink_to(kernels)
    room = copy / "stages" / "simplification"
    shutil.copytree(Path(__file__).parent / "sixth", room / "sixth")
    imports, table = (room / "methods.py").read_text().split('\nP = TypeVar("P")\n')
    rows, end = table.rsplit(")\n", 1)
    (room / "methods.py").write_text(f'{imports}{_IMPORTS}\nP = TypeVar("P")\n{rows}{_ROW})\n{end}')
    params = (room / "params.py").read_text()
    (room / "params.py").write_text(params.replace("\nAUTO =", f"{_PARAMS}\nAUTO =").rstrip() + f"\n{_FIELD}")
    ran = subprocess.run(
        [sys.executable, "-c", _CALLS],
        cwd=copy,
        env={**os.environ, "PYTHONPATH": str(copy), "COLUMNS": "200"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert ran.returncode == 0, ran.stderr
    output: dict[str, Any] = json.loads(ran.stdout)
    return output


@pytest.mark.slow
def test_a_sixth_method_is_in_the_api(six: dict[str, Any]) -> None:
    assert six["removed"] == 16
    assert six["method"] == "cut"


@pytest.mark.slow
def test_a_sixth_method_is_in_the_help_and_in_toml(six: dict[str, Any]) -> None:
    code, text, _ = six["help"]
    assert code == 0
    assert "--max-height" in text
    assert "auto|quadric|certified|seams|jia01|planar|cut" in text
    assert "--slope" not in text
    assert "# How much the height grows along x.\n# a number; at least 0; default: 0.25\n" in six["toml"]
    assert "slope = 0.5" in six["toml"]
    assert "what is above a height falls away" in " ".join(six["toml"].replace("\n#", "").split())


def test_a_sixth_method_is_in_json_and_in_text_output(six: dict[str, Any]) -> None:
    code, text, _ = six["json"]
    assert code == 0
    assert json.loads(text)["method"] == "cut"
    assert json.loads(text)["details"] == {"removed": 15}
    assert six["text"][1].endswith("\n\nCut off: 16 triangles.\n")


def test_a_sixth_method_is_in_messages_of_auto(six: dict[str, Any]) -> None:
    assert six["refused"] == [
        "cut.slope belongs to method cut, which needs cut.max_height.",
        "method cut needs a height; give cut.max_height.",
        "cut.max_height is not supported by method quadric; leave one of them out.",
        "importance is not supported by method cut, only by quadric, certified and seams.",
        "method is 'sixth'; it must be one of auto, quadric, certified, seams, jia01, planar, cut.",
    ]
