# SPDX-License-Identifier: BSD-3-Clause
"""The same examples in each run, as in the tests of the package."""

from hypothesis import settings

settings.register_profile("same", derandomize=True, deadline=None)
settings.load_profile("same")
