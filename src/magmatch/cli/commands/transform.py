# SPDX-License-Identifier: BSD-3-Clause
"""``magmatch transform``: bring the target into the base's frame."""

from pathlib import Path

from typer import Argument, Option

from magmatch.cli.command import Layouts, command
from magmatch.cli.inputs import is_map, read_map, read_result, read_samples
from magmatch.cli.narration import say
from magmatch.cli.outputs import check_outputs
from magmatch.errors import DataFormatError

EXAMPLES = (
    "magmatch transform target.csv --by result.json --out aligned.csv",
    "magmatch transform target.map --by result.json --out aligned.map",
)


@command("transform", EXAMPLES, surveys=("target",), reads="TARGET")
def transform(
    layouts: Layouts,
    target: Path = Argument(..., help="Survey or saved map.", metavar="TARGET"),
    by: Path = Option(..., help="Result of 'magmatch register' (JSON)."),
    out: Path = Option(..., help="Write here: CSV in tesla and metre, or a map if TARGET is one."),
) -> None:
    """Write TARGET in the base's frame.

    Positions are transformed, field vectors rotated. A saved map stays a map, unless OUT ends in .csv: then its
    samples are written.
    """
    check_outputs((out,), inputs=(target, by))
    result = read_result(by)
    if result.T_base_target is None:
        message = f"was not accepted ({result.status}), so there is no transform to apply: {result.reason}"
        raise DataFormatError(by, message)
    if out.suffix.lower() != ".csv" and is_map(target, layouts, "target"):
        read_map(target).transformed(result.T_base_target).save(out)
        say(f"Wrote the map in the base's frame to {out}")
        return
    survey = read_samples(target, layouts, "target")
    survey.transformed(result.T_base_target, frame="base").save(out)
    say(f"Wrote {len(survey)} samples in the base's frame to {out} (metre, tesla)")
