# SPDX-License-Identifier: BSD-3-Clause
"""What the program says of a result."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from magmatch.cli.registering import tell_result
from magmatch.cli.sessions import tell
from magmatch.registration.result import RegistrationResult, Status
from magmatch.slam.result import AnchorResult, LogResult, SlamResult, SlamStatus


@pytest.mark.parametrize(
    ("probability", "words"),
    [(1e-7, "below 0.001"), (0.0314, "0.031"), (0.99951, "above 0.999"), (0.0, "below 0.001"), (1.0, "above 0.999")],
)
def test_a_probability_is_never_rounded_to_certainty(probability, words):
    result = RegistrationResult(
        status=Status.INCONSISTENT, reason="nothing fits", T_base_target=None, probability=probability
    )
    assert f"probability {words}," in tell_result(result)


@pytest.mark.parametrize(
    ("turn_deg", "shift_mm", "words"),
    [(0.0782, 2.01, "0.078 deg, 2.0 mm"), (0.996, 9.96, "1.0 deg, 10 mm"), (12.3, 1234, "12 deg, 1234 mm")],
)
def test_terminal_and_report_say_the_same_standard_deviations(tmp_path, turn_deg, shift_mm, words):
    pytest.importorskip("plotly", reason="the report is drawn with the extra 'viz'")
    from magmatch.viz.pages.registration_page import write_report

    sd = np.repeat([np.deg2rad(turn_deg), shift_mm / 1e3], 3) / np.sqrt(3)
    result = RegistrationResult(Status.ACCEPTED, "fits", RigidTransform.identity(), covariance=np.diag(sd**2))
    write_report(tmp_path / "report.html", None, None, result)
    for said in (tell_result(result), (tmp_path / "report.html").read_text()):
        assert f"; sd {words} where the data constrain it best" in said


def passed(*off_and_sd_without):
    """What is said of fixed points that a log of 40 m passes 1 cm off, by what is known of each without it."""
    log = LogResult("walk", 0, None, 40.0, 3, 0.5, (0.1, 0.05))
    points = [
        AnchorResult("walk", 1.0, [0.0, 0.0, 0.0], 0.02, [0.01, 0.0, 0.0], [off, 0.0, 0.0], sd)
        for off, sd in off_and_sd_without
    ]
    result = SlamResult(SlamStatus.CONNECTED, "corrected", (log,), anchors=tuple(points))
    return tell(result).splitlines()[-1]


def test_the_error_at_fixed_points_is_said_where_others_tell_the_place():
    said = passed((0.3, 0.1), (0.4, 0.1))
    assert "passed 0.01 m off (rms)" in said
    assert "0.35 m (rms) where each is left out" in said
    # Nothing else tells where the log passes the third.
    assert passed((0.3, 0.1), (0.4, 0.1), (0.0, 3e4)).endswith("0.35 m (rms) where each of 2 is left out")


def test_the_error_at_fixed_points_that_alone_tell_the_frame_is_said_to_be_no_test():
    said = passed((0.17, 130.0), (0.05, 3e4))
    assert "0.01 m" not in said
    assert "left out" not in said
    assert "too few" in said


def test_an_end_whose_heading_nothing_holds_is_said_to_be_unknown():
    log = LogResult("walk", 0, None, 40.0, 0, 0.5, (6.3e3, 370.0))
    said = tell(SlamResult(SlamStatus.CONNECTED, "corrected", (log,)))
    assert said.endswith("not known: nothing holds its heading")
