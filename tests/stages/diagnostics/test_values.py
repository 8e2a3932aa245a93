"""Values of diagnostics are plain numbers and text, which the cache and JSON store."""

import json
import math

import numpy as np
import pytest

from scanloom.pipeline.cache.digest import to_canonical_json
from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.files.codes import FILE_DAMAGED


@pytest.mark.parametrize(
    ("value", "plain"),
    [
        (np.float64(0.5), 0.5),
        (np.float32(0.5), 0.5),
        (np.array([0.5]), 0.5),
        (np.int64(3), 3),
        (np.bool_(True), True),
        (np.str_("a"), "a"),
        (np.float64("nan"), "nan"),
        (math.inf, "inf"),
        ([1, 2], "[1, 2]"),
    ],
)
def test_a_value_becomes_plain(value: object, plain: float | str) -> None:
    made = FILE_DAMAGED.warning("it is {value}", value=value)
    assert made.values["value"] == plain
    assert type(made.values["value"]) is type(plain)
    assert Diagnostic.from_dict(json.loads(to_canonical_json(made.to_dict()))) == made
