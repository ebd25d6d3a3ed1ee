# SPDX-License-Identifier: BSD-3-Clause
"""``magmatch simulate``: two surveys of a simulated place, and the true transform between them."""

from pathlib import Path

from typer import Argument, Option

from magmatch.cli.command import command
from magmatch.cli.narration import say
from magmatch.cli.outputs import check_folder

EXAMPLES = ("magmatch simulate office --out pair --seed 3", "magmatch register pair/base.csv pair/target.csv")


@command("simulate", EXAMPLES)
def simulate(
    scenario: str = Argument(..., help="Name of a scenario; an unknown name lists all.", metavar="SCENARIO"),
    out: Path = Option(..., help="Folder to write base.csv, target.csv and truth.json to."),
    seed: int = Option(0, help="Same scenario and seed give the same surveys.", min=0),
) -> None:
    """Simulate two surveys of one place.

    Writes base.csv, target.csv and truth.json of the SCENARIO into a folder.
    """
    from magmatch.errors import ConfigurationError
    from magmatch.simulation.scenarios import SCENARIOS

    if scenario not in SCENARIOS:
        msg = f"no scenario '{scenario}'; there are {', '.join(SCENARIOS)}"
        raise ConfigurationError(msg)
    check_folder(out)
    from magmatch.simulation.simulate import simulate as run
    from magmatch.simulation.simulate import write_pair

    pair = run(scenario, seed)
    write_pair(pair, out)
    say(
        f"Wrote base.csv ({len(pair.base)} samples), target.csv ({len(pair.target)}) and truth.json to {out}; "
        f"a correct program {'accepts' if pair.accept else 'refuses'} this pair"
    )
