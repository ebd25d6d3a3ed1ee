# SPDX-License-Identifier: BSD-3-Clause
"""Settings of dead reckoning."""

from pydantic import Field

from magmatch.settings import Settings


class DeadReckoningConfig(Settings):
    """Settings of `magmatch.phones.dead_reckon`."""

    # Ratio of the walker's step length to the average: true length of a path over the one found.
    step_scale: float = Field(default=1.0, ge=0.3, le=3)
