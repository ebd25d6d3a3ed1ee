# SPDX-License-Identifier: BSD-3-Clause
"""Slam and merge that are killed go on where they were, give the same bits, and leave nothing half-written."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import magmatch
from drifting import Place, drifting_walk
from magmatch.data.survey import Survey
from magmatch.geometry import random_transform
from magmatch.slam.output.folder import unfinished

pytest.importorskip("plotly", reason="the report is drawn with the extra 'viz'")
SOURCE = Path(magmatch.__file__).parents[1]
# Keeps every step at once: a kill finds some kept and some not, however fast the machine is.
EAGER = """
import sys
from magmatch import runner
from magmatch.cli.main import main
runner.KEEP_EVERY_S = -1.0
sys.exit(main(sys.argv[1:]))
"""
RESULTS = ("walk.csv", "walk.tum", "graph.g2o", "covariances.csv")


def start(*words):
    path = os.pathsep.join([str(SOURCE), os.environ.get("PYTHONPATH", "")])
    command = [sys.executable, "-W", "ignore", "-c", EAGER, *map(str, words)]
    return subprocess.Popen(command, stderr=subprocess.PIPE, text=True, env=os.environ | {"PYTHONPATH": path})


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="kills with a POSIX signal")
def test_a_killed_run_goes_on_and_gives_the_same_bits(tmp_path):
    drifting_walk(Place(1), 1)[0].save(tmp_path / "walk.csv")
    whole = start("slam", tmp_path / "walk.csv", "--out", tmp_path / "whole")
    said = whole.communicate()[1]
    assert whole.returncode == 0, said
    out, kept = tmp_path / "out", unfinished(tmp_path / "out")
    counts = []
    for n in (3, 9):
        run = start("slam", tmp_path / "walk.csv", "--out", out)
        while run.poll() is None and len(list(kept.glob("*.results"))) < n:
            time.sleep(0.01)
        run.kill()
        run.communicate()
        assert run.returncode == -signal.SIGKILL  # it was cut off in the middle
        assert not out.exists()
        counts.append(len(list(kept.glob("*.results"))))
    assert 3 <= counts[0] < counts[1]
    before = {path.name: path.stat().st_mtime_ns for path in kept.glob("[0-9]*.results")}
    run = start("slam", tmp_path / "walk.csv", "--out", out, "--verbose")
    said = run.communicate()[1]
    assert run.returncode == 0, said
    assert f"going on with {len(before)} results" in said
    for name in RESULTS:
        assert (out / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()
    assert {path.name for path in tmp_path.iterdir()} == {"walk.csv", "whole", "out"}


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="kills with a POSIX signal")
def test_a_killed_merge_goes_on_with_the_pairs_that_are_missing(tmp_path):
    rng, files = np.random.default_rng(0), []
    for k, low in enumerate((-3.0, -1.6, -0.4, -2.2)):
        p = rng.uniform((low, -1.0, -0.2), (low + 3.4, 1.0, 0.5), (500, 3))
        survey = Survey(p, Place(3, n=30).field(p) + 2e-7 * rng.standard_normal(p.shape), name=f"s{k}.csv")
        files.append(tmp_path / survey.name)
        survey.transformed(random_transform(rng, 5.0)).save(files[-1])
    whole = start("merge", *files, "--out", tmp_path / "whole")
    said = whole.communicate()[1]
    assert whole.returncode == 0, said
    out, kept = tmp_path / "out", unfinished(tmp_path / "out")
    run = start("merge", *files, "--out", out)
    while run.poll() is None and len(list(kept.glob("*.results"))) < 2:
        time.sleep(0.01)
    run.kill()
    run.communicate()
    assert run.returncode == -signal.SIGKILL
    assert not out.exists()
    n = len(list(kept.glob("[0-9]*.results")))
    run = start("merge", *files, "--out", out, "--verbose")
    said = run.communicate()[1]
    assert run.returncode == 0, said
    assert f"going on with {n} results" in said
    for name in ("s0.csv", "s3.csv", "graph.g2o", "covariances.csv"):
        assert (out / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()
    assert not kept.exists()
