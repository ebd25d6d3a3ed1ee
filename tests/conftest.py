# SPDX-License-Identifier: BSD-3-Clause
"""How many inputs the fuzz tests try."""

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--fuzz", type=int, default=120, metavar="N", help="inputs per reader of tests/data/logs/test_fuzz.py"
    )


@pytest.fixture
def n_fuzz(request: pytest.FixtureRequest) -> int:
    return int(request.config.getoption("--fuzz"))
