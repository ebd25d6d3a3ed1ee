# SPDX-License-Identifier: BSD-3-Clause
"""That a place is known is one thing, how well the pose there is known another: everywhere two sentences."""

from dataclasses import replace

import numpy as np
import pytest

from magmatch.cli.commands.localize import tell
from magmatch.geometry import path_walked
from magmatch.localization.config import LocalizerConfig
from magmatch.localization.estimate import LocalizerStatus
from magmatch.localization.localize import localize
from magmatch.localization.result import LocalizationStatus
from magmatch.viz.pages.track_page import steps_after, verdict_on, write_track_report

UNCERTAIN = "place known, pose too uncertain"


@pytest.fixture(scope="module")
def strict(place, followed):
    """The same walk, followed where no pose is as accurate as is asked for."""
    config = LocalizerConfig()
    decision = config.decision.model_copy(update={"max_sd_translation": 0.02})
    rows = np.arange(len(followed.log) // 2)
    return localize(place, followed.log.subset(rows), config.model_copy(update={"decision": decision}), live=True)


def test_a_known_place_is_said_to_be_known_though_no_pose_is_stated(strict):
    last = strict.estimates[-1]
    assert (last.status, last.is_place_known, last.phase) == ("searching", True, UNCERTAIN)
    assert last.reason.startswith("the place is known (probability ")
    assert "but the pose is too uncertain: sd 0." in last.reason
    assert "at most 0.02 m, 30 degrees are asked for (--max-sd)" in last.reason
    assert strict.poses.translation.shape == (0, 3)
    assert "a pose for 0 of" in repr(strict)


def test_a_place_is_known_only_where_its_probability_suffices_and_has_done_so_for_long_enough(strict, followed):
    for track in (strict, followed.track):
        is_probable = np.array([e.probability >= track.config.decision.min_probability for e in track.estimates])
        is_known = np.array([e.is_place_known for e in track.estimates])
        assert not (is_known & ~is_probable).any()
        walked, begins = path_walked(track.log.positions), np.flatnonzero(is_known[1:] & ~is_known[:-1]) + 1
        since = [np.flatnonzero(~is_probable[:n])[-1] for n in begins]
        # 2.5 field lengths of 0.6 m.
        assert len(begins)
        assert (walked[begins] - walked[since]).min() > 1.3
        assert all(e.is_place_known for e in track.estimates if e.is_stated)
    assert any("stated once it has stood" in e.reason for e in followed.track.estimates)


def test_table_plot_and_advice_of_the_report_agree(strict, tmp_path):
    pytest.importorskip("plotly")
    result = strict.result()
    assert result.segments[-1].phase == UNCERTAIN
    assert "--max-sd" in " ".join(steps_after(result))
    assert "left the map" not in " ".join(steps_after(result))
    assert "Pose too uncertain at the end" in verdict_on(result)
    write_track_report(tmp_path / "r.html", strict, result)
    page = (tmp_path / "r.html").read_text()
    assert f'"name":"{UNCERTAIN}"' in page
    assert f"<td>{UNCERTAIN}</td>" in page
    assert "left the map" not in page


def test_a_log_that_ends_at_a_known_place_is_not_said_to_be_lost(followed):
    estimates = list(followed.track.estimates)
    estimates[-1] = replace(estimates[-1], status=LocalizerStatus.LOST, matrix=None, covariance=None)
    result = replace(followed.track, estimates=estimates).result()
    assert result.status is LocalizationStatus.LOST
    assert "Pose too uncertain at the end in place" in tell(result)
    lost = replace(followed.track, estimates=[*estimates[:-1], replace(estimates[-1], is_place_known=False)]).result()
    assert "Lost in place" in tell(lost)
    assert "left the map" in " ".join(steps_after(lost))
