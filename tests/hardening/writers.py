# SPDX-License-Identifier: BSD-3-Clause
"""Every writer of the package with two contents to write; as a script: kill them while they write, again and again.

Run ``python tests/hardening/writers.py FOLDER N_KILLS``; prints one line of JSON for each writer.
"""

import json
import os
import random
import signal
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from magmatch.data.survey import Survey
from magmatch.data.tables.table import write_table
from magmatch.data.trajectory import Trajectory
from magmatch.data.write import SURVEY_WRITERS
from magmatch.field.axis_grid import map_on_grid, write_netcdf, write_ply_cloud, write_vtk
from magmatch.field.build import build_map
from magmatch.field.config import FieldConfig
from magmatch.preparation.preparation_report import PreparationReport, StepReport
from magmatch.preparation.sensor_model import SensorCorrection
from magmatch.registration.result import RegistrationResult, Status
from magmatch.registration.to_other_programs import write_g2o, write_relative_tum, write_static_transform


@dataclass(frozen=True)
class Writer:
    """A function that writes one of two contents under a name, and the extra it needs."""

    write: Callable[[int, Path], None]
    file: str
    needs: str = ""


def survey(seed, n=300):
    rng = np.random.default_rng(seed)
    p = rng.uniform(0, [2.0, 1.5, 0.5], (n, 3))
    b = 4e-5 + 1e-5 * np.stack([np.sin(p[:, 0]), np.cos(p[:, 1]), np.sin(p[:, 2] + p[:, 0])], axis=1)
    return Survey(p, b, 1e5 + np.arange(float(n)) / 8, Rotation.random(n, rng=rng), name=f"survey-{seed}")


def result(seed):
    T = RigidTransform.from_components([0.1 * seed, 0.2, 0.3], Rotation.from_euler("z", seed, degrees=True))
    return RegistrationResult(Status.ACCEPTED, f"reason {seed}", T, covariance=(1 + seed) * np.eye(6), version="0")


def report(seed):
    step = StepReport("hard iron", "applied", f"x {seed} uT", 1.0 + seed, 0.5, "uT")
    return PreparationReport(
        f"log-{seed}", (100, 90), (step,), {"n_samples": 4000 + seed}, SensorCorrection(), (), "0"
    )


def catalogue() -> dict[str, Writer]:
    """Writers by name; all content is made here, so that a write does little but write."""
    surveys, results, reports = ([make(seed) for seed in (1, 2)] for make in (survey, result, report))
    config = FieldConfig(prior="spline", lengthscale=0.8, signal_sd=1e-5, noise_sd=1e-7, spacing=0.5)
    maps = [build_map(s.subset(np.arange(60)), config) for s in surveys]
    grids = [map_on_grid(m, 0.2) for m in maps]
    extras = {".parquet": "pyarrow", ".mcap": "mcap"}
    writers = {
        f"survey {ending}": Writer(
            lambda k, path, write=write: write(surveys[k], path), f"survey{ending}", extras.get(ending, "")
        )
        for ending, write in SURVEY_WRITERS.items()
    }
    poses = [Trajectory(s.times, s.positions, s.orientations) for s in surveys]
    return writers | {
        "trajectory": Writer(lambda k, path: poses[k].save(path), "poses.tum"),
        "query": Writer(lambda k, path: write_table(path, {"x": surveys[k].positions[:, 0]}), "answer.csv"),
        "map": Writer(lambda k, path: maps[k].save(path), "room.map"),
        "map grid .vtk": Writer(lambda k, path: write_vtk(grids[k], path), "map.vtk"),
        "map grid .ply": Writer(lambda k, path: write_ply_cloud(grids[k], path), "map.ply"),
        "map grid .nc": Writer(lambda k, path: write_netcdf(grids[k], path, "map"), "map.nc", "xarray"),
        "result": Writer(lambda k, path: results[k].save(path), "result.json"),
        "result .tum": Writer(lambda k, path: write_relative_tum(results[k], path), "result.tum"),
        "result .g2o": Writer(lambda k, path: write_g2o(results[k], path), "result.g2o"),
        "result .yaml": Writer(lambda k, path: write_static_transform(results[k], path, "a", "b"), "result.yaml"),
        "preparation report": Writer(lambda k, path: reports[k].save(path), "report.json"),
        "report page": Writer(lambda k, path: write_page(surveys[k], results[k], path), "report.html", "plotly"),
        "view page": Writer(lambda k, path: write_view(surveys[k], path), "view.html", "plotly"),
    }


def write_page(target, found, path):
    from magmatch.viz.pages.registration_page import write_report

    write_report(path, None, None, replace(found, reason=target.name))


def write_view(shown, path):
    from magmatch.viz.view import write_view

    write_view(path, [shown])


def available() -> dict[str, Writer]:
    """Writers whose extras are installed."""
    return {name: writer for name, writer in catalogue().items() if not writer.needs or find_spec(writer.needs)}


def pack_once() -> None:
    """Let pages be written many times: packing their script takes much longer than that."""
    if find_spec("plotly"):
        page = import_module("magmatch.viz.pages.page")
        page._packed_plotly = cache(page._packed_plotly)


def kill_while_writing(writer: Writer, folder: Path, n_kills: int, rng: random.Random) -> dict[str, int]:
    """Kill a process that writes the two contents in turn; what it leaves has to be one of them."""
    folder.mkdir(parents=True)
    path, wholes = folder / writer.file, []
    for k in (0, 1):
        writer.write(k, path)
        wholes.append(path.read_bytes())
        start = time.perf_counter()
        writer.write(k, path)
        longest = 2.5 * (time.perf_counter() - start)
        assert path.read_bytes() == wholes[k], "the same content gives other bytes"
    assert wholes[0] != wholes[1]
    seen = {"kills": 0, "one": 0, "other": 0, "neither": 0, "in_the_middle": 0}
    for _ in range(n_kills):
        writer.write(0, path)
        kill_one(writer, path, rng.uniform(0, longest))
        found = path.read_bytes() if path.exists() else b""
        seen["one" if found == wholes[0] else "other" if found == wholes[1] else "neither"] += 1
        left = [p for p in folder.iterdir() if p.name.startswith(f".{writer.file}.tmp-")]
        seen["in_the_middle"] += bool(left)
        seen["kills"] += 1
        for p in left:
            p.unlink()
    return seen


def kill_one(writer: Writer, path: Path, delay: float) -> None:
    """One process that writes again and again, killed so many seconds after its first write."""
    ready, begun = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            writer.write(1, path)  # the first write also sets up what the libraries need
            os.write(begun, b"x")
            while True:  # ends by the signal alone
                for k in (0, 1):
                    writer.write(k, path)
        finally:
            os._exit(1)
    os.close(begun)
    os.read(ready, 1)
    os.close(ready)
    time.sleep(delay)
    os.kill(child, signal.SIGKILL)
    assert os.WIFSIGNALED(os.waitpid(child, 0)[1]), "the writer failed by itself"


def main() -> None:
    folder, n_kills = Path(sys.argv[1]), int(sys.argv[2])
    writers = available()
    pack_once()
    for i, (name, writer) in enumerate(writers.items()):
        n = n_kills // len(writers) + (i < n_kills % len(writers))
        seen = kill_while_writing(writer, folder / str(i), n, random.Random(i))
        print(json.dumps({"writer": name} | seen), flush=True)


if __name__ == "__main__":
    main()
