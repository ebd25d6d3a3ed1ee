# SPDX-License-Identifier: BSD-3-Clause
"""``magmatch serve``: a map, or a folder of maps, for many bodies at once."""

import signal
from pathlib import Path
from typing import Annotated, Any, Never

import typer

from magmatch.cli.command import command
from magmatch.cli.narration import say
from magmatch.cli.option_values import refuse, vertical
from magmatch.cli.settings import merged
from magmatch.errors import DataFormatError, import_extra

EXAMPLES = (
    "magmatch serve hall.map",
    "magmatch serve buildings/ --port 8200 --foxglove 8765",
    "magmatch serve hall.map --host 0.0.0.0 --token-file token.txt",
    "magmatch serve hall.map --token-file token.txt --origin https://maps.example.org",
    "magmatch serve buildings/ --workers dask://tcp://scheduler:8786 --config limits.yaml",
)
DASK = "dask://"


@command("serve", EXAMPLES)
def serve(
    place: Annotated[Path, typer.Argument(help="A saved map, or a folder of maps.", metavar="MAP|FOLDER")],
    host: Annotated[str, typer.Option(help="Address to listen on; any but this machine's own needs a token.")] = (
        "127.0.0.1"
    ),
    port: Annotated[int, typer.Option(help="Port to listen on; 0 takes any free one.")] = 8123,
    token_file: Annotated[Path | None, typer.Option(help="File with the token that every client must send.")] = None,
    origin: Annotated[
        list[str] | None, typer.Option(help="Origin of web pages that may connect, such as a reverse proxy's.")
    ] = None,
    states: Annotated[
        Path | None,
        typer.Option(help="Folder for the clients' states.  [default: MAP.clients, or .clients in FOLDER]"),
    ] = None,
    workers: Annotated[
        str | None,
        typer.Option(help="Number of processes for whole logs, or a Dask cluster: dask://SCHEDULER."),
    ] = None,
    foxglove: Annotated[int | None, typer.Option(help="Port for Foxglove on this machine.")] = None,
    planar: Annotated[bool, typer.Option("--planar", help="z is up, and all poses lie at one height.")] = False,
    no_gravity: Annotated[bool, typer.Option("--no-gravity", help="z of map and odometry is not up.")] = False,
    config: Annotated[
        Path | None, typer.Option(help="YAML file of settings: limits, and those of the localizer.")
    ] = None,
) -> None:
    """Localise many bodies in MAP over a network.

    Samples in and poses out over a WebSocket, whole logs by POST, and a page to watch. Ctrl-C ends
    the service; when it is started again, clients continue where they were.
    """
    from magmatch.data.tables.text import is_folder
    from magmatch_serve.config import ServeConfig
    from magmatch_serve.serve import serve as run

    if not place.exists():
        raise DataFormatError(place, "no such file or folder, expected a saved map or a folder of them")
    resolved = place.resolve()
    beside = resolved / ".clients" if is_folder(place) else resolved.with_name(f"{resolved.name}.clients")
    token = None if token_file is None else read_token(token_file)
    given = {
        "host": host, "port": port, "states": states or beside, "origins": tuple(origin or ()),
        "foxglove_port": foxglove, "token": token, **_workers(workers),
    }  # fmt: skip
    settings = merged(ServeConfig(**given), config)
    localizer = settings.localizer.model_copy(update=vertical(planar=planar, no_gravity=no_gravity))
    signal.signal(signal.SIGTERM, _end)
    say(f"Loading {place}")
    run(place, settings.model_copy(update={"localizer": localizer}), lambda url: say(f"Serving {place} at {url}"))


def _end(*_: Any) -> Never:
    """End as a command that is done: killed outright, it would leave the semaphores of its processes behind."""
    raise typer.Exit


def read_token(path: Path) -> str:
    """First line of a file."""
    try:
        lines = path.read_text(encoding="utf-8").strip().splitlines()
    except UnicodeDecodeError:
        raise DataFormatError(path, "expected a token of letters and digits, found other bytes") from None
    if not lines:
        raise DataFormatError(path, "expected a token on its first line, found nothing")
    return lines[0].strip()


def _workers(said: str | None) -> dict[str, object]:
    if said is None:
        return {}
    if said.startswith(DASK):
        import_extra("distributed", "a Dask cluster", "distributed")
        address = said.removeprefix(DASK)
        return {"dask": address if "://" in address else f"tcp://{address}"}
    if not said.isdecimal() or int(said) < 1:
        refuse("--workers", "a number of processes, or dask://SCHEDULER", said)
    return {"log_workers": int(said)}
