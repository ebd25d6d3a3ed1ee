# SPDX-License-Identifier: BSD-3-Clause
"""From a raw log to a survey: clocks, hard and soft iron, checks; every step reports what it did."""
