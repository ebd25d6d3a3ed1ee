# SPDX-License-Identifier: BSD-3-Clause
"""The command line: one file per subcommand in ``commands``, and what they share."""

from time import perf_counter

# When the program began, before all that is imported: users wait from here on.
STARTED = perf_counter()
