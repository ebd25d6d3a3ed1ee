# SPDX-License-Identifier: BSD-3-Clause
"""Logs on the command line: listed, read, refused in one line."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from magmatch.data.logs.write_mcap import write_mcap
from magmatch.data.survey import Survey


@pytest.fixture
def log(tmp_path):
    pytest.importorskip("mcap", reason="MCAP is written with the extra 'ros'")
    rng, n = np.random.default_rng(0), 200
    p = np.cumsum(rng.normal(0, 0.05, (n, 3)), axis=0)
    b = np.array([2e-5, 0, -4e-5]) + 2e-6 * np.sin(3 * p)
    path = tmp_path / "drive.log"
    write_mcap(Survey(p, b, 1.7e9 + 0.02 * np.arange(n), Rotation.random(n, rng=rng), frame="hall"), path)
    return path


def test_info_lists_topics_and_says_which_would_be_read(log, run):
    outcome = run("info", log)
    assert outcome.code == 0
    assert "/magmatch/field  sensor_msgs/MagneticField  200 messages, 50 Hz" in outcome.out
    assert "/magmatch/pose" in outcome.out
    facts = json.loads(run("info", log, "--json").out)
    assert facts["kind"] == "log"
    assert facts["chosen"] == {"field": "/magmatch/field", "poses": "/magmatch/pose"}
    assert facts["topics"][0]["count"] == 200
    assert facts["frame"] == "hall"


def test_info_of_a_log_without_a_survey_still_lists_topics(log, run):
    outcome = run("info", log, "--mag-topic", "/nothing")
    assert outcome.code == 0
    assert "/magmatch/field" in outcome.out
    assert "no such topic" in outcome.out


def test_a_log_is_taken_wherever_a_survey_is(log, run, tmp_path):
    assert run("convert", log, tmp_path / "out.csv").code == 0
    outcome = run("map", log, "--prior", "spline", "--out", tmp_path / "out.map")
    assert outcome.code == 0, outcome.err
    assert "Mapped 200 samples" in outcome.err


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--mag-topic", "/nothing"], "--mag-topic /nothing: no such topic"),
        (["--pose-topic", "/magmatch/field"], "expected a pose topic"),
        (["--pose-frames", "map"], "--pose-frames: expected two frames"),
        (["--extrinsic", "1 2"], "--extrinsic: expected x y z"),
        (["--trajectory", "nowhere.tum"], "nowhere.tum: no such file"),
    ],
)
def test_wrong_options_end_in_one_line(options, words, log, refused, tmp_path):
    refused(["convert", log, tmp_path / "out.csv", *options], words)
    assert not (tmp_path / "out.csv").exists()
