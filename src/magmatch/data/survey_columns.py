# SPDX-License-Identifier: BSD-3-Clause
"""The columns of a survey's table, and the survey that they make: in files, DataFrames and Datasets alike."""

import json
import logging
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from math import isfinite
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np

from magmatch.arguments import found
from magmatch.data.geodesy import Origin, local_east_north, local_east_north_up, look_like_radians, what_is_wrong
from magmatch.data.tables.header_names import header_of
from magmatch.data.tables.number_marks import plain_text
from magmatch.data.tables.table import QUATERNION, Table
from magmatch.data.tables.text_rows import listed
from magmatch.data.units import METRE_PER_UNIT, TESLA_PER_UNIT, FieldUnit, LengthUnit, size_of_unit
from magmatch.errors import ConfigurationError, DataFormatError
from magmatch.typing import Points, Scalars

logger = logging.getLogger(__name__)

POSITION_COLUMNS = ("x", "y", "z")
FIELD_COLUMNS = ("bx", "by", "bz")
# These say the same in every row, and are written where they are not the defaults.
FRAME_COLUMN, ACCURACY_COLUMN, DEFAULT_FRAME = "survey_frame", "pose_sd", "survey"
# What the frame of places on the globe is called, followed by its origin.
GLOBAL_FRAME = "east, north, up of "
COLUMNS = ("t", *POSITION_COLUMNS, *FIELD_COLUMNS, *QUATERNION, ACCURACY_COLUMN)
# Degrees and metres on the globe, by the names that loggers give them; of several the first is taken.
GLOBAL_COLUMNS: Mapping[str, tuple[str, ...]] = {
    "lat": ("lat", "latitude", "lat_deg", "latitude_deg"),
    "lon": ("lon", "longitude", "lng", "long", "lon_deg", "longitude_deg"),
    "alt": ("alt", "altitude", "alt_m", "altitude_m", "elevation", "height"),
}
# Of what a constant may be true: a walk on one height, a sensor that never turned. A field is measured.
MAY_BE_CONSTANT = (*POSITION_COLUMNS, "alt", *QUATERNION)
# Names of columns that count rows; that of an index in pandas is empty.
COUNTERS = ("", "id", "index", "idx", "no", "nr", "num", "number", "row", "sample", "seq", "#")
# Metadata of Parquet files, and first comment of older CSV files: the same two as JSON.
SCHEMA = "magmatch.survey/1"
FieldFrame = Literal["survey", "sensor"]


@dataclass(frozen=True, slots=True)
class ChosenColumns:
    """The columns of a table to read, and those that it lacks and one constant stands for."""

    ours: Mapping[str, str]  # our names by the table's (lower case)
    constants: Mapping[str, float]  # by our names

    def of(self, table: Table) -> Table:
        """Return the table with our names, and the constants as columns."""
        constants = {ours: np.full(len(table), value) for ours, value in self.constants.items()}
        return replace(table, columns=table.renamed(self.ours).columns | constants)


def choose_columns(
    path: str | Path, names: Sequence[str], stated: Mapping[str, str], *, has_poses: bool = True
) -> ChosenColumns:
    """Choose columns among those there, given what is stated for our names: a name of theirs, or a constant.

    What is stated stands before what is guessed by name. Places on the globe are only looked for in a table that
    `has_poses`, none of them in metres.
    """
    there = [name.lower() for name in names]
    values = {ours: constant_of(text) for ours, text in stated.items() if text not in there}
    constants = {ours: value for ours, value in values.items() if value is not None}
    for ours in constants.keys() - MAY_BE_CONSTANT:
        found_it = f"expected a column for {ours}, found the constant {stated[ours]}"
        msg = f"columns: {found_it}; numbers of columns begin at 1"
        raise ConfigurationError(msg)
    theirs: dict[str, str] = {}
    for ours, text in stated.items():
        if ours not in constants and theirs.setdefault(text, ours) != ours:
            msg = f"columns: expected a column of its own for {ours}, found '{text}' for {theirs[text]} too"
            raise ConfigurationError(msg)
    if missing := next((name for name in theirs if name not in there), None):
        ours = theirs[missing]
        message = f"expected a column '{missing}' for {ours}, found {listed(names)}"
        if missing.isdecimal() and ours in MAY_BE_CONSTANT:
            message += f"; a constant of {missing} is {ours}={missing}.0"
        raise DataFormatError(path, message)
    chosen = theirs | _guessed([name for name in there if name not in theirs], stated, has_poses=has_poses)
    for name in chosen:
        if there.count(name) > 1:
            message = f"the column appears {there.count(name)} times; rename the others"
            raise DataFormatError(path, message, column=name)
    return ChosenColumns(chosen, constants)


def _guessed(free: Sequence[str], stated: Collection[str], *, has_poses: bool) -> dict[str, str]:
    """Our names of columns that nobody stated, by the table's; places on the globe where none are in metres."""
    on_globe = {ours: next((n for n in names if n in free), "") for ours, names in GLOBAL_COLUMNS.items()}
    has_metres = any(name in free or name in stated for name in ("x", "y"))
    is_global = "lat" in stated or "lon" in stated or (on_globe["lat"] and on_globe["lon"] and not has_metres)
    if not (is_global and has_poses):
        return {name: name for name in COLUMNS if name not in stated and name in free}
    hidden = {"x", "y", *stated, *(["alt"] if "z" in stated else [])}
    guessed = {name: name for name in COLUMNS if name in free} | {n: ours for ours, n in on_globe.items() if n}
    return {name: ours for name, ours in guessed.items() if ours not in hidden}


def constant_of(text: str) -> float | None:
    """The number that a text is, unless it counts columns: those are whole and begin at 1."""
    try:
        value = float(plain_text(text))
    except ValueError:
        return None
    return value if isfinite(value) and not (text.isdecimal() and value >= 1) else None


def column_numbers(stated: Mapping[str, str]) -> list[int]:
    """List the columns that are stated by number, counted from 1."""
    return [int(text) for text in stated.values() if text.isdecimal() and int(text)]


def refuse_numbers_of_others(path: str | Path, names: Sequence[str], stated: Mapping[str, str]) -> None:
    """Refuse a height of 1 m that counts a column, below a header that says that this one is no height.

    Only times, counters and degrees are such: tables may lack them, so nobody would miss the column.
    """
    others = {*COUNTERS, *GLOBAL_COLUMNS["lat"], *GLOBAL_COLUMNS["lon"]}
    for ours in stated.keys() & set(MAY_BE_CONSTANT):
        text = stated[ours]
        name = names[int(text) - 1] if text.isdecimal() and 1 <= int(text) <= len(names) else None
        if name is not None and text not in names and (name in others or header_of([name]).names == ("t",)):
            message = f"--columns {ours}={text}: expected a column of {ours}, found that column {text} is '{name}'"
            raise DataFormatError(path, f"{message}; a constant of {text} is {ours}={text}.0")


def position_columns(table: Table) -> tuple[str, str, str]:
    """The columns of a table that its positions come from."""
    if not (table.has("lat") or table.has("lon")):
        return POSITION_COLUMNS
    return "lat", "lon", "z" if table.has("z") and not table.has("alt") else "alt"


def warn_of_unused_times(table: Table) -> None:
    """Say so where a table has no column of times, but one whose name says that it holds some."""
    for name in () if table.has("t") else table.names:
        if header_of([name]).names == ("t",):
            words = "%s: has no column t, and '%s' is left out; if it holds the times: --columns t=%s"
            logger.warning(words, table.path, name, name)


def survey_arguments(
    table: Table, field_unit: FieldUnit, length_unit: LengthUnit, field_frame: FieldFrame, origin: str | None = None
) -> dict[str, Any]:
    """Arguments of `Survey`, by name: of a table's columns, times in s."""
    if field_frame not in get_args(FieldFrame):
        msg = f"field_frame: expected one of {', '.join(get_args(FieldFrame))}, got {found(field_frame)}"
        raise ConfigurationError(msg)
    tesla = size_of_unit(field_unit, TESLA_PER_UNIT, "field_unit")
    metre = size_of_unit(length_unit, METRE_PER_UNIT, "length_unit")
    names = position_columns(table)
    table.require([*names, *FIELD_COLUMNS])
    if table.has("t"):
        table.require_increasing("t")
    orientations, field = table.rotations(), table.stack(*FIELD_COLUMNS) * tesla
    if field_frame == "sensor":
        if orientations is None:
            message = "field_frame 'sensor' needs orientations: columns qx, qy, qz, qw, or a trajectory file"
            raise DataFormatError(table.path, message)
        field = orientations.apply(field)
    about = _about(table)
    if names == POSITION_COLUMNS:
        positions = table.stack(*names) * metre
    else:
        positions, about["frame"] = local_positions(table, metre, origin)
    samples = {"positions": positions, "field": field, "times": table.columns.get("t"), "orientations": orientations}
    return {**samples, "name": table.path.name, **about}


def local_positions(table: Table, metre: float, stated: str | None) -> tuple[Points, str]:
    """Places on the globe in metres about an origin, and what the frame is called."""
    lat, lon, height = table.columns["lat"], table.columns["lon"], table.columns[position_columns(table)[2]] * metre
    if wrong := what_is_wrong(lat, lon):
        raise DataFormatError(table.path, wrong, column="lat, lon")
    if look_like_radians(lat, lon):
        words = "expected degrees, found places at sea, such as %.6g, %.6g: radians? Multiply them by %.7f"
        logger.warning("%s: lat, lon: " + words, table.path, lat[0], lon[0], np.degrees(1))
    is_altitude = table.has("alt")
    origin = Origin.of(stated) if stated else Origin.near(lat[0], lon[0], height[0] if is_altitude else 0.0)
    if not stated:
        logger.warning(
            "%s: positions are metres east, north and up of latitude, longitude, altitude %s; give other files the "
            "same frame by --origin %s (in Python origin)",
            table.path, origin, origin,
        )  # fmt: skip
    if is_altitude:
        positions = local_east_north_up(lat, lon, height, origin)
    else:
        positions = np.column_stack([local_east_north(lat, lon, origin), height])
    return positions, frame_about(origin)


def frame_about(origin: Origin) -> str:
    """Name of the frame whose axes point east, north and up from an origin."""
    return f"{GLOBAL_FRAME}{origin}"


def origin_of(frame: str) -> str | None:
    """The origin that the name of a frame states."""
    return frame.removeprefix(GLOBAL_FRAME) if frame.startswith(GLOBAL_FRAME) else None


def stated_columns(columns: dict[str, Scalars], n: int, frame: str, pose_sd: float) -> dict[str, Scalars | list[str]]:
    """Columns of a file, with frame and accuracy of n samples where they are not the defaults."""
    stated: dict[str, Scalars | list[str]] = {**columns}
    if pose_sd:
        stated[ACCURACY_COLUMN] = np.full(n, pose_sd)
    if frame != DEFAULT_FRAME:
        plain = frame.isprintable() and frame == frame.strip() and frame[:1] not in ('"', "")
        stated[FRAME_COLUMN] = [frame if plain else json.dumps(frame)] * n
    return stated


def _about(table: Table) -> dict[str, Any]:
    """Frame and accuracy, where the file was written by `Survey.save`."""
    text = next((c.removeprefix(SCHEMA) for c in table.comments if c.startswith(SCHEMA)), "{}")
    named = ""
    for line, word in zip(table.line_numbers.tolist(), table.words.get(FRAME_COLUMN, ()), strict=False):
        if word and (named := named or word) != word:
            message = f"found {word[:40]!r} below {named[:40]!r}; a file holds one survey: split it"
            raise DataFormatError(table.path, message, line=line, column=FRAME_COLUMN)
    try:
        about = json.loads(text)
        frame = named or str(about.get("frame", DEFAULT_FRAME))
        pose_sd = float(about.get("pose_sd", 0.0))
    except (ValueError, TypeError, AttributeError):
        pose_sd = -1.0
    if not 0 <= pose_sd < np.inf:
        message = f'expected {SCHEMA} {{"frame": ..., "pose_sd": ...}} in its first comment'
        raise DataFormatError(table.path, f"{message}, found {text.strip()[:60]}")
    stated = table.columns.get(ACCURACY_COLUMN, np.array([pose_sd]))
    if stated.min() < 0 or np.ptp(stated):
        message = f"expected one standard deviation in m for all rows, found {stated.min():g} to {stated.max():g}"
        raise DataFormatError(table.path, message, column=ACCURACY_COLUMN)
    try:
        return {"frame": str(json.loads(frame)) if frame.startswith('"') else frame, "pose_sd": float(stated[0])}
    except ValueError:
        raise DataFormatError(table.path, f"expected a name, found {frame[:60]!r}", column=FRAME_COLUMN) from None
