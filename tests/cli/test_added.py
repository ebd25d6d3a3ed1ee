# SPDX-License-Identifier: BSD-3-Clause
"""Other distributions add commands by entry points; what is missing says how it is installed."""

import tomllib
from pathlib import Path

import pytest

from magmatch.cli.added import ELSEWHERE, GROUP

ROOT = Path(__file__).parents[2]
TOY = """
from magmatch.cli.command import command
from magmatch.cli.narration import put

@command("greet", ("magmatch greet Ada",))
def greet(name: str) -> None:
    "Greet somebody."
    put(f"hello {name}")
"""


@pytest.fixture
def installed(tmp_path, monkeypatch):
    """Install a distribution that adds commands, as far as the program can tell; gives its folder."""

    def install(**commands):
        about = tmp_path / "toy-1.0.dist-info"
        about.mkdir()
        (about / "METADATA").write_text("Metadata-Version: 2.1\nName: toy\nVersion: 1.0\n")
        points = "".join(f"{name} = {where}\n" for name, where in commands.items())
        (about / "entry_points.txt").write_text(f"[{GROUP}]\n{points}")
        (tmp_path / "toy_commands.py").write_text(TOY)
        monkeypatch.syspath_prepend(tmp_path)

    return install


def test_a_command_of_another_distribution_is_one_of_the_program(installed, run):
    installed(greet="toy_commands:greet")
    assert run("greet", "Ada").out == "hello Ada\n"
    assert "\n  greet " in run("--help").out
    assert "magmatch greet Ada" in run("greet", "--help").out
    assert run("greet").code == 2  # usage is explained as for any other


@pytest.mark.parametrize(
    "where", ["toy_commands:gone", "no_such_module:greet", "toy_commands:TOO.deep", "json:loads"]
)
def test_a_distribution_that_does_not_load_breaks_its_own_command_only(where, installed, run, refused):
    installed(greet=where)
    refused(["greet", "Ada", "--loudly"], "'greet' comes from a package that cannot be loaded (")
    assert run("--version").code == run("--help").code == 0


@pytest.mark.parametrize("name", ELSEWHERE)
def test_a_command_that_is_not_installed_says_how_to_install_it(name, run, refused, monkeypatch):
    monkeypatch.setattr("magmatch.cli.added.entry_points", lambda **_: ())
    for words in ([], ["hall.map", "--port", "0"], ["--quick"]):
        refused([name, *words], f"is not installed: pip install {ELSEWHERE[name]} (in a checkout of magmatch)\n")
    assert f"\n  {name} " in run("--help").out
    assert ELSEWHERE[name] in run(name, "--help").out


def test_what_is_said_to_install_adds_that_command():
    for folder in set(ELSEWHERE.values()):
        project = tomllib.loads((ROOT / folder / "pyproject.toml").read_text())["project"]
        assert set(project["entry-points"][GROUP]) == {name for name in ELSEWHERE if ELSEWHERE[name] == folder}


def test_the_core_needs_nothing_of_the_service():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    needed = str([project["dependencies"], project["optional-dependencies"]])
    assert not [name for name in ("starlette", "uvicorn", "websockets", "prometheus", "foxglove") if name in needed]
