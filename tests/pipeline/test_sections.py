import contextlib
from dataclasses import dataclass, field, fields

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scanloom.pipeline.sections import Sections
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.params import check_parameters, param


@dataclass(frozen=True, kw_only=True)
class BrickParams:
    """Parameters of bricks."""

    size: float = param(0.5, "Side of a brick.", unit="m", low=0, low_open=True)
    workers: int = param(2, "Bricks at the same time.", low=1, invalidates=False)

    def __post_init__(self) -> None:
        check_parameters(self)


@dataclass(frozen=True, kw_only=True)
class FuseParams:
    """Fuse depth maps."""

    voxel_size: float | None = param(
        None, "Edge of a voxel; by default " + "from the depth " * 20, unit="m", low=0
    )
    weight: float = param(3.0, "Smallest weight.", low=0, high=100)
    device: str = param("cpu", "Where to work.", choices=("cpu", "cuda"))
    threads: int = param(1, "Threads.", low=1, invalidates=False)
    color: bool = param(True, "Fuse colour too.")
    name: str | None = param(None, "Any text.")
    center: tuple[float, float, float] | None = param(None, "Where it is.", unit="m")
    bricks: BrickParams = field(default=BrickParams())

    def __post_init__(self) -> None:
        check_parameters(self)


@dataclass(frozen=True, kw_only=True)
class CleanParams:
    """Clean a mesh."""

    islands: int = param(100, "Smallest piece.", unit="triangles", low=0)

    def __post_init__(self) -> None:
        check_parameters(self)


@dataclass(frozen=True)
class Config(Sections):
    fuse: FuseParams = field(default_factory=FuseParams)
    clean: CleanParams = field(default_factory=CleanParams)


configs = st.builds(
    Config,
    fuse=st.builds(
        FuseParams,
        voxel_size=st.none() | st.floats(0, 1e9),
        weight=st.floats(0, 100),
        device=st.sampled_from(["cpu", "cuda"]),
        threads=st.integers(1, 10**6),
        color=st.booleans(),
        name=st.none() | st.text(st.characters(exclude_characters="\0")),
        center=st.none() | st.tuples(*3 * [st.floats(-1e9, 1e9)]),
        bricks=st.builds(BrickParams, size=st.floats(1e-9, 1e9), workers=st.integers(1, 99)),
    ),
    clean=st.builds(CleanParams, islands=st.integers(0, 10**12)),
)


@given(configs)
def test_printed_configuration_reads_back_the_same(config):
    assert Config.loads(config.dumps()) == config


def test_defaults_are_printed_with_text_unit_range_and_default():
    text = Config().dumps()
    assert "[fuse]\n# Fuse depth maps.\n" in text
    assert "# a number in m; at least 0; not set by default\n# voxel_size =\n" in text
    assert "# Smallest weight.\n# a number; at least 0; at most 100; default: 3.0\nweight = 3.0\n" in text
    assert '# one of cpu, cuda; default: "cpu"\ndevice = "cpu"\n' in text
    assert "color = true" in text
    assert "# 3 numbers in m; not set by default\n# center =\n" in text
    assert "\n\n[fuse.bricks]\n# Parameters of bricks.\n\n# Side of a brick.\n" in text
    assert text.index("[fuse.bricks]") < text.index("[clean]")
    assert all(len(line) <= 100 for line in text.splitlines())


def test_a_file_only_sets_its_own_parameters(tmp_path):
    path = tmp_path / "f.toml"
    path.write_text('[fuse]\nvoxel_size = 1\ndevice = "cuda"\n')
    config = Config.load(path)
    assert config == Config(fuse=FuseParams(voxel_size=1.0, device="cuda"))
    assert isinstance(config.fuse.voxel_size, float)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[fuze]\n", "f.toml: there is no section 'fuze'; did you mean fuse?"),
        ("[xyz]\n", "f.toml: there is no section 'xyz'; known are fuse, clean."),
        ("fuse = 1\n", "f.toml: fuse is a section; write [fuse]"),
        (
            "[fuse]\nvoxelsize = 1\n",
            "f.toml: fuse has no parameter 'voxelsize'; did you mean fuse.voxel_size?",
        ),
        ("[clean]\nq = 1\n", "f.toml: clean has no parameter 'q'; known are islands."),
        ("[fuse]\nvoxel_size = '1'\n", "f.toml: fuse.voxel_size is '1'; it must be a number."),
        ("[fuse]\nvoxel_size = -1.0\n", "f.toml: fuse.voxel_size is -1 m; it must be at least 0 m."),
        ("[fuse]\nweight = nan\n", "f.toml: fuse.weight is not a number."),
        ("[fuse]\ndevice = 'tpu'\n", "f.toml: fuse.device is 'tpu'; it must be one of cpu, cuda."),
        ("[fuse]\nthreads = true\n", "f.toml: fuse.threads is True; it must be a whole number."),
        ("[fuse]\ncenter = 1\n", "f.toml: fuse.center is 1; it must be 3 finite numbers."),
        ("[fuse]\ncenter = [1, 2]\n", "f.toml: fuse.center is (1.0, 2.0); it must be 3 finite numbers."),
        ("[fuse]\ncenter = [1, 2, 'x']\n", "f.toml: fuse.center is (1.0, 2.0, 'x'); it must be 3 finite"),
        ("[fuse]\ncenter = [1, 2, inf]\n", "f.toml: fuse.center is (1.0, 2.0, inf); it must be 3 finite"),
        ("[fuse]\nbricks = 1\n", "f.toml: fuse.bricks is a section; write [fuse.bricks]"),
        ("[fuse.bricks]\nsize = 0\n", "f.toml: fuse.bricks.size is 0 m; it must be more than 0 m."),
        ("[fuse.bricks]\nsize = 'a'\n", "f.toml: fuse.bricks.size is 'a'; it must be a number."),
        (
            "[fuse.bricks]\nsiez = 1\n",
            "f.toml: fuse.bricks has no parameter 'siez'; did you mean fuse.bricks.size?",
        ),
        (
            "[fuse.briks]\nsize = 1\n",
            "f.toml: fuse has no parameter 'briks'; did you mean fuse.bricks or fuse.bricks.size?",
        ),
        ("[fuse]\nsize = 1\n", "f.toml: fuse has no parameter 'size'; did you mean fuse.bricks.size?"),
        ("[clean]\nislands = 1.5\n", "f.toml: clean.islands is 1.5; it must be a whole number."),
        ("[clean\n", "f.toml: this is not TOML"),
    ],
)
def test_errors_in_a_file_are_reported(tmp_path, text, message):
    path = tmp_path / "f.toml"
    path.write_text(text)
    with pytest.raises(UsageError) as raised:
        Config.load(path)
    assert str(raised.value).startswith(f"{tmp_path}/{message}")


def test_config_file_that_cannot_be_read(tmp_path):
    with pytest.raises(UsageError, match="cannot be read"):
        Config.load(tmp_path / "none.toml")
    (tmp_path / "binary").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(UsageError, match="not UTF-8"):
        Config.load(tmp_path / "binary")


def test_assignments_are_parsed_by_the_type_of_the_parameter():
    config = Config().set(
        ["fuse.voxel_size=4e-3", "fuse.color=no", "fuse.device=cuda", "fuse.threads = 4", "fuse.name=a=b.c"]
    )
    assert config.fuse == FuseParams(voxel_size=0.004, color=False, device="cuda", threads=4, name="a=b.c")
    assert config.set(["fuse.voxel_size=none"]).fuse.voxel_size is None


@pytest.mark.parametrize("row", ["1 -2.5 3e-1", "1,-2.5,0.3", "[1, -2.5, 0.3]", "(1.0 -2.5 .3)"])
def test_number_tuples_are_parsed_in_common_notations(row):
    config = Config().set([f"fuse.center={row}"])
    assert (
        config == Config.loads("[fuse]\ncenter = [1, -2.5, 0.3]") == Config(FuseParams(center=[1, -2.5, 0.3]))
    )
    assert config.fuse.center == (1.0, -2.5, 0.3)
    assert config.set(["fuse.center=none"]).fuse.center is None


@pytest.mark.parametrize(
    ("word", "message"),
    [
        ("voxel_size=1", "write section.parameter=value"),
        ("fuse.voxel_size", "write section.parameter=value"),
        ("fuse.voxel_size=big", "fuse.voxel_size is 'big'; it must be a number."),
        ("fuse.voxel_size=nan", "fuse.voxel_size is not a number"),
        ("fuse.color=maybe", "fuse.color is 'maybe'; it must be true or false."),
        ("fuse.threads=1.5", "fuse.threads is '1.5'; it must be a whole number."),
        ("fuse.threads=none", "fuse.threads is 'none'; it must be a whole number."),
        ("fuse.center=1 2", "fuse.center is (1.0, 2.0); it must be 3 finite numbers"),
        ("fuse.center=here", "fuse.center is ('here',); it must be 3 finite numbers"),
        ("fuse.thread=2", "did you mean fuse.threads?"),
        ("fuse.bricks=2", "fuse.bricks is a section; write [fuse.bricks], its parameters below."),
        ("fuse.bricks.siez=2", "fuse.bricks has no parameter 'siez'; did you mean fuse.bricks.size?"),
        ("fuse.bricks.size=-2", "fuse.bricks.size is -2 m; it must be more than 0 m"),
        ("fuse.bricks.size=big", "fuse.bricks.size is 'big'; it must be a number."),
        ("fuse.bricks.size.x=2", "fuse.bricks has no parameter 'size.x'; did you mean fuse.bricks.size?"),
        ("fuse.bricks.=2", "fuse.bricks has no parameter ''; known are size, workers."),
        ("fuse.briks.size=2", "fuse has no parameter 'briks.size'; did you mean fuse.bricks.size?"),
        ("cleen.islands=2", "did you mean clean?"),
        ("clean.islands=-1", "clean.islands is -1 triangles; it must be at least 0 triangles"),
    ],
)
def test_errors_in_assignments_are_reported(word, message):
    with pytest.raises(UsageError) as raised:
        Config().set([word])
    # An invalid value is reported with its key, like in a file; other errors with the argument.
    assert str(raised.value).startswith((f"--set {word}", word.partition("=")[0]))
    assert message in str(raised.value)


def test_nested_sections_are_read_from_files_and_assignments():
    config = Config.loads("[fuse]\nweight = 2\n[fuse.bricks]\nsize = 3\n")
    assert config.fuse == FuseParams(weight=2.0, bricks=BrickParams(size=3.0))
    # Other parameters are unchanged.
    changed = config.set(["fuse.bricks.workers=4"])
    assert changed.fuse == FuseParams(weight=2.0, bricks=BrickParams(size=3.0, workers=4))


def test_canonical_form_excludes_parameters_without_influence():
    values = Config().to_canonical("fuse")
    assert set(values) == {f.name for f in fields(FuseParams)} - {"threads"}
    assert values["bricks"] == {"size": 0.5}


def test_equal_values_have_the_same_canonical_form():
    one = Config(fuse=FuseParams(weight=1, voxel_size=-0.0))
    assert repr(one.to_canonical("fuse")["weight"]) == "1.0"
    assert repr(one.to_canonical("fuse")["voxel_size"]) == "0.0"
    rows = [Config(fuse=FuseParams(center=row)) for row in ([1, -0.0, 2], (1.0, 0, 2), np.float32([1, 0, 2]))]
    assert {repr(config.to_canonical("fuse")["center"]) for config in rows} == {"[1.0, 0.0, 2.0]"}


def test_infinity_has_no_canonical_form():
    with pytest.raises(UsageError, match=r"fuse\.voxel_size is infinite"):
        Config(fuse=FuseParams(voxel_size=float("inf"))).to_canonical("fuse")
    with pytest.raises(UsageError, match=r"fuse\.bricks\.size is infinite"):
        Config(fuse=FuseParams(bricks=BrickParams(size=float("inf")))).to_canonical("fuse")


def test_no_value_of_a_parameter_is_a_bug():
    """An integer of 400 digits raised OverflowError, and a null character ValueError."""
    from scanloom.pipeline.config import Config
    from scanloom.stages.diagnostics.errors import ScanloomError
    from scanloom.stages.params import describe_all

    keys = [f"{name}.{key}" for name, cls in Config.get_types().items() for key in describe_all(cls)]
    assert len(keys) > 150
    for key in keys:
        for text in ("9" * 400, "-" + "9" * 400, "a\0b", "nan", "inf", "", "[]", "\ud800", "1,2"):
            with contextlib.suppress(ScanloomError):
                config = Config().set([f"{key}={text}"])
                assert "\0" not in text, key
                assert Config.loads(config.dumps()) == config
