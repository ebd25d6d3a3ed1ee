# SPDX-License-Identifier: BSD-3-Clause
"""The verdict on a log in a map: good news only where it ended localized, and how much of it has a pose."""

import pytest

from magmatch.localization.result import LocalizationResult, LocalizationStatus
from magmatch.viz.pages.track_page import verdict_on


@pytest.mark.parametrize(
    ("status", "headline", "kind"),
    [
        (LocalizationStatus.LOCALIZED, "Localized; a pose for 83% of the time", "good"),
        (LocalizationStatus.LOST, "Lost at the end; a pose for 83% of the time", "refused"),
        (LocalizationStatus.NEVER, "Never", "refused"),
    ],
)
def test_only_a_log_that_ended_localized_is_good_news(status, headline, kind):
    said = verdict_on(LocalizationResult(status, "so it is", share=0.83))
    assert f'class="verdict {kind}"' in said
    assert f"{headline}</strong>" in said
    assert "so it is" in said
