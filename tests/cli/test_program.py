# SPDX-License-Identifier: BSD-3-Clause
"""The program as a whole: help, start-up, exit codes, where words and data go."""

import os
import subprocess
import sys

import pytest

from magmatch.cli import boundary

COMMANDS = (
    "register", "transform", "slam", "merge", "localize", "odometry", "prepare", "map", "query", "info",
    "view", "convert", "simulate", "datasets", "demo", "glossary",
)  # fmt: skip


@pytest.mark.parametrize("name", COMMANDS)
def test_help_of_a_command_has_examples(name, run):
    outcome = run(name, "--help")
    assert outcome.code == 0
    assert "Examples:" in outcome.out
    assert f"  magmatch {name} " in outcome.out or f"  magmatch {name}\n" in outcome.out


def test_a_placeholder_in_the_help_keeps_its_capitals(run):
    shown = run("map", "--help").out
    assert "LATITUDE,LONGITUDE" in shown
    assert "lATITUDE" not in shown


@pytest.mark.parametrize(("typed", "near"), [("--bogus", None), ("--reprot", "--report"), ("--max-std", "--max-sd")])
def test_only_options_that_are_near_are_proposed_for_one_that_is_not_there(typed, near, refused):
    said = refused(["register", "a.csv", "b.csv", typed], f"No such option: {typed}")
    assert ("Possible options" in said) == (near is not None)
    assert near is None or near in said


def test_help_names_every_command_and_exit_code_and_no_command_shows_it(run):
    outcome = run("--help")
    assert outcome.code == 0
    for name in COMMANDS:
        assert f"\n  {name} " in outcome.out
    for code in "0123":
        assert f"\n    {code}  " in outcome.out
    assert run() == outcome


def test_neither_help_nor_the_package_waits_for_numerics():
    code = (
        "import sys, magmatch; from magmatch.cli.main import main\n"
        "for words in (['--help'], ['register', '--help'], ['map', '--help']): main(words)\n"
        "print(sorted({'numpy', 'scipy', 'numba', 'plotly', 'rich'} & set(sys.modules)), file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr.strip() == "[]"


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (KeyboardInterrupt(), 130),
        (ZeroDivisionError("a bug"), 1),
        (MemoryError(), 1),
        (OSError(28, "No space left on device"), 1),
        (OSError(5, "Input/output error", "out.json"), 1),
        (PermissionError(13, "Permission denied", "in.csv"), 2),
        (OSError(30, "Read-only file system", "out.json"), 2),
        (FileNotFoundError(2, "No such file or directory", "in.csv"), 2),
        (ValueError("two\nlines\x1b[31m"), 1),
    ],
)
def test_every_error_is_one_line_and_its_code(error, code, run, monkeypatch, tmp_path):
    def fail(*_args):
        raise error

    monkeypatch.setattr("magmatch.cli.commands.simulate.check_folder", fail)
    outcome = run("simulate", "uniform", "--out", tmp_path / "x")
    assert outcome.code == code
    assert outcome.err.count("\n") == 1
    assert "Traceback" not in outcome.err
    assert "\x1b" not in outcome.err


@pytest.mark.parametrize("place_of_flag", ["before", "after"])
def test_debug_shows_the_traceback(place_of_flag, run, tmp_path):
    words = ["info", tmp_path / "none.csv"]
    outcome = run("--debug", *words) if place_of_flag == "before" else run(*words, "--debug")
    assert outcome.code == 2
    assert "Traceback" in outcome.err
    assert outcome.err.splitlines()[-1].startswith("magmatch: ")


def program(*words, stdout=subprocess.PIPE):
    """The program in a process of its own."""
    done = [sys.executable, "-m", "magmatch", *words]
    return subprocess.run(done, stdout=stdout, stderr=subprocess.PIPE, text=True, check=False)


def test_a_reader_that_leaves_is_no_error():
    read_end, write_end = os.pipe()
    os.close(read_end)
    done = program("datasets", stdout=write_end)
    os.close(write_end)
    assert (done.returncode, done.stderr) == (boundary.READER_LEFT, "")


def test_progress_comes_and_goes_on_a_terminal(place, run, tmp_path, monkeypatch):
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    monkeypatch.setenv("FORCE_COLOR", "1")
    outcome = run("map", place / "base.csv", "--prior", "spline", "--out", tmp_path / "m.map")
    assert outcome.code == 0
    # Whichever step is under way when the line is drawn anew.
    assert "choosing hyperparameters" in outcome.err or "fitting the field" in outcome.err
    assert "\x1b[2K" in outcome.err  # the line is wiped again
    assert outcome.out == ""
