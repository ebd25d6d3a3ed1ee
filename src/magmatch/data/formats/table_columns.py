# SPDX-License-Identifier: BSD-3-Clause
"""Columns of a survey in a text table, and what to do about a table that lacks them."""

import logging
import re
from collections.abc import Sequence
from pathlib import Path

from magmatch.data.formats.format import SurveyFormat
from magmatch.data.survey_columns import (
    COLUMNS,
    FIELD_COLUMNS,
    FRAME_COLUMN,
    POSITION_COLUMNS,
    ChosenColumns,
    choose_columns,
    column_numbers,
    refuse_numbers_of_others,
)
from magmatch.data.tables.header_names import header_of
from magmatch.data.tables.table import Table, Wanted, read_table
from magmatch.data.tables.text_rows import is_sample
from magmatch.data.units import DIGITS_OF_SECOND

logger = logging.getLogger(__name__)


def read_columns(path: str | Path, layout: SurveyFormat) -> tuple[Table, ChosenColumns]:
    """Read the columns of a survey from a CSV, by the file's names; and which is which."""
    stated, has_poses = layout.stated_columns(), layout.trajectory is None

    def choose(names: Sequence[str]) -> ChosenColumns:
        return choose_columns(path, names, stated, has_poses=has_poses)

    wanted = Wanted(
        (*stated.values(), *COLUMNS),
        words=(FRAME_COLUMN,),
        choose=lambda names: choose(names).ours,
        numbered=column_numbers(stated),
        check_numbered=lambda names: refuse_numbers_of_others(path, names, stated),
        decimal=layout.decimal or "",
        digits={"t": DIGITS_OF_SECOND[layout.time_unit]},
        recover=layout.recover,
        advise=advice_for,
    )
    table = read_table(path, wanted)
    chosen = choose(table.names)
    _warn_of_units(path, chosen, layout)
    return table, chosen


def _warn_of_units(path: str | Path, chosen: ChosenColumns, layout: SurveyFormat) -> None:
    """Say so where the name of a column states another unit than the one that it is read in."""
    read_in: dict[str, str] = {"t": layout.time_unit} if layout.rate is None else {}
    read_in |= dict.fromkeys(POSITION_COLUMNS, layout.length_unit) | dict.fromkeys(FIELD_COLUMNS, layout.field_unit)
    for theirs, ours in chosen.ours.items():
        stated = next(iter(header_of([theirs]).units.values()), read_in.get(ours))
        if ours in read_in and stated != read_in[ours]:
            option = "time" if ours == "t" else "length" if ours in POSITION_COLUMNS else "field"
            words = "%s: column '%s' is read in %s: is that what its name means? (--%s-unit %s)"
            logger.warning(words, path, theirs, read_in[ours], option, stated)


def advice_for(names: Sequence[str]) -> str:
    """Advise about a table without the columns of a survey, from the names it has."""
    if names and all(map(is_sample, names)):
        pairs = "t=1,x=2,y=3,z=4,bx=5,by=6,bz=7" if len(names) > 6 else "t=1,bx=2,by=3,bz=4"
        return f"Without a header, say which column is which, counted from 1: --columns {pairs}"
    if len(names) == 1 and (mark := re.search(r"[^\w\s.()\[\]\"'/^-]", names[0])):
        return f"If '{mark[0]}' separates the columns, write sep={mark[0]} in a line above"
    if all(any(name.startswith(part) for name in names) for part in ("lat", "lon")):
        return "Where they have other names: --columns lat=THEIRS,lon=...,bx=..."
    return "Where they have other names: --columns x=THEIRS,y=...,bx=..."
