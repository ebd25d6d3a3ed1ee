# SPDX-License-Identifier: BSD-3-Clause
"""How many inputs the fuzz tests try, how often writers are killed and files corrupted."""

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--fuzz", type=int, default=120, metavar="N", help="inputs per reader of tests/data/logs/test_fuzz.py"
    )
    parser.addoption("--kills", type=int, default=20, metavar="N", help="kills in tests/hardening/test_kills.py")
    parser.addoption("--corruptions", type=int, default=200, metavar="N", help="of each file in tests/hardening")


@pytest.fixture
def n_fuzz(request: pytest.FixtureRequest) -> int:
    return int(request.config.getoption("--fuzz"))
