# SPDX-License-Identifier: BSD-3-Clause
"""The walks of IPIN 2023 by dead reckoning, where they are present: never worse than with the settings we chose."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from magmatch.data.formats.phones.read import read_phone_log
from magmatch.data.tables.text import read_bytes
from magmatch.preparation.odometry.dead_reckon import dead_reckon

pytest.importorskip("vqf", reason="the extra 'odometry' is not installed")
RECORDINGS = Path(__file__).parents[3] / "../shared/data"


@pytest.mark.parametrize("route", [4, 5])
def test_walks_that_no_setting_was_chosen_on_are_no_worse_than_the_baseline(route):
    logs = sorted((RECORDINGS / "ipin2023").glob(f"*Trial0{route}_repetition*.txt.gz"))
    if not logs:
        pytest.skip("the walks of IPIN 2023 are not on this machine")
    baselines = json.loads((RECORDINGS / "walks_baselines.json").read_text())["odometry"]
    errors = []
    for k, path in enumerate(logs, start=1):
        rows = re.findall(rb"(?m)^POSI;([\d.]+);\d+;([-\d.]+);([-\d.]+);", read_bytes(path))
        t, latitude, longitude = np.array(rows, dtype=float).T
        east = np.radians(longitude - longitude[0]) * 6.371e6 * np.cos(np.radians(latitude[0]))
        truth = np.column_stack([east, np.radians(latitude - latitude[0]) * 6.371e6, 0 * t])
        found = dead_reckon(read_phone_log(path)).trajectory.interpolate(t)[0]
        truth, found = truth - truth.mean(axis=0), found - found.mean(axis=0)
        apart = Rotation.align_vectors(truth, found)[0].apply(found) - truth
        baseline = baselines[f"ipin2023/route{route}_{k}"]["rmse_m"]
        errors.append((float(np.sqrt((apart**2).sum(axis=1).mean())), baseline))
    ours, theirs = np.median(errors, axis=0)
    assert ours <= theirs
