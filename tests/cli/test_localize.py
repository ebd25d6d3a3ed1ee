# SPDX-License-Identifier: BSD-3-Clause
"""``magmatch localize``: exit codes, what is written, and what is refused."""

import json
import shutil

import numpy as np
import pytest

import magmatch as mm
from drifting import Place, drifting_walk
from magmatch.field.config import SPLINE

pytest.importorskip("plotly", reason="the report is drawn with the extra 'viz'")


@pytest.fixture(scope="module")
def hall(tmp_path_factory):
    """hall.map, walk.csv in it, and other.csv elsewhere."""
    folder = tmp_path_factory.mktemp("hall")
    _, truth = drifting_walk(Place(1), 7, laps=3.0)
    field = Place(1).field(truth) + 2e-7 * np.random.default_rng(7).standard_normal(truth.shape)
    mm.build_map(mm.Survey(truth, field, name="hall"), SPLINE).save(folder / "hall.map")
    log, truth = drifting_walk(Place(1), 3, laps=0.8)
    log.save(folder / "walk.csv")
    np.save(folder / "truth.npy", truth)
    drifting_walk(Place(60), 4, laps=0.5)[0].save(folder / "other.csv")
    return folder


def test_poses_are_written_in_the_maps_frame_and_the_result_says_how_sure(run, hall, tmp_path):
    words = ["--out", tmp_path / "where.tum", "--report", tmp_path / "where.html", "--json"]
    done = run("localize", hall / "hall.map", hall / "walk.csv", *words)
    assert done.code == 0, done.err
    assert "planar" in done.err
    assert "Localized" in done.err
    found, log = mm.Trajectory.load(tmp_path / "where.tum"), mm.read_survey(hall / "walk.csv")
    rows = np.searchsorted(log.times, found.times)
    np.testing.assert_array_equal(log.times[rows], found.times)
    assert np.median(np.linalg.norm(found.positions - np.load(hall / "truth.npy")[rows], axis=1)) < 0.1
    result = json.loads(done.out)
    assert result["schema"] == "magmatch.localization/1"
    assert result["status"] == "localized"
    assert result["first_fix"][0] == found.times[0]
    assert 0.5 < result["share"] <= 1
    # With hindsight, the beginning is known too.
    assert (result["first_fix"][1], result["segments"][0]["status"]) == (0.0, "localized")
    t, shift, turn = np.array(result["sd"]).T
    assert set(t) <= set(found.times)
    assert 0 < np.median(shift) < 0.2
    assert turn.max() < np.radians(30)
    assert f"sd {np.median(shift):.2g} m" in done.err
    assert "stated poses" in (tmp_path / "where.html").read_text()
    (tmp_path / "result.json").write_text(done.out)
    read = mm.LocalizationResult.load(tmp_path / "result.json")
    assert read.to_dict() == result
    # The same again, from the result's own settings.
    before = (tmp_path / "where.tum").read_bytes()
    words = ["--out", tmp_path / "again.tum", "--config", tmp_path / "result.json"]
    assert run("localize", hall / "hall.map", hall / "walk.csv", *words).code == 0
    assert (tmp_path / "again.tum").read_bytes() == before


def test_what_is_prepared_of_a_map_is_kept_for_the_next_log_and_never_used_damaged(run, hall, tmp_path, monkeypatch):
    place, kept, out = tmp_path / "a.map", tmp_path / "a.map.index", tmp_path / "where.tum"
    shutil.copy(hall / "hall.map", place)

    def answer():
        assert run("localize", place, hall / "walk.csv", "--out", out, "--live").code == 0
        return out.read_bytes()

    first, whole = answer(), kept.read_bytes()
    with monkeypatch.context() as patch:
        for name in ("prepare", "index_walks", "rasterize"):
            patch.setattr(f"magmatch.registration.index.map_index.{name}", None)
        assert answer() == first
    kept.write_bytes(whole[:-9] + bytes([whole[-9] ^ 1]) + whole[-8:])
    assert answer() == first
    assert kept.read_bytes() == whole


def test_live_the_beginning_is_not_known_yet(run, hall, tmp_path):
    words = ["--out", tmp_path / "where.tum", "--json", "--live"]
    done = run("localize", hall / "hall.map", hall / "walk.csv", *words)
    assert done.code == 0, done.err
    result = json.loads(done.out)
    assert result["segments"][0]["status"] == "searching"
    assert result["first_fix"][1] > 2.0


def test_elsewhere_it_says_never_and_writes_no_pose(run, hall, tmp_path):
    done = run("localize", hall / "hall.map", hall / "other.csv", "--out", tmp_path / "where.tum", "--json")
    assert done.code == 3, done.err
    result = json.loads(done.out)
    assert (result["status"], result["first_fix"], result["share"]) == ("never", None, 0.0)
    assert all(line.startswith("#") for line in (tmp_path / "where.tum").read_text().splitlines())


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["{hall}/walk.csv", "{hall}/walk.csv", "--out", "{tmp}/w.tum"], "saved map"),
        (["{tmp}", "{hall}/walk.csv", "--out", "{tmp}/w.tum"], "no saved maps"),
        (["{hall}/hall.map", "{hall}/walk.csv", "--out", "{hall}/walk.csv"], "input"),
        (["{hall}/hall.map", "{hall}/walk.csv", "--out", "{tmp}/w.tum", "--planar", "--no-gravity"], "--no-gravity"),
        (["{hall}/hall.map", "{hall}/walk.csv", "--out", "{tmp}/w.tum", "--odometry-sd", "0,1"], "above 0"),
        (["{hall}/hall.map", "{hall}/walk.csv", "--out", "{tmp}/w.tum", "--max-sd", "1"], "--max-sd"),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing(refused, hall, tmp_path, words, said):
    refused(["localize", *[word.format(hall=hall, tmp=tmp_path) for word in words]], said, tmp_path)
