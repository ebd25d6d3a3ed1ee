# SPDX-License-Identifier: BSD-3-Clause
"""Stands for other processes, as a runner sees them."""

import pickle


def elsewhere(function, tasks):
    """Run a function on tasks; neither what is sent nor what comes back shares anything with this process."""
    return [_copied(_copied(function)(_copied(task))) for task in tasks]


def _copied(one):
    return pickle.loads(pickle.dumps(one))
