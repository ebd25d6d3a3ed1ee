# SPDX-License-Identifier: BSD-3-Clause
"""``magmatch datasets``: public recordings, checksum-verified."""

from pathlib import Path

from typer import Argument, Option

from magmatch.cli.command import command
from magmatch.cli.narration import put, say
from magmatch.errors import ConfigurationError

EXAMPLES = (
    "magmatch datasets list",
    "magmatch datasets fetch kok",
    "magmatch datasets fetch cea --from ~/downloads/cea",
)


@command("datasets", EXAMPLES)
def datasets(
    action: str = Argument("list", help="list, or fetch with a NAME.", metavar="[list|fetch]"),
    name: str | None = Argument(None, help="Dataset to fetch.", metavar="[NAME]"),
    source: Path | None = Option(None, "--from", help="Copy from this folder instead of downloading.", metavar="DIR"),
) -> None:
    """List or fetch public recordings.

    Fetched files are verified. Licence and citation go to stderr, the paths of the files to stdout.
    """
    from magmatch.data.datasets import DATASETS, fetch, find_dataset

    if action == "list" and name is None and source is None:
        for dataset in DATASETS.values():
            put(f"{dataset.name:8}  {dataset.title}")
            put(f"{'':8}  licence: {dataset.licence}\n{'':8}  cite: {dataset.citation}")
    elif action == "fetch" and name is not None:
        dataset = find_dataset(name)
        for path in fetch(name, source).values():
            put(str(path))
        say(f"{dataset.title}\nLicence: {dataset.licence}\nPlease cite: {dataset.citation}")
    else:
        msg = f"datasets: expected 'list' or 'fetch NAME', found '{' '.join(w for w in (action, name) if w)}'"
        raise ConfigurationError(msg)
