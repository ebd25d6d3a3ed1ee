# SPDX-License-Identifier: BSD-3-Clause
"""What we show to newcomers runs."""

import re
import runpy
from pathlib import Path

import numpy as np
import pytest

import magmatch as mm
from magmatch.field.config import SPLINE

ROOT = Path(__file__).parents[1]


# What the second shows, `tests/published/test_register.py` does in less time.
SLOW = ("04_slam", "06_own_descriptor")
EXAMPLES = [
    pytest.param(path, id=path.stem, marks=[pytest.mark.slow] * (path.stem in SLOW))
    for path in sorted((ROOT / "examples").glob("0*.py"))
]


def run(example, monkeypatch, *words):
    monkeypatch.setattr("sys.argv", [str(example), *map(str, words)])
    runpy.run_path(str(example), run_name="__main__")


# ros2_node.py needs ROS; tests/localization/test_ros2_node.py runs what of it does not.
@pytest.mark.parametrize("example", EXAMPLES)
def test_an_example_runs_and_says_something(example, capsys, monkeypatch, tmp_path):
    """On fewer samples than it has as it stands, or with splines where it compares all priors."""
    if "gtsam" in example.stem:
        pytest.importorskip("gtsam")
    # Where figures are saved.
    monkeypatch.chdir(tmp_path)
    words, build = [], mm.build_map
    if example.stem == "01_build_map":
        words = ["few.csv"]
        mm.read_survey(ROOT / "src/magmatch/data/samples/office/base.csv").subset(range(150)).save("few.csv")
    else:
        monkeypatch.setattr(mm, "build_map", lambda survey, config=SPLINE, **more: build(survey, config, **more))
    run(example, monkeypatch, *words)
    assert capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize("name", ["01_build_map", "05_localize", "07_gtsam_factor"])
def test_as_it_stands_an_example_runs_too(name, capsys, monkeypatch):
    if "gtsam" in name:
        pytest.importorskip("gtsam")
    run(ROOT / "examples" / f"{name}.py", monkeypatch)
    assert capsys.readouterr().out


@pytest.fixture(scope="module")
def factor():
    """The names of the example with GTSAM, which is not run."""
    pytest.importorskip("gtsam")
    return runpy.run_path(str(ROOT / "examples" / "07_gtsam_factor.py"))


@pytest.fixture(scope="module")
def field_map():
    rng = np.random.default_rng(2)
    p = rng.uniform(-1, 1, (250, 3))
    b = np.array([20e-6, 0, -40e-6]) + 5e-6 * np.column_stack([np.sin(3 * p[:, 1]), np.cos(2 * p[:, 0]), p[:, 2]])
    return mm.build_map(mm.Survey(p, b), SPLINE)


def test_the_field_factor_has_the_jacobian_of_its_error(factor, field_map):
    import gtsam

    rng, h = np.random.default_rng(3), 1e-5
    for xi in rng.uniform(-0.6, 0.6, (5, 6)) * [5, 5, 5, 1, 1, 1]:
        T = gtsam.Pose3.Expmap(xi)
        _, J = factor["predict"](field_map, T)
        steps = h * np.eye(6)
        ahead, back = ([factor["predict"](field_map, T.retract(way * d))[0] for d in steps] for way in (1, -1))
        np.testing.assert_allclose(J, (np.array(ahead) - back).T / (2 * h), atol=1e-5 * np.abs(J).max())


def test_the_field_factor_has_the_noise_of_the_map_and_of_the_sensor(factor, field_map):
    import gtsam

    T, measured = gtsam.Pose3.Expmap(np.array([0.3, -0.8, 2.0, 0.2, -0.4, 0.5])), np.array([30.0, 10.0, -20.0])
    R, values = T.rotation().matrix(), gtsam.Values()
    values.insert(7, T)
    made = factor["field_factor"](7, measured, field_map, T)
    C = R.T @ field_map.covariance(T.translation()[None])[0] @ R + field_map.hyperparameters.noise_sd**2 * np.eye(3)
    off = R.T @ field_map.evaluate(T.translation()[None]).field[0] - 1e-6 * measured
    assert made.error(values) == pytest.approx(off @ np.linalg.solve(C, off) / 2, rel=1e-9)


def test_the_quickstart_of_the_readme_runs(capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    assert len(blocks) == 1
    exec(compile(blocks[0], "README.md", "exec"), {})
    assert "accepted" in capsys.readouterr().out


def test_links_of_the_readme_lead_somewhere():
    for target in re.findall(r"\]\(([^)#]+)", (ROOT / "README.md").read_text()):
        assert target.startswith("https://") or (ROOT / target).exists(), target
