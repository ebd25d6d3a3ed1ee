# SPDX-License-Identifier: BSD-3-Clause
"""A finished session in a file, to which logs can be added: all but the samples, which are in the logs' files."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from magmatch.data.document import plain, read_document, write_document
from magmatch.data.fingerprint import describe_input
from magmatch.data.survey import Survey
from magmatch.errors import DataFormatError
from magmatch.field.hyperparameters import Hyperparameters
from magmatch.geometry import transform_from_matrix
from magmatch.registration.prepared.path_noise import PathNoise
from magmatch.slam.config import SlamConfig
from magmatch.slam.graph.anchors import Anchor, fixed_points
from magmatch.slam.graph.factors import Closure, SubmapFactor
from magmatch.slam.graph.normal_equations import normal_equations
from magmatch.slam.graph.odometry import odometry_graph
from magmatch.slam.places import Places
from magmatch.slam.search.submaps import SubmapMaker
from magmatch.slam.sensor_bias import in_one_calibration, without_bias
from magmatch.slam.session import Session
from magmatch.slam.windows import cut

SESSION, SCHEMA, WHAT = "session.json", "magmatch.slam.session/7", "session of slam"
MAX_BYTES = 256 * 1024**2


def write_session(session: Session, path: Path) -> None:
    """Write the state needed to add logs; nothing if no log can be added without redoing the others."""
    places = session.places
    if places is None or places.maker is None:
        return
    graph, maker = places.graph, places.maker
    content = {
        "schema": SCHEMA, "stated": places.stated.model_dump(mode="json"),
        "config": maker.config.model_dump(mode="json"),
        "inputs": [describe_input(s)["sha256"] for s in session.given],
        "seconds": session.seconds, "numbers": asdict(maker.numbers), "noise": asdict(maker.noise),
        "squared_gradient": maker.squared_gradient, "length": maker.length,
        "biases": [[b, sd] for b, sd in places.biases],
        "anchors": [[a.log, a.t, a.position, a.sd, log] for a, log in places.anchors],
        "closures": graph.closures, "submap_factors": graph.submap_factors,
        "R": graph.R, "p": graph.p, "level": graph.level, "lasting": graph.lasting,
    }  # fmt: skip
    write_document(path, {key: plain(value, key) for key, value in content.items()})


def read_session(folder: str | Path, surveys: Sequence[Survey]) -> tuple[Session, list[Survey]]:
    """Read a session from a folder; also gives those of some surveys that are not in it yet.

    Raises
    ------
    DataFormatError
        The folder holds no session, or one of a survey that is not given.
    """
    path = Path(folder) / SESSION
    if not path.is_file():
        raise DataFormatError(folder, f"holds no session to continue ({SESSION}); leave out --continue")
    content = read_document(path, SCHEMA, WHAT, MAX_BYTES)
    by_content = {describe_input(s)["sha256"]: s for s in surveys}
    try:
        given = [by_content.get(sha) for sha in content["inputs"]]
        known = [survey for survey in given if survey is not None]
        session = Session(SlamConfig.model_validate(content["stated"]), known)
        if len(known) == len(given):
            session.places, session.seconds = _places(content, known), content["seconds"]
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        raise DataFormatError(path, f"is not a {WHAT}: {error!r:.80}") from None
    if len(known) < len(given):
        words = f"holds a session of {len(given)} logs, of which {len(given) - len(known)} are not given"
        raise DataFormatError(folder, f"{words} or were changed; give all of them, and the new ones")
    return session, [s for s in surveys if describe_input(s)["sha256"] not in content["inputs"]]


def _places(content: dict[str, Any], given: Sequence[Survey]) -> Places:
    stated, config = (SlamConfig.model_validate(content[key]) for key in ("stated", "config"))
    biases = [(np.array(b), np.array(sd)) for b, sd in content["biases"]]
    unbiased = [
        without_bias(in_one_calibration(survey), bias) for survey, (bias, _) in zip(given, biases, strict=True)
    ]
    paths = cut(unbiased, content["length"], config)
    graph = odometry_graph(paths, config)
    graph.R, graph.p, graph.level, graph.lasting = (np.array(content[k]) for k in ("R", "p", "level", "lasting"))
    graph.closures = [_closure(c) for c in content["closures"]]
    graph.submap_factors = tuple(_submap_factor(f) for f in content["submap_factors"])
    numbers, noise = Hyperparameters(**content["numbers"]), PathNoise(**content["noise"])
    maker = SubmapMaker(numbers, content["squared_gradient"], noise, content["length"], config)
    anchors = [(Anchor(name, t, np.array(x), sd), log) for name, t, x, sd, log in content["anchors"]]
    if anchors:
        graph.fixed = fixed_points(anchors, paths)
    # Poses stay as they were; covariances follow from this.
    graph.factor(normal_equations(graph)[0])
    return Places(paths, graph, stated, maker, biases, anchors)


def _closure(c: dict[str, Any]) -> Closure:
    arrays = {"T_first_second": transform_from_matrix(c["T_first_second"]), "covariance": np.array(c["covariance"])}
    return Closure(**c | arrays)


def _submap_factor(f: dict[str, Any]) -> SubmapFactor:
    return SubmapFactor(**f | {name: np.array(f[name]) for name in ("passes", "shares", "R", "t", "covariance")})
