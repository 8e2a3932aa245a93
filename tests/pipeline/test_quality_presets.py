"""Quality presets.

Their parameters, precedence of explicit parameters, and unchanged keys of unaffected stages.
"""

import pytest

from scanloom.pipeline.config import Config
from scanloom.pipeline.graph import STAGES
from scanloom.pipeline.quality_presets import QUALITIES, STANDARD
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.params import flatten, get_value

OTHERS = sorted(set(QUALITIES) - {STANDARD})


def test_standard_equals_the_defaults():
    assert Config.from_quality(STANDARD) == Config()
    assert Config.loads('quality = "standard"') == Config()


@pytest.mark.parametrize("quality", OTHERS)
def test_a_quality_sets_only_its_own_parameters(quality):
    config, usual = Config.from_quality(quality), Config()
    sections = [name for name in Config.get_types() if getattr(config, name) != getattr(usual, name)]
    assert sorted(sections) == sorted(QUALITIES[quality])
    for section, values in QUALITIES[quality].items():
        for name, value in flatten(values).items():
            assert get_value(getattr(config, section), name) == value
            assert get_value(getattr(usual, section), name) != value


@pytest.mark.parametrize("quality", OTHERS)
def test_stages_unaffected_by_a_quality_keep_their_keys(quality):
    config, left = Config.from_quality(quality), []
    for stage in STAGES:
        params = [{name: one.to_canonical(name) for name in stage.sections} for one in (config, Config())]
        if not set(stage.sections) & set(QUALITIES[quality]):
            assert params[0] == params[1], stage.name
            left.append(stage.name)
    assert {"clean", "refine", "adjust"} <= set(left)


def test_explicit_parameters_win_even_if_equal_to_the_default():
    text = 'quality = "draft"\n[fuse]\nvoxel_factor = 1\n[texture]\nquality = 80\n'
    config = Config.loads(text).set(["report.pictures=true"])
    assert config.fuse.voxel_factor == 1.0
    assert config.report.pictures
    assert config.texture.quality == 80
    assert config.texture.alignment_iterations == QUALITIES["draft"]["texture"]["alignment_iterations"]


def test_an_explicit_quality_wins_over_the_file():
    text = 'quality = "draft"\n[fuse]\nvoxel_size = 0.5\n'
    config = Config.loads(text, quality="best")
    assert config == Config.from_quality("best").set(["fuse.voxel_size=0.5"])
    assert Config.loads(text, quality=STANDARD) == Config().set(["fuse.voxel_size=0.5"])


@pytest.mark.parametrize("quality", QUALITIES)
def test_a_printed_configuration_keeps_the_parameters_of_a_quality(quality):
    text = Config.from_quality(quality).dumps()
    assert Config.loads(text) == Config.from_quality(quality)


@pytest.mark.parametrize("text", ['quality = "drafty"', "quality = 3", "quality = []", "[quality]"])
def test_an_unknown_quality_is_refused_with_a_list(text):
    for quality in (None, "best"):
        with pytest.raises(
            UsageError, match=r"^f\.toml: quality is .*; it must be one of draft, standard, best"
        ):
            Config.loads(text, "f.toml", quality)
    with pytest.raises(UsageError, match=r"^quality is 'x'; it must be one of"):
        Config.from_quality("x")
