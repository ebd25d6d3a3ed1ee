# SPDX-License-Identifier: BSD-3-Clause
"""The order of the steps: what is decided is the most probable pose, and only that is settled."""

from dataclasses import dataclass, field, replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from hand_made import WeighedPose
from magmatch.data.survey import Survey
from magmatch.estimation.pose_prior import PosePrior
from magmatch.estimation.posterior import log_odds
from magmatch.field.build import build_map
from magmatch.field.config import FieldConfig
from magmatch.registration import steps
from magmatch.registration.clock import Clock
from magmatch.registration.config import RegistrationConfig
from magmatch.registration.decide.decision import DecisionConfig
from magmatch.registration.decide.estimate import Pair
from magmatch.registration.decide.support import Support
from magmatch.registration.index.map_index import prepare_index
from magmatch.registration.register import register
from magmatch.registration.result import Links, Status
from magmatch.registration.search.candidate import SearchResult
from magmatch.registration.steps import Weighed, decide_among, register_once, settle_and_decide
from magmatch.registration.weigh.bend import Bend
from magmatch.simulation.config import SimulationConfig
from magmatch.simulation.simulate import simulate

NUMBERS = FieldConfig(prior="spline", lengthscale=0.6, signal_sd=8e-6, noise_sd=4e-7, spacing=0.4)


def test_a_walk_is_compared_with_every_sample_that_was_given():
    """A map leaves out what contradicts the rest; the walk's answer does not depend on one having been made."""
    made = simulate("office-hand-held", 3, SimulationConfig(n_samples=2000))
    config = RegistrationConfig(search="pairs")
    # This base passes places twice: it shows what residuals along a path are like.
    base, target = prepare_index(build_map(made.base, NUMBERS)), made.target.subset(np.arange(240))
    fewer = build_map(target.subset(np.arange(0, len(target), 2)), NUMBERS)
    alone, mapped = (register_once(base, used, target, config, 0, Clock())[2] for used in (target, fewer))
    assert alone.is_accepted, alone.reason
    assert alone.evidence == mapped.evidence
    np.testing.assert_array_equal(alone.T_base_target.as_matrix(), mapped.T_base_target.as_matrix())


def test_the_likelier_of_two_looks_at_one_map_counts():
    # A line that crosses itself is looked at as a map and, where that is refused, as a walk.
    made, config = simulate("corridor", 0, SimulationConfig(n_samples=300)), RegistrationConfig()
    numbers = FieldConfig(prior="spline", lengthscale=1.0, signal_sd=8e-6, noise_sd=4e-7, spacing=0.5)
    base = prepare_index(build_map(made.base, numbers))
    both, walk = (
        register_once(base, made.target, made.target, config.model_copy(update={"search": search}), 0, Clock())[2]
        for search in ("auto", "pairs")
    )
    assert both.probability >= walk.probability


HERE = RigidTransform.identity()
PAIR = Pair(None, None, PosePrior(1.0), 0.6, RigidTransform.from_translation([1.0, 0.0, 0.0]), HERE)
FOUND = SearchResult(n_keypoints=7, n_correspondences=5)
NO_LINKS = Links(np.zeros((0, 3)), np.zeros((0, 3)))
# What settling moves the pose by, and how wide it leaves it.
STEP = RigidTransform.from_translation([0.0, 0.0, 0.01])


@dataclass
class HandMadeStrategy:
    """States a pose as it was weighed; settles it by a step and a wider covariance."""

    settled_covariance: np.ndarray = field(default_factory=lambda: 1e-4 * np.eye(6))
    bent: Bend | None = None
    asked: list = field(default_factory=list)
    asked_to_bend: list = field(default_factory=list)

    def state(self, pair, pose):
        self.asked.append(("state", pose))
        return pair.estimate(pose), Support(residual=1.0, n_inliers=3, links=NO_LINKS)

    def settle(self, pair, pose):
        self.asked.append(("settle", pose))
        settled = replace(pose, T_base_target=pose.T_base_target * STEP, covariance=self.settled_covariance)
        return pair.estimate(settled), Support(residual=0.9, n_inliers=4, links=NO_LINKS)

    def bend(self, pair, pose):
        self.asked_to_bend.append(pose)
        return self.bent


def decided(ranked, elsewhere=-np.inf, strategy=None, config=None):
    weighed = Weighed(strategy or HandMadeStrategy(), PAIR, FOUND, list(ranked), elsewhere)
    return settle_and_decide(weighed, config or DecisionConfig(), Clock())


def shifted(metres, **changes):
    return WeighedPose(RigidTransform.from_translation([metres, 0.0, 0.0]), **changes)


class OneLook(HandMadeStrategy):
    """Finds one pose in the only base."""

    def __init__(self, pose, heading_sd):
        super().__init__(np.diag([heading_sd**2] * 3 + [1e-4] * 3))
        self.pose, self.target = pose, None
        self.likely, self.pair, self.search = (lambda *_: ["base"]), (lambda *_: PAIR), (lambda _: FOUND)

    def refine_and_weigh(self, *_):
        return [self.pose]


@pytest.mark.parametrize(
    ("heading_sd", "found", "n_looks"),
    [(0.01, 0.0, 1), (0.12, 0.0, 2), (0.2, 3.0, 2)],
    ids=["known well", "another look is less likely", "not known well enough"],
)
def test_a_pose_ends_the_search_if_another_look_could_hardly_better_it(heading_sd, found, n_looks, monkeypatch):
    first, second = shifted(0.0), shifted(3.0, log_evidence=100.0 if heading_sd < 0.2 else 300.0)
    looks = iter([OneLook(first, heading_sd), OneLook(second, 0.01)])
    bases = SimpleNamespace(
        load=lambda _: None, name_of=lambda _: None, length_of=lambda _: 0.6, length=0.6, volume=1.0
    )
    for name, stub in (
        ("map_base", lambda *given: given[:2]),
        ("prepare_index", lambda base: base),
        ("OneBase", lambda _: bases),
        ("strategies", lambda *_: looks),
    ):
        monkeypatch.setattr(steps, name, stub)
    answer = register_once(None, None, None, RegistrationConfig(), 0, Clock())[2]
    assert answer.is_accepted
    assert answer.T_base_target.translation[0] == 1.0 + found
    assert len(list(looks)) == 2 - n_looks


def test_a_probable_pose_is_settled_and_stated_so():
    strategy, best = HandMadeStrategy(), shifted(0.2)
    result = decided([best, shifted(9.0, log_evidence=20.0)], strategy=strategy)
    assert [(what, pose) for what, pose in strategy.asked] == [("settle", best)]
    assert (result.status, result.alternatives) == (Status.ACCEPTED, ())
    np.testing.assert_allclose(result.T_base_target.translation, [1.2, 0.0, 0.01], atol=1e-12)
    np.testing.assert_allclose(result.covariance, 1e-4 * np.eye(6), atol=1e-12)
    assert (result.residual, result.n_inliers) == (0.9, 4)
    assert (result.n_keypoints, result.n_correspondences) == (7, 5)


def test_what_settling_finds_out_decides_whether_the_pose_is_known_well_enough():
    result = decided([shifted(0.0)], strategy=HandMadeStrategy(settled_covariance=np.eye(6)))
    assert result.status is Status.DEGENERATE
    assert (result.T_base_target, result.covariance) == (None, None)
    np.testing.assert_allclose(result.alternatives[0].T_base_target.translation, [1.0, 0.0, 0.01], atol=1e-12)
    assert len(result.degenerate_directions) == 6


def test_what_a_target_bends_by_widens_the_answer_and_is_named_if_it_is_sure():
    xi = np.array([0.0, 0.0, 0.03, 0.02, 0.0, 0.0])
    sure, chance = (Bend(xi, np.zeros(3), spread**2 * np.eye(6), 0.6) for spread in (1e-3, 1e-1))
    answer = decided([shifted(0.0)], strategy=HandMadeStrategy(bent=sure))
    assert answer.is_accepted
    assert "drift" in answer.reason
    np.testing.assert_allclose(answer.covariance[2, 2], 1e-4 + sure.share * (0.6 * 0.03) ** 2, rtol=1e-9)
    # By chance halves differ a little: this widens the answer as far as it is probable that the target bends.
    unbent = decided([shifted(0.0)], strategy=HandMadeStrategy(bent=chance))
    assert "drift" not in unbent.reason
    more = chance.probability * chance.share * (0.6 * 0.03) ** 2
    np.testing.assert_allclose(unbent.covariance[2, 2], 1e-4 + more, rtol=1e-9)
    # Evidence for the place is the rigid pose's: halves of a wrong pose differ, too.
    assert answer.probability == unbent.probability == pytest.approx(decided([shifted(0.0)]).probability, abs=1e-15)
    far = decided([shifted(0.0)], strategy=HandMadeStrategy(bent=replace(sure, xi=20 * xi)))
    assert far.status is Status.DEGENERATE
    assert "drift" in far.reason


def test_halves_are_refined_where_there_is_evidence_for_the_place_alone():
    strategy, there = HandMadeStrategy(), shifted(0.0, log_evidence=0.1)
    decided([there], strategy=strategy)
    assert strategy.asked_to_bend == [there]
    result = decided([shifted(0.0, log_evidence=-3.0)], strategy=strategy)
    assert strategy.asked_to_bend == [there]
    assert result.alternatives[0].log_odds == -3.0


def test_a_doubtful_pose_is_stated_as_it_was_weighed():
    strategy = HandMadeStrategy()
    best, rival = shifted(0.0, log_evidence=100.0), shifted(5.0, log_evidence=99.0)
    result = decided([best, rival], log_odds(95.0, 1.0, "map"), strategy)
    assert [what for what, _ in strategy.asked] == ["state"]
    assert result.status is Status.AMBIGUOUS
    shown = [a.T_base_target.translation[0] for a in result.alternatives]
    np.testing.assert_allclose(shown, [1.0, 6.0])
    assert [a.log_odds for a in result.alternatives] == [100.0, 99.0]
    first, second = (a.probability for a in result.alternatives)
    assert (result.probability, result.T_base_target, result.covariance) == (first, None, None)
    said = result.evidence
    assert said["lead"] == pytest.approx(np.log(first / second))
    # Of other poses and other maps together.
    assert said["probability_elsewhere"] > second
    assert first + said["probability_elsewhere"] + said["probability_unrelated"] == pytest.approx(1)


def test_the_most_probable_is_decided_on_wherever_it_stands():
    """A ranking by evidence, of which the first has residuals that nothing explains."""
    strained, plain = shifted(0.0, log_evidence=210.0, misfit=12.0), shifted(5.0)
    result = decided([strained, plain])
    np.testing.assert_allclose(result.T_base_target.translation, [6.0, 0.0, 0.01], atol=1e-12)


def test_near_poses_are_one_answer_within_three_of_the_largest_spreads_asked_for():
    near = [shifted(0.0), shifted(0.5, log_evidence=199.0)]
    assert decided(near).is_accepted  # 3 x 0.3 x 0.6 m
    assert decided(near, config=DecisionConfig(max_sd_translation=0.1)).status is Status.AMBIGUOUS


def test_that_a_coarser_pose_would_do_makes_no_two_places_one():
    coarse = DecisionConfig(max_sd_translation=5.0, max_sd_rotation=1.0)
    turned = WeighedPose(RigidTransform.from_rotation(Rotation.from_rotvec([0, 0, 0.3])), log_evidence=199.0)
    for other in (shifted(1.0, log_evidence=199.0), turned):
        assert decided([shifted(0.0), other], config=coarse).status is Status.AMBIGUOUS


def test_a_pose_elsewhere_takes_its_share_and_prior_odds_theirs():
    best = shifted(0.0, log_evidence=100.0)
    there = decided([best], elsewhere=log_odds(100.0, 1.0, "map"))
    assert there.status is Status.AMBIGUOUS
    assert there.probability == pytest.approx(0.5, abs=1e-4)
    sceptical = decided([best], config=DecisionConfig(prior_odds=1e-11))
    odds = 1e-11 * np.exp(log_odds(100.0, 1.0, "map"))
    assert not sceptical.is_accepted
    assert sceptical.probability == pytest.approx(odds / (1 + odds))


def test_without_a_pose_nothing_is_settled_and_the_answer_is_a_result():
    for ranked in ([], [WeighedPose(log_evidence=-np.inf, misfit=np.inf, covariance=None)]):
        strategy = HandMadeStrategy()
        result = decided(ranked, strategy=strategy)
        assert (result.status, result.T_base_target, strategy.asked) == (Status.UNINFORMATIVE, None, [])


def test_a_duplicated_sample_adds_next_to_nothing():
    """Every sample twice, of either side or of both: not twice the evidence, but an eighth more at most:
    what is read twice is known better, and nobody can tell copies from readings.

    The map's numbers are given, for learned ones believe in less noise where samples agree to the bit.
    """
    made = simulate("office-random", 3, SimulationConfig(n_samples=300, room_size=(2.0, 2.0, 0.8)))
    config = RegistrationConfig(field=NUMBERS, calibrate=False)

    def times(n, survey):
        rows = np.repeat(np.arange(len(survey)), n)
        return Survey(survey.positions[rows], survey.field[rows])

    bases = [prepare_index(build_map(times(n, made.base), config.field)) for n in (1, 2)]
    targets = [build_map(times(n, made.target), config.field) for n in (1, 2)]
    once, target_twice, base_twice, both_twice = (register(b, t, config) for b in bases for t in targets)
    for result in (target_twice, base_twice, both_twice):
        assert result.is_accepted
        assert result.evidence["log_odds"] < 1.15 * once.evidence["log_odds"]
        assert result.evidence["effective"] < 1.15 * once.evidence["effective"]
        distance = np.linalg.norm(result.T_base_target.translation - once.T_base_target.translation)
        assert distance < 0.02


def test_a_refusal_for_accuracy_alone_states_the_pose_and_how_well_it_is_known():
    result = decided(
        [shifted(0.0)], strategy=HandMadeStrategy(settled_covariance=np.diag([0.2**2] * 3 + [0.9**2] * 3))
    )
    assert result.status is Status.DEGENERATE
    assert result.alternatives[0].sd == pytest.approx((0.2, 0.9))
    unknown = decided([replace(shifted(0.0), covariance=None, log_evidence=1.0)])
    assert unknown.alternatives[0].sd is None


def test_a_path_that_jumps_is_not_taken_for_a_rigid_one_beside_moved_iron():
    """The pose of one half, with the other 'changed', was stated as if all of the path lay there."""
    pair = simulate("office-robot", 2, SimulationConfig(n_samples=900))
    shift = np.repeat([[0.0, 0, 0], [0.3, 0, 0]], 450, axis=0)
    target = replace(pair.target, positions=pair.target.positions + shift - shift.mean(axis=0))
    result = register(pair.base, target)
    middle = target.centroid
    assert result.is_accepted
    assert np.linalg.norm(result.T_base_target.apply(middle) - pair.T_base_target.apply(middle)) < 0.1


class Three:
    """Three bases, by name."""

    def name_of(self, one):
        return one


def test_answers_in_all_other_bases_count_against_the_best():
    evidence = {"a": [30.0], "b": [29.0, 29.0], "c": [28.0]}
    found = {
        name: Weighed(HandMadeStrategy(), PAIR, FOUND, [shifted(9.0 * k, log_evidence=e) for k, e in enumerate(some)])
        for name, some in evidence.items()
    }
    best, result = decide_among(Three(), found, DecisionConfig(), Clock())
    odds = [answer.log_odds for one in found.values() for answer in one.answers(DecisionConfig())]
    assert best == "a"
    assert result.probability == pytest.approx(np.exp(odds[0] - np.logaddexp.reduce([*odds, 0.0])))
