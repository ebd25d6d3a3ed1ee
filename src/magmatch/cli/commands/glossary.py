# SPDX-License-Identifier: BSD-3-Clause
"""``magmatch glossary``: the terms of messages and reports."""

from difflib import get_close_matches

from typer import Argument

from magmatch.cli.command import command
from magmatch.cli.narration import put
from magmatch.errors import ConfigurationError

EXAMPLES = ("magmatch glossary", "magmatch glossary nat", 'magmatch glossary "null model"')


@command("glossary", EXAMPLES)
def glossary(
    term: str | None = Argument(None, help="A term, or the beginning of one; all by default."),
) -> None:
    """Explain the terms in messages and reports."""
    from magmatch.glossary import terms

    wanted = (term or "").lower()
    found = {name: said for name, said in terms().items() if name.lower().startswith(wanted)}
    if not found:
        near = get_close_matches(wanted, [name.lower() for name in terms()], n=1)
        advice = f"did you mean '{near[0]}'?" if near else f"there are {', '.join(terms())}"
        msg = f"no term '{term}'; {advice}"
        raise ConfigurationError(msg)
    put("\n\n".join(f"{name}\n  {said}" for name, said in found.items()))
