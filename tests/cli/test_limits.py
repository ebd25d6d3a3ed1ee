# SPDX-License-Identifier: BSD-3-Clause
"""How sure an answer must be, said on the command line: what is taken, what is refused, what it does."""

import json
from math import radians

import pytest

from magmatch.cli.settings import with_limits
from magmatch.registration.config import PRESETS

DEFAULT = PRESETS["default"]


def test_what_is_said_becomes_settings_and_nothing_else_changes():
    decision = with_limits(DEFAULT, 0.95, "0.1,2").decision
    assert decision.min_probability == 0.95
    assert (decision.max_sd_translation, decision.max_sd_rotation) == (0.1, pytest.approx(radians(2)))
    changed = ("min_probability", "max_sd_translation", "max_sd_rotation")
    plain = {name: getattr(DEFAULT.decision, name) for name in changed}
    assert decision.model_copy(update=plain) == DEFAULT.decision
    assert with_limits(DEFAULT, None, None) is DEFAULT
    assert with_limits(DEFAULT, None, " 100 , 180 ").decision.max_sd(1.0) == pytest.approx((100, radians(180)))
    assert with_limits(DEFAULT, 1 - 1e-12, None).decision.min_probability == 1 - 1e-12


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--min-probability", "1"), "--min-probability: expected a number between 0 and 1"),
        (("--min-probability", "nan"), "found 'nan'"),
        (("--max-sd", "0.1"), "--max-sd: expected metres,degrees"),
        (("--max-sd", "0,2"), "--max-sd: expected metres above 0"),
        (("--max-sd", "0.1,181"), "degrees from 0 to 180"),
        (("--max-sd", "inf,2"), "--max-sd"),
        (("--max-sd", "0.1,2", "--preset", "paper"), "the published method decides by its fitness"),
        (("--min-probability", "0.9", "--preset", "paper"), "uses neither"),
    ],
)
def test_a_limit_that_cannot_be_is_one_line_and_code_2(words, said, place, refused, tmp_path):
    refused(["register", place / "base.map", place / "target.map", *words, "--out", tmp_path / "r"], said, tmp_path)


def test_a_tight_spread_makes_a_found_place_degenerate(place, run):
    before = json.loads((place / "result.json").read_text())
    outcome = run("register", place / "base.map", place / "target.map", "--max-sd", "0.0001,0.001", "--json")
    result = json.loads(outcome.out)
    assert (outcome.code, result["status"]) == (3, "degenerate")
    assert result["T_base_target"] is None
    assert result["degenerate_directions"]
    assert "0.0001 m and 0.001 deg are required" in result["reason"]
    assert result["probability"] == pytest.approx(before["probability"], abs=1e-3)
    assert result["config"]["decision"]["max_sd_translation"] == 0.0001
    # Found all the same: the best candidate is the answer of before.
    for row, expected in zip(result["alternatives"][0]["T_base_target"], before["T_base_target"], strict=True):
        assert row == pytest.approx(expected, abs=1e-9)
