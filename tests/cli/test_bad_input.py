# SPDX-License-Identifier: BSD-3-Clause
"""Whatever is wrong with what was given: exit code 2, one line that names the place, nothing left behind."""

import errno
import json
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

HEADER = "x,y,z,bx,by,bz"


def good_rows(n: int = 20) -> list[str]:
    rng = np.random.default_rng(5)
    p, b = rng.uniform(0, 2, (n, 3)), rng.normal([2e-5, 0, -4e-5], 5e-6, (n, 3))
    return [",".join(repr(float(v)) for v in row) for row in np.hstack([p, b])]


def with_row(row: str, n: int = 20) -> str:
    return "\n".join([HEADER, *good_rows(n), row, *good_rows(3)]) + "\n"


def with_columns(header: str, row: str) -> str:
    return "\n".join([header, *[row] * 20]) + "\n"


EMPTY_RESULT = '{"schema": "magmatch.registration/1"}'

SURVEYS: dict[str, tuple[str | bytes, str]] = {
    "text in a number": (with_row("1,2,3,abc,0,4e-5"), "line 22, column 'bx'"),
    "empty file": ("", "empty"),
    "microtesla": (with_columns(HEADER, "0,0,0,20,0,40"), "--field-unit uT"),
    "wider than any place": ("\n".join([HEADER, *(f"{i}e8,0,0,2e-5,0,4e-5" for i in range(20))]), "--length-unit"),
}


@pytest.fixture
def out(tmp_path):
    folder = tmp_path / "out"
    folder.mkdir()
    return folder


@pytest.fixture
def good(tmp_path):
    path = tmp_path / "good.csv"
    path.write_text("\n".join([HEADER, *good_rows()]) + "\n")
    return path


@pytest.mark.parametrize("case", SURVEYS)
def test_a_bad_survey_is_refused_before_any_work(case, good, out, refused, tmp_path):
    content, words = SURVEYS[case]
    bad = tmp_path / "bad.csv"
    bad.write_bytes(content if isinstance(content, bytes) else content.encode())
    assert "bad.csv" in refused(["register", good, bad, "--out", out / "r.json"], words, out)


def looping(path: Path) -> None:
    path.symlink_to(path)


NO_FILES: dict[str, Callable[[Path], None]] = {"link to itself": looping,
                                               "pipe": os.mkfifo, "folder": Path.mkdir}  # fmt: skip
TAKES_A_FILE: dict[str, Callable[[Path, Path, Path], list[object]]] = {
    "info": lambda g, b, o: ["info", b],
    "base": lambda g, b, o: ["register", b, g, "--out", o / "r.json"],
    "target": lambda g, b, o: ["register", g, b],
    "map": lambda g, b, o: ["map", g, b, "--out", o / "m.map"],
    "query map": lambda g, b, o: ["query", b, g, "--out", o / "p.csv"],
    "transform by": lambda g, b, o: ["transform", g, "--by", b, "--out", o / "a.csv"],
    "config": lambda g, b, o: ["register", g, g, "--config", b],
    "prepare": lambda g, b, o: ["prepare", b, "--out", o / "s.csv"],
    "sensor": lambda g, b, o: ["prepare", g, "--sensor-from", b, "--out", o / "s.csv"],
    "odometry": lambda g, b, o: ["odometry", b, "--out", o / "o.tum"],
    "view": lambda g, b, o: ["view", b, "--out", o / "v.html"],
    "convert": lambda g, b, o: ["convert", b, o / "s.parquet"],
}


@pytest.mark.parametrize("door", TAKES_A_FILE)
@pytest.mark.parametrize("kind", NO_FILES)
def test_what_is_no_file_is_refused_at_every_door_whatever_its_name(
    kind, door, good, out, refused, tmp_path, monkeypatch
):
    monkeypatch.setattr("magmatch.data.tables.pipes.WAIT", 0.01)  # s, for somebody to write to the pipe
    bad = tmp_path / "bad.csv"
    NO_FILES[kind](bad)
    refused([*TAKES_A_FILE[door](good, bad, out)], "bad.csv", out)


@pytest.mark.parametrize("kind", ["link to itself", "folder"])
def test_no_result_is_written_where_no_file_can_be(kind, good, out, refused, tmp_path):
    bad = tmp_path / "bad.csv"
    NO_FILES[kind](bad)
    refused(["convert", good, bad], "bad.csv", out)


Arguments = Callable[[Path, Path, Path], list[object]]  # good survey, a folder for inputs, a folder for outputs


def written(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.write_text(text)
    return path


USAGE: dict[str, tuple[Arguments, str]] = {
    "term nearly spelt": (lambda g, t, o: ["glossary", "nats"], "did you mean 'nat'?"),
    "JSON without a schema": (lambda g, t, o: ["info", written(t, "truth.json", "{}")], "without a schema"),
    "unknown command": (lambda g, t, o: ["registr"], "registr"),
    "missing argument": (lambda g, t, o: ["register", g], "TARGET"),
    "missing option": (lambda g, t, o: ["map", g], "--out"),
    "negative seed": (lambda g, t, o: ["register", g, g, "--seed", "-1"], "--seed"),
    "unknown unit of one survey": (lambda g, t, o: ["register", g, g, "--base-field-unit", "g"], "--base-field-unit"),
    "negative accuracy": (lambda g, t, o: ["info", g, "--pose-sd", "-1"], "--pose-sd"),
    "stated column that is not there": (lambda g, t, o: ["info", g, "--columns", "bx=mag_x"], "'mag_x' for bx"),
    "picture of a page": (lambda g, t, o: ["view", g, "--out", o / "v.png"], ".html"),
    "unknown preset": (lambda g, t, o: ["register", g, g, "--preset", "best"], "--preset"),
    "unknown sensor": (lambda g, t, o: ["register", g, g, "--sensor", "gyro"], "--sensor"),
    "sensor without refinement": (
        lambda g, t, o: ["register", g, g, "--preset", "paper", "--sensor", "full"],
        "--sensor",
    ),
    "unknown prior": (lambda g, t, o: ["map", g, "--prior", "cubic", "--out", o / "m"], "--prior"),
    "domain without height": (lambda g, t, o: ["map", g, "--domain", "0,0,0,1,1,0", "--out", o / "m"], "--domain"),
    "unknown scenario": (lambda g, t, o: ["simulate", "moon", "--out", o / "s"], "moon"),
    "unknown dataset": (lambda g, t, o: ["datasets", "fetch", "moon"], "moon"),
    "dataset from an empty folder": (lambda g, t, o: ["datasets", "fetch", "cea", "--from", o], "cea"),
    "missing survey": (lambda g, t, o: ["register", g, t / "none.csv", "--out", o / "r.json"], "none.csv"),
    "survey as map": (lambda g, t, o: ["query", g, g, "--out", o / "p.csv"], "good.csv"),
    "survey as result": (lambda g, t, o: ["transform", g, "--by", g, "--out", o / "a.csv"], "good.csv"),
    "result that is none": (
        lambda g, t, o: ["transform", g, "--by", written(t, "r.json", EMPTY_RESULT), "--out", o / "a.csv"],
        "r.json",
    ),
    "trajectory for a survey without time": (
        lambda g, t, o: ["info", g, "--trajectory", written(t, "p.tum", "0 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n")],
        "missing t",
    ),
    "folder of the result is missing": (lambda g, t, o: ["register", g, g, "--out", o / "no" / "r.json"], "no"),
    "folder of the pair is missing": (lambda g, t, o: ["simulate", "uniform", "--out", o / "no" / "s"], "no"),
    "file as folder": (lambda g, t, o: ["simulate", "uniform", "--out", g], "good.csv"),
    "result would be a folder": (lambda g, t, o: ["register", g, g, "--out", o], "folder"),
    "one survey twice": (lambda g, t, o: ["map", g, g, "--out", o / "m"], "holds the same samples as"),
    "result over an input, spelt otherwise": (
        lambda g, t, o: ["map", g, "--out", t / ".." / t.name / "good.csv"],
        "an input",
    ),
    "report over the result": (
        lambda g, t, o: ["register", g, g, "--out", o / "r", "--report", o / "r"],
        "another result",
    ),
    "missing configuration": (lambda g, t, o: ["map", g, "--config", t / "c.yaml", "--out", o / "m"], "c.yaml"),
    "settings of the field that are no group": (
        lambda g, t, o: ["map", g, "--config", written(t, "c.yaml", "field: 3\n"), "--out", o / "m"],
        ": field: ",
    ),
    "settings of preparation that are no group": (
        lambda g, t, o: ["prepare", g, "--config", written(t, "c.yaml", "preparation: 3\n"), "--out", o / "m"],
        ": preparation: ",
    ),
    "two results to view": (
        lambda g, t, o: ["view", g, g, written(t, "r.json", EMPTY_RESULT), g, "--out", o / "v.html"],
        "found 1 results and 3",
    ),
}


@pytest.mark.parametrize("case", USAGE)
def test_bad_usage_is_one_line(case, good, out, refused, tmp_path):
    arguments, words = USAGE[case]
    content = good.read_bytes()
    refused([*arguments(good, tmp_path, out)], words, out)
    assert good.read_bytes() == content


LAUGHS = "a0: &a0 [1, 2]\n" + "".join(f"a{i}: &a{i} [*a{i - 1}, *a{i - 1}, *a{i - 1}]\n" for i in range(1, 60))
CONFIGS: dict[str, tuple[str, str]] = {
    "not YAML": ("field: [1, 2\n", "line"),
    "a word": ("fast\n", "str"),
    "unknown setting": ("lengthscal: 1\n", ": lengthscal: "),
    "misspelt nested setting": ("field: {lenghtscale: 1}\n", "did you mean 'lengthscale'?"),
    "out of bounds": ("field: {lengthscale: -1}\n", "field.lengthscale"),
    "a Python object": ("!!python/object/apply:os.system ['true']\n", "line 1"),
    "empty file": ("", "empty"),
    "values repeated without end": (LAUGHS, "repeats values by name"),
    "nested without end": ("[" * 2_000, "nested too deeply"),
    "JSON cut off": ('{"schema": "magmatch.registration/1", "config": {', "line 1"),
    "larger than settings are": ("#" + "x" * (2 << 20), "larger than any settings"),
}


@pytest.mark.parametrize("case", CONFIGS)
def test_a_bad_configuration_names_the_setting(case, good, out, refused, tmp_path):
    text, words = CONFIGS[case]
    config = written(tmp_path, "c.yaml", text)
    assert "c.yaml" in refused(["register", good, good, "--config", config, "--out", out / "r.json"], words, out)


def test_bad_points_are_refused_by_line_and_swapped_ones_by_the_map(place, out, refused, tmp_path):
    points = written(tmp_path, "p.csv", "x,y,z\n0,0,0\n0,nan,0\n")
    refused(["query", place / "base.map", points, "--out", out / "q.csv"], "line 3, column 'y'", out)
    refused(["query", points, place / "base.map", "--out", out / "q.csv"], "p.csv: expected a saved map", out)


def truncated(raw: bytes) -> bytes:
    return raw[: len(raw) // 2]


def flipped(raw: bytes) -> bytes:
    # The middle lies in an array's chunk, whatever the small entries weigh.
    middle = len(raw) // 2
    return raw[:middle] + bytes([raw[middle] ^ 1]) + raw[middle + 1 :]


@pytest.mark.parametrize("damage", [truncated, flipped])
def test_a_damaged_map_is_refused(damage, place, good, out, refused, tmp_path):
    bad = tmp_path / "bad.map"
    bad.write_bytes(damage((place / "base.map").read_bytes()))
    for words in (["register", good, bad], ["map", bad], ["transform", bad, "--by", place / "result.json"]):
        refused([*words, "--out", out / "x"], "bad.map", out)


def test_a_map_needs_no_units(place, good, out, refused):
    words = ("register", good, place / "base.map", "--target-field-unit", "uT", "--out", out / "r.json")
    refused(words, "--target-field-unit", out)


@pytest.mark.parametrize(
    "edit", [{"status": "ambiguous", "T_base_target": None, "covariance": None}, {"n_inliers": 1}]
)
def test_a_refused_registration_moves_nothing_and_an_edited_one_neither(edit, place, good, out, refused, tmp_path):
    content = json.loads((place / "result.json").read_text()) | edit
    if "status" in edit:
        content.pop("sha256", None)
    result = written(tmp_path, "r.json", json.dumps(content))
    refused(["transform", good, "--by", result, "--out", out / "a.csv"], "r.json", out)


@pytest.mark.parametrize(
    ("number", "words"), [(errno.EACCES, "m: no permission to write"), (errno.EROFS, "m: Read-only file system")]
)
def test_a_folder_that_cannot_be_written_is_refused_before_the_work(number, words, good, out, refused, monkeypatch):
    def deny(*_args, **_named):
        raise OSError(number, os.strerror(number), "/out/.magmatch-x")

    monkeypatch.setattr("magmatch.cli.outputs.tempfile.NamedTemporaryFile", deny)
    refused(["map", good, "--out", out / "m"], words, out)
