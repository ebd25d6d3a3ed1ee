# SPDX-License-Identifier: BSD-3-Clause
"""``magmatch convert``: surveys, maps and results in the formats of other programs."""

from collections.abc import Iterable
from pathlib import Path

from typer import Argument, Option

from magmatch.cli.command import G2O_ROTATION, G2oRotation, Layouts, command
from magmatch.cli.inputs import read_map, read_result, read_samples
from magmatch.cli.narration import say
from magmatch.cli.option_values import numbers, refuse
from magmatch.cli.outputs import check_outputs
from magmatch.errors import ConfigurationError, DataFormatError, SurveyError
from magmatch.number_text import told

EXAMPLES = (
    "magmatch convert drive.mcap survey.csv",
    "magmatch convert drive.bag poses.tum",
    "magmatch convert survey.csv --field-unit uT survey.parquet",
    "magmatch convert room.map room.vtk --spacing 0.1",
    "magmatch convert room.map slice.nc --slice z=1.0",
    "magmatch convert result.json edge.g2o",
    "magmatch convert result.json static_transform.yaml --frames map,map_monday",
)
MAP_GRIDS = (".vtk", ".ply", ".nc")
RESULTS = (".tum", ".g2o", ".yaml")


@command("convert", EXAMPLES, surveys=(), reads="INPUT")
def convert(
    layouts: Layouts,
    source: Path = Argument(..., help="Survey, log, trajectory, saved map or result.", metavar="INPUT"),
    out: Path = Argument(
        ...,
        help="The suffix chooses the format. Survey: .csv .parquet .mcap .tum .ply .vtk; map: .vtk .ply .nc, or "
        "as a survey its samples; result: .tum .g2o .yaml; trajectory: .tum.",
        metavar="OUTPUT",
    ),
    spacing: float | None = Option(None, help="Grid spacing for a map, metres.", min=1e-6),
    cut: str | None = Option(None, "--slice", help="One slice of a map, such as z=1.0 (metres)."),
    frames: str = Option("base,target", help="Names of base and target in a static transform."),
    g2o_rotation: G2oRotation = G2O_ROTATION,
) -> None:
    """Write INPUT in another format, chosen by the suffix of OUTPUT."""
    from magmatch.data.formats.load_trajectory import load_trajectory
    from magmatch.data.formats.sniff import sniff
    from magmatch.data.write import SURVEY_WRITERS

    check_outputs((out,), inputs=(source,))
    kind, suffix = sniff(source), out.suffix.lower()
    if kind == "registration":
        _write_result(source, out, suffix, frames, g2o_rotation)
    elif kind == "map" and suffix in MAP_GRIDS:
        _write_grid(source, out, suffix, spacing, cut)
    elif kind in {"tum", "euroc"} and suffix == ".tum":
        layout = layouts.of()
        load_trajectory(source, layout, layout.time_unit).save(out)
    elif suffix in SURVEY_WRITERS:
        SURVEY_WRITERS[suffix](read_samples(source, layouts), out)
    else:
        raise _unknown_ending(out, dict.fromkeys((*SURVEY_WRITERS, *(MAP_GRIDS if kind == "map" else ()))))
    say(f"Wrote {out}")


def _write_grid(source: Path, out: Path, suffix: str, spacing: float | None, cut: str | None) -> None:
    from magmatch.field.axis_grid import map_on_grid, write_netcdf, write_ply_cloud, write_vtk

    field_map = read_map(source)
    chosen = None if cut is None else parse_slice(cut)
    grid = map_on_grid(field_map, spacing, chosen)
    if suffix == ".nc":
        write_netcdf(grid, out, field_map.survey.frame)
    else:
        (write_vtk if suffix == ".vtk" else write_ply_cloud)(grid, out)
    n_known = int(grid.is_known.sum())
    size = " x ".join(str(len(axis)) for axis in grid.axes)
    say(f"Grid of {size} points, {grid.spacing:.4g} m apart; the map knows the field at {n_known} of them")
    if chosen is not None and not n_known:
        axis, at = chosen
        along = field_map.survey.positions[:, "xyz".index(axis)]
        between = f"{axis} between {along.min():.2f} and {along.max():.2f} m"
        say(f"warning: --slice: expected {between}, where the samples are; found {at:g}: the map knows nothing there")


def _write_result(source: Path, out: Path, suffix: str, frames: str, g2o_rotation: G2oRotation) -> None:
    from magmatch.registration import to_other_programs as other

    names = [name.strip() for name in frames.split(",")]
    if len(names) != 2 or not all(names):
        refuse("--frames", "two names such as map,map_monday", frames)
    if suffix not in RESULTS:
        raise _unknown_ending(out, RESULTS)
    result = read_result(source)
    try:
        if suffix == ".tum":
            other.write_relative_tum(result, out)
        elif suffix == ".g2o":
            other.write_g2o(result, out, g2o_rotation)
            for k, (side, at) in enumerate(zip(("base", "target"), other.vertices_of(result), strict=True)):
                if at.any():
                    say(f"Vertex {k} stands at {', '.join(told(v) for v in at)} m of the {side}, near its samples")
        else:
            other.write_static_transform(result, out, *names)
    except SurveyError as error:
        raise DataFormatError(source, str(error)) from None


def parse_slice(text: str) -> tuple[str, float]:
    """Axis and coordinate of a slice."""
    expected = "an axis and a coordinate in metres such as z=1.0"
    axis, _, number = (part.strip() for part in text.partition("="))
    (value,) = numbers("--slice", number, 1, expected)
    if axis not in {"x", "y", "z"} or abs(value) >= 1e9:
        refuse("--slice", expected, text)
    return axis, value


def _unknown_ending(out: Path, known: Iterable[str]) -> ConfigurationError:
    return ConfigurationError(f"{out}: expected a name that ends in {', '.join(known)}")
