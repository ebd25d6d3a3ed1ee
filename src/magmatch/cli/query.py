# SPDX-License-Identifier: BSD-3-Clause
"""``magmatch query``: what a map says at points."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from magmatch.cli.command import Layouts, command
from magmatch.cli.inputs import read_map
from magmatch.cli.narration import say
from magmatch.cli.outputs import check_outputs

if TYPE_CHECKING:
    import numpy as np

    from magmatch.field.map import FieldMap

EXAMPLES = (
    "magmatch query room.map points.csv --out field.csv",
    "magmatch query room.map points.csv --length-unit mm --gradient --out field.csv",
)
# Points evaluated at a time; bounds the memory whatever the number of points.
CHUNK = 20_000


@command("query", EXAMPLES)
def query(
    field_map: Annotated[Path, typer.Argument(help="Saved map.", metavar="MAP")],
    points: Annotated[
        Path, typer.Argument(help="CSV with columns x, y, z in the map's frame.", metavar="POINTS.csv")
    ],
    out: Annotated[Path, typer.Option(help="Write here (CSV).")],
    length_unit: Annotated[str, typer.Option(help="Unit of the points: m|cm|mm.")] = "m",
    gradient: Annotated[bool, typer.Option("--gradient", help="Add the field's gradient, T/m.")] = False,
) -> None:
    """Write MAP's field at given points.

    Columns x,y,z (m), bx,by,bz (T) and the standard deviations sx,sy,sz (T) of the noise-free field, in input order.
    Points where the map does not know the field get the prior's large standard deviation.
    """
    from magmatch.data.formats.csv import read_points
    from magmatch.data.tables.table import write_table

    check_outputs((out,), inputs=(field_map, points))
    p_map = read_points(points, Layouts({("", "length_unit"): length_unit}).of())
    loaded = read_map(field_map)
    table = evaluate(loaded, p_map, with_gradient=gradient)
    write_table(out, table)
    n_known = int(loaded.knows(p_map).sum())
    say(f"Wrote {len(p_map)} points to {out}; the map knows the field at {n_known} of them")


def evaluate(field_map: "FieldMap", p_map: "np.ndarray", *, with_gradient: bool) -> "dict[str, np.ndarray]":
    """Columns of the answer, in the points' order."""
    import numpy as np

    parts = []
    for start in range(0, len(p_map), CHUNK):
        p = p_map[start : start + CHUNK]
        values = field_map.evaluate(p, order=1 if with_gradient else 0)
        sd = np.sqrt(np.maximum(np.diagonal(field_map.covariance(p), axis1=1, axis2=2), 0))
        blocks = [p, values.field, sd]
        if values.gradient is not None:
            blocks.append(values.gradient.reshape(-1, 9))
        parts.append(np.concatenate(blocks, axis=1))
    names = ["x", "y", "z", "bx", "by", "bz", "sx", "sy", "sz"]
    names += [f"b{a}{b}" for a in "xyz" for b in "xyz"] if with_gradient else []
    return dict(zip(names, np.concatenate(parts).T, strict=True))
