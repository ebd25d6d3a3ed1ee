# SPDX-License-Identifier: BSD-3-Clause
"""``magmatch convert``: what goes where, and what cannot."""

import pytest

from magmatch.data.read import read_survey


@pytest.mark.parametrize("ending", ["csv", "parquet", "ply", "vtk"])
def test_samples_of_a_survey_and_of_a_map_are_written(ending, place, run, tmp_path):
    for name in ("base.csv", "base.map"):
        if (name, ending) in {("base.map", "ply"), ("base.map", "vtk")}:
            continue  # grids, below
        outcome = run("convert", place / name, tmp_path / f"out.{ending}")
        assert outcome.code == 0, outcome.err
        assert (tmp_path / f"out.{ending}").stat().st_size > 0
    if ending in {"csv", "parquet"}:
        assert (read_survey(tmp_path / f"out.{ending}").field == read_survey(place / "base.csv").field).all()


@pytest.mark.parametrize("ending", ["vtk", "ply", "nc"])
def test_maps_become_grids(ending, place, run, tmp_path):
    outcome = run("convert", place / "base.map", tmp_path / f"out.{ending}", "--spacing", 0.5, "--slice", "z=0.4")
    assert outcome.code == 0, outcome.err
    assert "x 1 points, 0.5 m apart" in outcome.err


def test_a_slice_of_which_the_map_knows_nothing_is_written_with_a_warning(place, run, tmp_path):
    outcome = run("convert", place / "base.map", tmp_path / "out.vtk", "--spacing", 0.5, "--slice", "z=30")
    assert outcome.code == 0, outcome.err
    z = read_survey(place / "base.csv").positions[:, 2]
    between = f"between {z.min():.2f} and {z.max():.2f} m"
    assert f"warning: --slice: expected z {between}, where the samples are; found 30: the map knows" in outcome.err


@pytest.mark.parametrize("ending", ["tum", "g2o", "yaml"])
def test_results_become_poses(ending, place, run, tmp_path):
    outcome = run("convert", place / "result.json", tmp_path / f"out.{ending}", "--frames", "map,monday")
    assert outcome.code == 0, outcome.err


REFUSED = {
    "unknown ending of a survey": (["base.csv", "out.xlsx"], "ends in .csv"),
    "unknown ending of a map": (["base.map", "out.foo"], "ends in .csv, .parquet, .mcap, .tum, .ply, .vtk, .nc"),
    "unknown ending of a result": (["result.json", "out.csv"], "ends in .tum, .g2o, .yaml"),
    "slice of nothing": (["base.map", "out.nc", "--slice", "1.0"], "--slice"),
    "slice of another axis": (["base.map", "out.nc", "--slice", "w=1"], "--slice"),
    "spacing of dust": (["base.map", "out.nc", "--spacing", "1e-5"], "choose a larger one"),
    "one frame": (["result.json", "out.yaml", "--frames", "map"], "--frames"),
    "another tangent": (["result.json", "out.g2o", "--g2o-rotation", "euler"], "--g2o-rotation"),
    "poses of a survey without orientations": (["base.csv", "out.tum"], "needs"),
    "over itself": (["base.csv", "base.csv"], "overwrite an input"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_written_is_refused_in_one_line(case, place, refused, tmp_path):
    (source, out, *options), words = REFUSED[case]
    out = place / out if out == "base.csv" else tmp_path / out
    refused(["convert", place / source, out, *options], words, tmp_path)
