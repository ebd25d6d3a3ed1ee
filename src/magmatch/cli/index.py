# SPDX-License-Identifier: BSD-3-Clause
"""``magmatch index``: compute once what every registration needs of a map."""

from pathlib import Path
from typing import Annotated

import typer

from magmatch.cli.command import command
from magmatch.cli.narration import say
from magmatch.cli.settings import registration_config

EXAMPLES = (
    "magmatch index building.map",
    "magmatch index buildings/",
)


@command("index", EXAMPLES)
def index(
    maps: Annotated[list[Path], typer.Argument(help="Saved maps, or folders of them.", metavar="MAP")],
    config: Annotated[Path | None, typer.Option(help="YAML file of settings that override the defaults.")] = None,
) -> None:
    """Prepare maps for many registrations.

    Writes MAP.index next to each map, so that 'magmatch register' need not repeat this work for each target. An index
    that is up to date is left alone; an outdated one is never used. 'register' itself indexes the maps of a folder,
    and stores what it computed from a single map.
    """
    from magmatch.cli.inputs import read_map
    from magmatch.registration.index.atlas import is_atlas, maps_in
    from magmatch.registration.index.map_index import index_path, make_index, open_index

    settings = registration_config("default", config)
    for path in [found for given in maps for found in (maps_in(given) if is_atlas(given) else (given,))]:
        kept = open_index(path, settings)
        if kept is None or not kept.is_whole:
            make_index(path, settings, read_map(path))
            say(f"Wrote {index_path(path)}")
        else:
            say(f"{index_path(path)} is up to date")
