# SPDX-License-Identifier: BSD-3-Clause
"""The public recordings as surveys: one loader per dataset, in tesla, metre and one frame."""

import logging
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import scipy.io
from scipy.spatial.transform import Rotation

from magmatch.data.datasets import DATASETS, fetch, verified_files
from magmatch.data.survey import Survey
from magmatch.data.units import TESLA_PER_UNIT
from magmatch.errors import ConfigurationError, import_extra
from magmatch.typing import Matrix, Scalars

logger = logging.getLogger(__name__)

# Some recordings count in "the Earth's field at the site"; 45 uT reproduces the other sensor of the same robot.
TESLA_PER_SITE_UNIT = 45e-6
# The two levels of the CEA building; between them lie stairs, below the first a slope.
CEA_FLOORS = {"floor1": (2.3, 3.8), "floor2": (5.8, 6.8)}  # m
# The authors of the kok recordings leave out the first samples of this one.
KOK_SKIPPED = {"library": 150}


def load_recordings(name: str, source_dir: str | Path | None = None) -> dict[str, Survey]:
    """Read a public dataset as surveys by recording, from `source_dir` in place, else from the cache or by download.

    All recordings of one dataset share a frame, except those of ``kok``, which lie in four places.
    """
    if name in DATASETS and name not in _LOADERS:
        msg = f"dataset '{name}' holds raw logs without poses; fetch it, and give its files to 'magmatch slam'"
        raise ConfigurationError(msg)
    files = fetch(name) if source_dir is None else verified_files(name, source_dir)
    return _LOADERS[name](files)


def _load_kok(files: Mapping[str, Path]) -> dict[str, Survey]:
    """Tablet recordings: positions are sums of steps, the magnetometer is turned 90 deg about z in the tablet."""
    surveys = {}
    for place in ("eight", "square", "library", "mall"):
        content = scipy.io.loadmat(files[f"{place}.mat"], squeeze_me=True)
        positions = np.vstack([np.zeros(3), np.cumsum(content["dPos"], axis=0)])
        wxyz = np.asarray(content["quat"])
        orientations = Rotation.from_quat(wxyz[:, [1, 2, 3, 0]]) * Rotation.from_euler("z", 90, degrees=True)
        survey = Survey(
            positions=positions,
            field=orientations.apply(content["m"]) * TESLA_PER_UNIT["uT"],
            times=np.asarray(content["t"], dtype=np.float64),
            orientations=orientations,
            frame=f"kok-{place}",
            name=f"kok/{place}",
            pose_sd=0.15,  # visual-inertial drift of 0.1 to 0.2 m between laps
        )
        surveys[place] = survey.subset(np.arange(KOK_SKIPPED.get(place, 0), len(survey)))
    return surveys


def _load_cea(files: Mapping[str, Path]) -> dict[str, Survey]:
    """Both walks, whole and by floor."""
    surveys = {}
    for walk in ("training", "test"):
        rows = _numbers(files[f"corridor_{walk}.csv"])
        field = rows[:, 3:] * TESLA_PER_UNIT["uT"]
        whole = Survey(rows[:, :3].copy(), field, frame="cea", name=f"cea/{walk}", pose_sd=0.05)
        surveys[walk] = whole
        for floor, (low, high) in CEA_FLOORS.items():
            height = whole.positions[:, 2]
            surveys[f"{walk}-{floor}"] = whole.subset((height > low) & (height < high))
    return surveys


def _load_aalto(files: Mapping[str, Path]) -> dict[str, Survey]:
    """Every sensor and run; the robot's plane is z = 0, its sensors 0.20 to 0.25 m above the floor."""
    surveys = {}
    for sensor, unit in (("invensense", TESLA_PER_UNIT["uT"]), ("trivisio", TESLA_PER_SITE_UNIT)):
        for run in (1, 2, 4):
            times, plane, field = (_numbers(files[f"{sensor}/{run}-{part}.csv"]) for part in ("time", "loc", "mag"))
            positions = np.column_stack([plane, np.zeros(len(plane))])
            name = f"{sensor}-{run}"
            surveys[name] = Survey(positions, field * unit, times[:, 0], frame="aalto", name=f"aalto/{name}")
    return surveys


def _load_jidling(files: Mapping[str, Path]) -> dict[str, Survey]:
    """One recording of a volume; rows lost by the motion capture are left out."""
    content = scipy.io.loadmat(files["dataSet14.mat"], squeeze_me=True, struct_as_record=False)
    record = content["data_obj"][1]
    positions, field = np.asarray(record.pos, dtype=np.float64), np.asarray(record.mag, dtype=np.float64)
    # Sensor to world: turned by it, readings that the magnetometer gave twice are equal again.
    wxyz = np.asarray(record.quat, dtype=np.float64)
    kept = np.isfinite(np.column_stack([positions, field, wxyz])).all(axis=1)
    times: Scalars = 0.01 * np.arange(len(positions))  # 100 Hz; its own clock runs for another row count
    survey = Survey(
        positions[kept],
        field[kept] * TESLA_PER_SITE_UNIT,
        times[kept],
        Rotation.from_quat(wxyz[kept][:, [1, 2, 3, 0]]),
        frame="jidling",
        name="jidling/volume",
    )
    return {"volume": survey}


def _load_kaist(files: Mapping[str, Path]) -> dict[str, Survey]:
    """One floor, positions on a grid at an unknown carrying height (z = 0)."""
    h5py = import_extra("h5py", "reading the kaist dataset (HDF5)", "datasets")
    with h5py.File(files["magmap-KI-1F-0.6p.mat"]) as content:
        rows = np.asarray(content["map"], dtype=np.float64).T
    positions = np.column_stack([rows[:, :2], np.zeros(len(rows))])
    return {"floor": Survey(positions, rows[:, 2:5] * TESLA_PER_UNIT["uT"], frame="kaist", name="kaist/floor")}


def _numbers(path: Path) -> Matrix:
    """Rows of numbers separated by commas; files here are verified, so faults need no words."""
    return np.loadtxt(path, delimiter=",", ndmin=2)


_LOADERS: Mapping[str, Callable[[Mapping[str, Path]], dict[str, Survey]]] = {
    "kok": _load_kok,
    "cea": _load_cea,
    "aalto": _load_aalto,
    "jidling": _load_jidling,
    "kaist": _load_kaist,
}
