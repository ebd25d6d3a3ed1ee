# SPDX-License-Identifier: BSD-3-Clause
"""Errors: what is raised in another process is told here in the same words."""

import pickle

import pytest

from magmatch.errors import DataFormatError, MissingExtraError, TaskError


@pytest.mark.parametrize(
    "error",
    [
        DataFormatError("log.csv", "no times", line=3, column="t"),
        MissingExtraError("a bag", "bags"),
        TaskError("gone"),
    ],
)
def test_an_error_comes_whole_out_of_another_process(error):
    found = pickle.loads(pickle.dumps(error))
    assert (type(found), str(found), vars(found)) == (type(error), str(error), vars(error))
