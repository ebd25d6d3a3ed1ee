# SPDX-License-Identifier: BSD-3-Clause
"""Pages stand alone, say the verdict in words, and stay small."""

import base64
import gzip
import json
import re
from dataclasses import replace
from html import unescape

import numpy as np
import pytest

from magmatch.data.survey import Survey
from magmatch.localization.result import LocalizationResult, LocalizationStatus
from magmatch.registration.config import RegistrationConfig
from magmatch.registration.result import Alternative, DegenerateDirection, Links, RegistrationResult, Status
from magmatch.viz.figures.registration_figures import shown_pose
from magmatch.viz.pages.registration_page import write_report
from magmatch.viz.pages.track_page import verdict_on
from magmatch.viz.verdict import meaning, next_steps, steps_after

pytest.importorskip("plotly")
from magmatch.viz.view import write_view

LIMIT = 5e6


@pytest.fixture(scope="module")
def report(report):
    return report.read_text()


def without_links(page):
    """The page, terms of the glossary as plain words."""
    return re.sub(r'<a class="term"[^>]*>(.*?)</a>', r"\1", page)


def figures_in(page):
    return [
        json.loads(text) for text in re.findall(r'<script type="application/json">(.*?)</script>', page, re.DOTALL)
    ]


def test_a_report_needs_no_network(report):
    assert '<meta name="viewport" content="width=device-width, initial-scale=1">' in report  # of a phone, too
    assert "What the published method sees" not in report
    (packed,) = re.findall(r'<script type="text/plain" id="plotly">(.*?)</script>', report)
    assert b"newPlot" in gzip.decompress(base64.b64decode(packed))
    without_data = re.sub(r"<script type=.*?</script>", "", report, flags=re.DOTALL)
    assert not re.search(r"src\s*=|href\s*=\s*.[^#]|https?://|@import|url\(", without_data)


def test_a_report_says_the_verdict_in_words(report):
    said = ["Accepted", "probability of being right 0.997", "10 of 10 cells agree", "90% of the target", "0.573 deg"]
    said += ["10.0 mm", "100, 0, 0 nT", "Other poses", "search: invariants", "aa", "seed 0"]
    for words in said:
        assert words in without_links(report)


def test_verdict_and_pictures_stand_before_tables_and_only_what_few_ask_for_is_folded(report):
    at = [report.index(words) for words in ('class="verdict', 'class="plot"', "<table", "Inliers", "<dl>")]
    assert at == sorted(at)
    folded = re.findall(r"<summary>(.*?)</summary>", report)
    assert folded[:2] == ["What to do next", "Matching keypoints"]
    assert {"Numbers behind the decision", "Time per stage", "settings.yaml"} < set(folded)


def test_every_linked_term_is_explained_on_the_page(report):
    linked = set(re.findall(r'class="term" href="#([^"]+)"', report))
    assert {"term-overlap", "term-residual", "term-keypoint", "term-cell"} <= linked
    assert linked == set(re.findall(r'<dt id="([^"]+)">', report))


def test_a_report_draws_all_there_is(report):
    kinds = [figure["data"][0]["type"] for figure in figures_in(report)]
    in_space, slices, matches = ["scatter3d"] * 2, ["heatmap"] * 3, ["scatter3d"]
    agreement, sureness = ["heatmap", "scatter3d", "bar"], ["scatter3d"] * 2
    others = ["scatter"]
    assert kinds == in_space + slices + matches + agreement + sureness + others


def test_every_picture_has_words_that_stand_for_it(report):
    words = re.findall(r'<div class="plot" tabindex="0" role="img"[^>]* aria-label="([^"]*)"', report)
    assert len(words) == len(figures_in(report))
    assert all(len(alt) > 40 for alt in words)


@pytest.mark.parametrize("status", Status)
def test_every_status_says_what_it_means_and_what_to_do(pair, tmp_path, status):
    result = pair.accepted if status is Status.ACCEPTED else replace(pair.refused, status=status)
    write_report(tmp_path / "r.html", None, None, result)
    page = unescape((tmp_path / "r.html").read_text())
    assert meaning(status) in page
    assert all(step in page for step in next_steps(status))


def test_a_result_with_nothing_but_a_status_is_reported(pair, tmp_path):
    bare = RegistrationResult(Status.UNINFORMATIVE, "no structure", None)
    write_report(tmp_path / "r.html", pair.base_map, pair.target_map, bare)
    assert len(figures_in((tmp_path / "r.html").read_text())) == 2


def test_other_poses_are_listed_with_their_numbers(pair, tmp_path):
    T = pair.accepted.T_base_target
    others = (Alternative(T, 0.6), *(Alternative(T * T, None) for _ in range(14)))
    result = replace(pair.refused, status=Status.AMBIGUOUS, alternatives=others)
    write_report(tmp_path / "r.html", pair.base_map, pair.target_map, result)
    section = (tmp_path / "r.html").read_text().split("Other poses</h2>")[1].split("</section>")[0]
    assert section.count("<tr>") == 1 + 10
    assert "<td>0.600</td>" in section
    assert "lists 5 more" in section
    assert "<th scope='col'>residual</th>" in section


def test_poses_in_other_maps_of_a_folder_are_named_but_not_drawn_in_this_one(pair, tmp_path):
    T = pair.accepted.T_base_target
    others = (Alternative(T, 0.4, "cellar.map", 12.5), Alternative(T * T, 0.3, None, 11.0))
    result = replace(pair.refused, alternatives=others, base="hall.map")
    assert shown_pose(result) is others[1].T_base_target
    write_report(tmp_path / "r.html", pair.base_map, pair.target_map, result)
    section = (tmp_path / "r.html").read_text().split("Other poses</h2>")[1].split("</section>")[0]
    first, second = re.findall("<tr>(.*?)</tr>", section)[1:]
    assert first.count("<td></td>") == 2  # overlap and residual are those of this map
    for words, row in (("cellar.map", first), ("12.5", first), ("hall.map", second), ("11.0", second)):
        assert words in row


def test_what_the_decision_was_weighed_from_is_shown(pair, tmp_path):
    result = replace(pair.accepted, evidence={"log_odds": 221.5, "lead": None, "something_new": 3.0})
    write_report(tmp_path / "r.html", None, None, result)
    page = without_links((tmp_path / "r.html").read_text())
    for words in ("evidence for the best pose over unrelated surveys (nats)", "221.5", "something new"):
        assert words in page
    assert "lead over" not in page


def test_a_refusal_says_why_and_gives_no_transform(pair, tmp_path):
    write_report(tmp_path / "r.html", pair.base, pair.target, pair.refused)
    page = (tmp_path / "r.html").read_text()
    for words in ("Not accepted: degenerate", "sliding along base x", "No transform: none was accepted"):
        assert words in page
    assert len(figures_in(page)) == 4  # surveys, what is left free, and other poses, since there are no maps


def test_the_same_result_gives_the_same_page(report, pair, tmp_path):
    write_report(tmp_path / "r.html", pair.base_map, pair.target_map, pair.accepted)
    assert (tmp_path / "r.html").read_text() == report


def test_names_cannot_break_out_of_the_page(pair, tmp_path):
    evil = "</script><script>alert(1)</script>"
    inputs = ({"name": evil, "sha256": "a"}, {"name": evil, "sha256": "b"})
    base = replace(pair.base, name=evil)
    write_report(
        tmp_path / "r.html", base, replace(pair.target, name=evil), replace(pair.accepted, inputs=inputs, reason=evil)
    )
    write_view(tmp_path / "v.html", [base])
    for name in ("r.html", "v.html"):
        assert "<script>alert" not in (tmp_path / name).read_text()


def test_a_hundred_thousand_samples_stay_under_five_megabytes(pair, tmp_path):
    rng = np.random.default_rng(0)
    p = rng.uniform(0, 2, (100_000, 3))
    large = Survey(p, rng.normal(3e-5, 5e-6, p.shape), times=np.arange(100_000.0), name="large.csv")
    # All that a report can hold: maps, links, every direction free, other poses. The fit itself does not matter here.
    base, target = (replace(m, survey=large) for m in (pair.base_map, pair.target_map))
    free = tuple(DegenerateDirection(xi, "words") for xi in np.eye(6))
    links = Links(p[:200], p[200:400])
    others = (Alternative(pair.accepted.T_base_target, 0.5),) * 30
    accepted = replace(pair.accepted, degenerate_directions=free, links=links, alternatives=others)
    write_report(tmp_path / "a.html", base, target, accepted)
    write_view(tmp_path / "v.html", [large, base])
    for page in tmp_path.iterdir():
        assert page.stat().st_size < LIMIT
    assert "3000 of 100000 samples of large.csv drawn" in (tmp_path / "a.html").read_text()
    assert "Based on 3000 of the target's 100000 samples" in unescape((tmp_path / "a.html").read_text())


def test_a_map_is_viewed_as_in_its_report_and_names_may_repeat(pair, tmp_path):
    write_view(tmp_path / "v.html", [pair.base_map, pair.base, pair.base])
    page = (tmp_path / "v.html").read_text()
    for words in ("Standard deviation", "Map of base.csv", "Coverage: base.csv", "Survey base.csv"):
        assert words in page
    anchors = re.findall(r'<h2 id="([^"]+)"', page)
    assert len(set(anchors)) == len(anchors) == 7


@pytest.mark.parametrize("status", [Status.AMBIGUOUS, Status.UNINFORMATIVE])
@pytest.mark.parametrize("known", ["is_gravity_aligned", "is_planar"])
def test_what_is_known_already_is_not_asked_for(status, known):
    def advised(prior):
        config = RegistrationConfig.model_validate({"prior": prior}).model_dump(mode="json")
        return " ".join(steps_after(RegistrationResult(status, "so it is", None, config=config)))

    assert "--gravity-aligned" in advised({})
    assert "--gravity-aligned" not in advised({known: True})
    assert "--prior-pose" in advised({known: True})


@pytest.mark.parametrize(
    ("status", "headline", "kind"),
    [
        (LocalizationStatus.LOCALIZED, "Localized; a pose for 83% of the time", "good"),
        (LocalizationStatus.LOST, "Lost at the end; a pose for 83% of the time", "refused"),
        (LocalizationStatus.NEVER, "Never localized", "refused"),
    ],
)
def test_only_a_log_that_ended_localized_is_good_news(status, headline, kind):
    said = verdict_on(LocalizationResult(status, "so it is", share=0.83))
    assert f'class="verdict {kind}"' in said
    assert f"{headline}</strong>" in said
    assert "so it is" in said
