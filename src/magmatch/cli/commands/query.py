# SPDX-License-Identifier: BSD-3-Clause
"""``magmatch query``: evaluate a map at points."""

from pathlib import Path

from typer import Argument, Option

from magmatch.cli.command import Layouts, command
from magmatch.cli.inputs import read_map
from magmatch.cli.narration import say
from magmatch.cli.outputs import check_outputs
from magmatch.data.units import LengthUnit

EXAMPLES = (
    "magmatch query room.map points.csv --out field.csv",
    "magmatch query room.map points.csv --length-unit mm --gradient --out field.csv",
)


@command("query", EXAMPLES)
def query(
    field_map: Path = Argument(..., help="Saved map.", metavar="MAP"),
    points: Path = Argument(
        ...,
        help="CSV with columns x, y, z in the map's frame; or lat, lon, alt, if it is about an origin.",
        metavar="POINTS.csv",
    ),
    out: Path = Option(..., help="Write here (CSV)."),
    length_unit: LengthUnit = Option("m", help="POINTS.csv: unit of the points."),
    gradient: bool = Option(False, "--gradient", help="Add the field's gradient, T/m."),
) -> None:
    """Write MAP's field at given points.

    The columns are x,y,z (m), bx,by,bz (T) and the standard deviations sx,sy,sz (T) of the noise-free field, in input
    order. Points where the map does not know the field have the prior's large standard deviation.
    """
    from magmatch.data.formats.csv import read_points
    from magmatch.data.survey_columns import origin_of
    from magmatch.data.tables.table import write_table
    from magmatch.field.query import query_map
    from magmatch.number_text import many
    from magmatch.preparation.odometry.drift import height_of

    check_outputs((out,), inputs=(field_map, points))
    loaded = read_map(field_map)  # first: what is swapped is no map
    stated = {("", "length_unit"): length_unit, ("", "origin"): origin_of(loaded.survey.frame)}
    p_map = read_points(points, Layouts(stated).of(), height_of([loaded.survey]))
    table = query_map(loaded, p_map, with_gradient=gradient)
    write_table(out, table)
    n_known = int(loaded.knows(p_map).sum())
    say(f"Wrote {many(len(p_map), 'point')} to {out}; the map knows the field at {n_known} of them")
