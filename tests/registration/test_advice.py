# SPDX-License-Identifier: BSD-3-Clause
"""Each remedy where it helps, and none where the answer needs none."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch.data.survey import Survey
from magmatch.estimation.pose_prior import PosePriorConfig
from magmatch.registration.advice import diagnosis, of_odometry, remedy, with_advice
from magmatch.registration.result import Alternative, RegistrationResult, Status

EARTH = np.array([18e-6, 3e-6, -45e-6])
ANY_POSE, UPRIGHT = PosePriorConfig(), PosePriorConfig(is_gravity_aligned=True)


def survey(height=2.0, wild=5e-6, n=200, seed=0):
    """Of a box so high, 4 m by 3 m."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(-0.5, 0.5, (n, 3)) * [4.0, 3.0, height]
    return Survey(x, EARTH + wild * rng.standard_normal((n, 3)))


def turning(one):
    """The same, read in the axes of a sensor that turns."""
    turns = Rotation.random(len(one), random_state=np.random.default_rng(1))
    return replace(one, field=turns.apply(one.field))


ROOM, FLAT = survey(), survey(height=0.02)


def asked(base, target, prior=ANY_POSE):
    """The remedy for two surveys."""
    return remedy({"base": base, "target": target}, prior)


@pytest.mark.parametrize("side", ["base", "target"])
def test_vectors_that_point_every_way_ask_for_the_sensors_axes_of_the_side_they_are_of(side):
    said = diagnosis({"base": FLAT, "target": FLAT} | {side: turning(FLAT)})
    assert f"--{side}-field-frame sensor" in said
    assert said.startswith(f"{side}: the field vectors point every way")


def test_what_is_wrong_with_both_is_said_once():
    said = diagnosis({"base": turning(ROOM), "target": turning(ROOM)})
    assert said.startswith("both surveys: ")
    assert said.count("--field-frame sensor") == 1


def test_a_field_that_is_the_same_everywhere_is_said_first():
    answer = RegistrationResult(Status.INCONSISTENT, "probably different places", None)
    said = with_advice(answer, {"base": ROOM, "target": survey(wild=0.0)}, ANY_POSE).reason
    assert said.startswith("target: the field is constant (varies less than 1 nT): nothing tells places apart; prob")


def test_heights_that_differ_are_told_where_they_were_stated_to_agree():
    answer, up = RegistrationResult(Status.UNINFORMATIVE, "no pose to judge", None), np.array([0.0, 0.0, 3.0])
    planar, level = PosePriorConfig(is_planar=True), {"base": FLAT, "target": FLAT}
    apart = level | {"target": replace(FLAT, positions=FLAT.positions + up)}
    said = with_advice(answer, apart, planar).reason
    assert said.startswith(
        "the surveys' heights differ by 3 m, and --planar has them agree: use --gravity-aligned; no"
    )
    assert with_advice(answer, apart, UPRIGHT).reason == with_advice(answer, level, planar).reason == answer.reason


def test_two_flat_surveys_ask_whether_z_is_up_where_that_is_not_said():
    assert "--gravity-aligned" in asked(FLAT, FLAT)
    assert "both surveys are flat" in asked(FLAT, FLAT)
    for base, target, prior in ((FLAT, FLAT, UPRIGHT), (ROOM, FLAT, ANY_POSE), (FLAT, ROOM, ANY_POSE)):
        assert "flat" not in asked(base, target, prior)
    assert "flat" not in remedy({"target": FLAT}, ANY_POSE)


def test_gravity_is_not_asked_for_where_z_is_evidently_not_up():
    lying = replace(ROOM, field=ROOM.field[:, [0, 2, 1]])
    assert "--gravity-aligned" in asked(ROOM, ROOM)
    assert "--gravity-aligned" not in asked(ROOM, lying)


def test_else_more_survey_or_a_better_known_pose_helps():
    said = asked(ROOM, ROOM)
    assert "survey more" in said
    # What a disturbed place does to vectors is no turning sensor.
    assert diagnosis({"base": survey(wild=15e-6), "target": ROOM}) == ""


@pytest.mark.parametrize(("rival", "is_named"), [("b.map", True), (None, False)])
def test_two_maps_that_hold_the_target_are_both_named(rival, is_named):
    T = RigidTransform.identity()
    poses = (Alternative(T, 0.5), Alternative(T, 0.45, base=rival), Alternative(T, 0.01, base="c.map"))
    answer = RegistrationResult(Status.AMBIGUOUS, "two poses fit", None, base="a.map", alternatives=poses)
    said = with_advice(answer, {"base": ROOM, "target": ROOM}, ANY_POSE).reason
    assert said.startswith("two poses fit")
    assert ("in a.map and in b.map" in said) == is_named
    assert "c.map" not in said


def test_an_inconsistent_answer_gets_one_clause_more_and_three_sentences_at_most():
    reason = "probably different places: the best pose has probability 0.2 (3 nats of evidence, 18 are needed)"
    answer = RegistrationResult(Status.INCONSISTENT, reason, None, probability=0.2)
    for base, prior in ((ROOM, ANY_POSE), (FLAT, ANY_POSE), (turning(ROOM), ANY_POSE), (FLAT, UPRIGHT)):
        surveys = {"base": base, "target": base}
        advised = with_advice(answer, surveys, prior)
        wrong = diagnosis(surveys)
        assert advised.reason == (f"{wrong}; {reason}" if wrong else f"{reason}; {remedy(surveys, prior)}")
        assert len([s for s in re.split(r"[.;!?](?:\s|$)", advised.reason) if s]) <= 3
        assert (advised.status, advised.probability) == (answer.status, answer.probability)


def test_any_refusal_begins_with_what_is_wrong_with_a_survey_and_an_accepted_answer_is_left_as_it_is():
    answer = RegistrationResult(Status.NO_OVERLAP, "so it is", None)
    said = with_advice(answer, {"base": turning(ROOM), "target": ROOM}, ANY_POSE).reason
    assert said.startswith("base: the field vectors point every way")
    assert said.endswith("; so it is")
    assert with_advice(answer, {"base": ROOM, "target": ROOM}, ANY_POSE) is answer
    accepted = RegistrationResult(Status.ACCEPTED, "so it is", None)
    assert with_advice(accepted, {"base": turning(ROOM), "target": FLAT}, ANY_POSE) is accepted


def test_where_z_is_said_to_be_up_in_both_a_refusal_begins_with_fields_that_contradict_it():
    tipped = replace(ROOM, field=ROOM.field @ Rotation.from_euler("x", 90, degrees=True).as_matrix())
    surveys, refused = {"base": ROOM, "target": tipped}, RegistrationResult(Status.INCONSISTENT, "no", None)
    assert with_advice(refused, surveys, UPRIGHT).reason.startswith("the field dips")
    assert with_advice(refused, surveys, ANY_POSE).reason.startswith("no")
    assert with_advice(refused, {"base": ROOM, "target": ROOM}, UPRIGHT).reason.startswith("no")


def test_where_positions_follow_a_path_odometry_is_asked_about_once_and_whose():
    rows = np.linspace(0, 4 * np.pi, 300)
    path = Survey(np.column_stack([rows, np.sin(rows), 0 * rows]), EARTH + 1e-6 * np.sin(rows)[:, None])
    assert of_odometry({"base": ROOM, "target": ROOM}) == []
    assert "the base are" in of_odometry({"base": path, "target": ROOM})[0]
    assert "the target are" in of_odometry({"base": ROOM, "target": path})[0]
    (both,) = of_odometry({"base": path, "target": path})
    assert "both surveys" in both
    assert "magmatch slam" in both
    reason = "the best pose has probability 0.6, other poses 0.4 together; survey more of the surroundings"
    # A walk that drifts leaves the base, too.
    told = {Status.AMBIGUOUS: True, Status.INCONSISTENT: True, Status.NO_OVERLAP: True, Status.UNINFORMATIVE: False}
    for status, is_told in told.items():
        advised = with_advice(
            RegistrationResult(status, reason, None), {"base": path, "target": path}, UPRIGHT
        ).reason
        assert (both in advised) is is_told
        assert len([s for s in re.split(r"[.;!?](?:\s|$)", advised) if s]) <= 4
        assert ("survey more of it" in advised) is (status is Status.INCONSISTENT)
