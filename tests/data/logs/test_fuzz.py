# SPDX-License-Identifier: BSD-3-Clause
"""Mutated files of every format: a survey or one of our errors, in bounded time and memory. `make fuzz` runs many."""

import gzip
import logging
import shutil
import sqlite3
import zipfile
import zlib
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from hypothesis import given, settings
from hypothesis import strategies as st

from magmatch.data.formats.format import SurveyFormat
from magmatch.data.formats.load_trajectory import load_trajectory
from magmatch.data.logs.open import open_log
from magmatch.data.read import read_survey, read_survey_and_channels
from magmatch.errors import MagmatchError


def hold(path, layout):
    """Read as users do, and through everything the reader can reach."""
    for recover in (False, True):
        words = ""
        try:
            read_survey_and_channels(path, layout.model_copy(update={"recover": recover}))
        except MagmatchError as error:
            words = str(error)
        assert "\n" not in words
        assert len(words) < 1500


@pytest.fixture(scope="module")
def seeds(made, tmp_path_factory):
    """One small whole file of each kind."""
    folder = tmp_path_factory.mktemp("seeds")
    series = made.flight(n_mag=24, n_pose=14).series
    static = made.Series(
        "/tf_static", "tf2_msgs/msg/TFMessage", series[1].log_ns[:1], series[1].values[:1], child="b"
    )
    three = [*series, static]
    poses = [f"{0.05 * i - 0.1!r} {i} {i * i} 0 0 0 0 1" for i in range(14)]
    (folder / "poses.tum").write_text("\n".join(poses))
    for name, write in made.WRITERS.items():
        write(folder, three if "JSON" not in name else series)
    for name, options in {"free.mcap": {}, "free-z.mcap": {"compression": "ZSTD"}}.items():
        made.mcap(folder / name, three, **({"compression": "NONE"} | options), enable_crcs=False)
    numbers = [made.Series(t, k, series[0].log_ns[:8], np.arange(8.0)) for t, k in made.numbers.items()]
    made.mcap(folder / "numbers.mcap", [*series, *numbers], compression="NONE", enable_crcs=False)
    made.ros1(folder / "numbers.bag", [*series, *numbers])
    rows = [f"{1_700_000_000_000_000_000 + 20_000_000 * i},{0.02 * i},{-45},{3},{20 + i}" for i in range(24)]
    logger = "\n".join(["time,seconds_elapsed,z,y,x", *rows, ""])
    (folder / "sensor-logger.csv").write_text(logger)
    names = ["Time (s)", *(f"Magnetic field {axis} (µT)" for axis in "xyz")]
    rows = [f"{0.02 * i!r},20,{3 + i},-45" for i in range(24)]
    (folder / "phyphox.csv").write_text("\n".join([",".join(f'"{n}"' for n in names), *rows, ""]))
    for name, member in {"logger.zip": "Magnetometer.csv", "phyphox.zip": "Raw Data.csv"}.items():
        with zipfile.ZipFile(folder / name, "w", zipfile.ZIP_DEFLATED) as archive:
            content = logger if "logger" in name else (folder / "phyphox.csv").read_text()
            archive.writestr(member, content)
    t = [1_700_000_000_000_000_000 + 20_000_000 * i for i in range(24)]
    (folder / "euroc.csv").write_text(
        "#timestamp [ns],x,y,z\n" + "\n".join(f"{s},20,{i},-45" for i, s in enumerate(t))
    )
    table = [f"{i / 10!r},{i},{i * i},0,2e-5,{i}e-7,-4e-5,0,0,0,1" for i in range(24)]
    (folder / "survey.csv").write_text("\n".join(["t,x,y,z,bx,by,bz,qx,qy,qz,qw", *table]))
    commas = (folder / "survey.csv").read_text().replace(",", ";").replace(".", ",")
    (folder / "commas.csv").write_text(commas)
    (folder / "survey.csv.gz").write_bytes(gzip.compress((folder / "survey.csv").read_bytes()))
    (folder / "log.mcap.gz").write_bytes(gzip.compress((folder / "log.mcap").read_bytes()))
    rows = [f"MAGN;{0.02 * i:.3f};{9 + 0.02 * i:.3f};20;{3 + i};-45;3" for i in range(24)]
    (folder / "getsensordata.txt").write_text("\n".join(["% GetSensorData", *rows, ""]))
    rows = [f"{20_000_000 * i},2,20,{3 + i},-45" for i in range(24)]
    (folder / "android.csv").write_text("\n".join(["event.timestamp,sensor,x,y,z", *rows, ""]))
    columns = dict(
        zip(["t", "x", "y", "z", "bx", "by", "bz"], np.array([r.split(",")[:7] for r in table], float).T, strict=True)
    )
    scipy.io.savemat(folder / "survey.mat", columns)
    scipy.io.savemat(folder / "survey-packed.mat", columns, do_compression=True)
    if find_spec("h5py"):
        import h5py

        with h5py.File(folder / "survey-hdf5.mat", "w") as file:
            for name, values in columns.items():
                file.create_dataset(name, data=values[None], compression="gzip")
    if _has_pyarrow():
        import pandas as pd

        frame = pd.read_csv(folder / "survey.csv")
        frame.to_parquet(folder / "survey.parquet")
        frame.to_parquet(folder / "survey-plain.parquet", compression="none", row_group_size=5)
    return folder


def _has_pyarrow():
    try:
        import pandas  # noqa: F401
        import pyarrow  # noqa: F401
    except ImportError:
        return False
    return True


FILES = [
    "log.bag", "log-bz2.bag", "log-lz4.bag", "log.mcap", "log1.mcap", "logj.mcap", "logl.mcap", "logn.mcap",
    "logc.mcap", "logs.mcap", "free.mcap", "free-z.mcap", "numbers.mcap", "numbers.bag", "log-db3/log-db3.db3",
    "log-db3z/metadata.yaml", "log-mcap/metadata.yaml",
    "survey.csv", "commas.csv", "survey.parquet", "survey-plain.parquet", "sensor-logger.csv", "phyphox.csv",
    "logger.zip", "phyphox.zip", "euroc.csv", "survey.csv.gz", "log.mcap.gz", "getsensordata.txt", "android.csv",
    "survey.mat", "survey-packed.mat", "survey-hdf5.mat",
]  # fmt: skip


@pytest.mark.parametrize("name", FILES)
def test_mutated_files_end_in_a_survey_or_a_known_error(name, seeds, tmp_path, n_fuzz, mutated, bounded, caplog):
    if not (seeds / name).exists():
        pytest.skip("written by an extra that is not installed")
    caplog.set_level(logging.CRITICAL, logger="magmatch")
    rng = np.random.default_rng(zlib.crc32(name.encode()))
    raw = (seeds / name).read_bytes()
    needs_poses = name.endswith((".zip", "logger.csv", "phyphox.csv", "euroc.csv", "data.txt", "android.csv"))
    layout = SurveyFormat(trajectory=seeds / "poses.tum" if needs_poses else None)
    target = tmp_path / Path(name).name
    if "/" in name:
        shutil.copytree(seeds / Path(name).parent, tmp_path / "bag")
        target = tmp_path / "bag" / Path(name).name
    for _ in range(n_fuzz):
        target.write_bytes(mutated(raw, rng))
        try:
            with bounded():
                hold(target.parent if "/" in name else target, layout)
        except BaseException:
            (Path("fuzz-failure") if n_fuzz > 1000 else target).write_bytes(target.read_bytes())
            raise


@pytest.mark.parametrize("name", ["poses.tum", "euroc.csv"])
def test_mutated_trajectories_end_in_poses_or_a_known_error(name, seeds, tmp_path, n_fuzz, mutated):
    rng = np.random.default_rng(5)
    raw = (seeds / name).read_bytes()
    for _ in range(n_fuzz):
        (tmp_path / name).write_bytes(mutated(raw, rng))
        with suppress(MagmatchError):
            load_trajectory(tmp_path / name, SurveyFormat())


MAGIC = [
    b"\x89MCAP0\r\n",
    b"#ROSBAG V2.0\n",
    b"SQLite format 3\0",
    b"PAR1",
    b"PK\x03\x04",
    b"#timestamp [ns],x\n",
    b"\x1f\x8b\x08\0\0\0\0\0\0\0",
    b"MATLAB 5.0 MAT-file".ljust(124) + b"\0\1IM",
    b"\x89HDF\r\n\x1a\n",
    b"% a\nMAGN;1;1;1;1;1;3\n",
    b"event.timestamp,sensor,x,y,z\n",
    b"",
]


@settings(max_examples=150, deadline=None)
@given(magic=st.sampled_from(MAGIC), body=st.binary(max_size=400), tail=st.sampled_from(MAGIC))
def test_any_bytes_behind_any_signature_end_in_a_known_error(magic, body, tail, tmp_path_factory):
    path = tmp_path_factory.getbasetemp() / "any.bin"
    path.write_bytes(magic + body + tail)
    hold(path, SurveyFormat())


def test_rows_of_any_type_in_a_database_end_in_a_known_error(tmp_path):
    values = [None, 1, -1, 1 << 62, 1.5, "text", b"", b"\0\1\0\0", b"\0\1\0\0" + bytes(120)]
    rng = np.random.default_rng(0)
    for k in range(25):
        path = tmp_path / f"{k}.db3"
        database = sqlite3.connect(path)
        database.execute("CREATE TABLE topics (id, name, type, serialization_format)")
        database.execute("CREATE TABLE messages (id, topic_id, timestamp, data)")
        for j, name in enumerate(["sensor_msgs/msg/MagneticField", "nav_msgs/msg/Odometry"]):
            row = [j, f"/{j}", name, "cdr"]
            if rng.random() < 0.3:
                row[int(rng.integers(4))] = values[int(rng.integers(len(values)))]
            database.execute("INSERT INTO topics VALUES (?, ?, ?, ?)", row)
        for i in range(12):
            row = [i, i % 2, i, bytes(130)]
            if rng.random() < 0.3:
                row[int(rng.integers(4))] = values[int(rng.integers(len(values)))]
            database.execute("INSERT INTO messages VALUES (?, ?, ?, ?)", row)
        database.commit()
        database.close()
        hold(path, SurveyFormat())


def test_whole_seeds_are_read(seeds):
    """Else mutating them would test little."""
    for name in FILES:
        if not (seeds / name).exists() or name.endswith(
            (".zip", "logger.csv", "phyphox.csv", "euroc.csv", ".txt", "android.csv")
        ):
            continue
        path = (seeds / name).parent if "/" in name else seeds / name
        assert len(read_survey(path)) >= 10
    log = open_log(seeds / "log.bag")
    assert len(log.topics()) == 3
    log.close()
