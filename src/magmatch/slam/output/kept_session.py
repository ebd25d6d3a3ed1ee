# SPDX-License-Identifier: BSD-3-Clause
"""A finished session in a file, to which logs can be added: all but the samples, which are in the logs' files."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from magmatch.data.fingerprint import describe_input
from magmatch.data.survey import Survey
from magmatch.errors import DataFormatError
from magmatch.estimation.path_noise import PathNoise
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.field.sensor_biases import without_bias
from magmatch.slam.config import SlamConfig
from magmatch.slam.graph.anchors import Anchor, fixed_points
from magmatch.slam.graph.block_cholesky import BlockCholesky
from magmatch.slam.graph.factors import Closure, SubmapFactor
from magmatch.slam.graph.normal_equations import normal_equations
from magmatch.slam.graph.odometry import odometry_graph
from magmatch.slam.places import Places
from magmatch.slam.search.submaps import SubmapMaker
from magmatch.slam.sensor_bias import in_one_calibration
from magmatch.slam.session import Session
from magmatch.slam.windows import cut
from magmatch.store import expect, load, naming, save

SESSION, SCHEMA = "session.state", "magmatch.slam.session/9"
KINDS = (Anchor, Closure, Hyperparameters, PathNoise, SubmapFactor)


def write_session(session: Session, path: Path) -> None:
    """Write the state needed to add logs; nothing if no log can be added without redoing the others."""
    places = session.places
    if places is None or places.maker is None:
        return
    graph, maker = places.graph, places.maker
    content = {
        "stated": places.stated.model_dump(mode="json"),
        "config": graph.config.model_dump(mode="json"),
        "inputs": [describe_input(s)["sha256"] for s in session.given],
        "seconds": session.seconds, "hyperparameters": maker.hyperparameters, "noise": maker.noise,
        "squared_gradient": maker.squared_gradient, "length": maker.length,
        "biases": places.biases, "anchors": places.anchors,
        "closures": list(graph.closures), "submap_factors": tuple(graph.submap_factors),
        "R": graph.R, "p": graph.p, "level": graph.level, "lasting": graph.lasting,
    }  # fmt: skip
    save(path, SCHEMA, content)


def session_in(folder: str | Path) -> tuple[Path, dict[str, Any]]:
    """File and content of the session that a folder holds; DataFormatError where it holds none."""
    path = Path(folder) / SESSION
    if not path.is_file():
        raise DataFormatError(folder, f"holds no session to continue ({SESSION}); leave out --continue")
    return path, load(path, SCHEMA, KINDS)


def read_session(
    folder: str | Path, surveys: Sequence[Survey], kept: tuple[Path, dict[str, Any]] | None = None
) -> tuple[Session, list[Survey]]:
    """Read a session from a folder; also gives those of some surveys that are not in it yet.

    ``kept``: what `session_in` gave, where it was read before.

    Raises
    ------
    DataFormatError
        The folder holds no session, or one of a survey that is not given.
    """
    path, content = kept or session_in(folder)
    by_content = {describe_input(s)["sha256"]: s for s in surveys}
    with naming(path):
        given = [by_content.get(sha) for sha in content["inputs"]]
        known = [survey for survey in given if survey is not None]
        session = Session(SlamConfig.model_validate(content["stated"]), known)
        if len(known) == len(given):
            session.places, session.seconds = _places(content, known), content["seconds"]
    if len(known) < len(given):
        words = f"holds a session of {len(given)} logs, of which {len(given) - len(known)} are not given"
        raise DataFormatError(folder, f"{words} or were changed; give all of them, and the new ones")
    return session, [s for s in surveys if describe_input(s)["sha256"] not in content["inputs"]]


def _places(content: dict[str, Any], given: Sequence[Survey]) -> Places:
    expect(content, noise=PathNoise, length=float, closures=[Closure], submap_factors=[SubmapFactor])
    stated, config = (SlamConfig.model_validate(content[key]) for key in ("stated", "config"))
    unbiased = [
        without_bias(in_one_calibration(survey), bias)
        for survey, (bias, _) in zip(given, content["biases"], strict=True)
    ]
    paths = cut(unbiased, content["length"], config)
    graph = odometry_graph(paths, config)
    graph.R, graph.p, graph.level, graph.lasting = (content[k] for k in ("R", "p", "level", "lasting"))
    graph.closures, graph.submap_factors = content["closures"], content["submap_factors"]
    h, gradient, noise, length, anchors = (
        content[k] for k in ("hyperparameters", "squared_gradient", "noise", "length", "anchors")
    )
    maker = SubmapMaker(h, gradient, noise, length)
    if anchors:
        graph.fixed = fixed_points(anchors, paths)
    # Poses stay as they were; covariances follow from this.
    graph.factor = BlockCholesky.of(normal_equations(graph)[0])
    return Places(paths, graph, stated, maker, content["biases"], anchors)
