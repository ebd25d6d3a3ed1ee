# SPDX-License-Identifier: BSD-3-Clause
"""Run every block of the tutorials in an empty folder each and write what it prints into the block behind it.

Run: make tutorial, or python tests/run_tutorial.py PAGE.md
"""

import os
import re
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

PAGES = [Path(__file__).parents[1] / "docs" / name for name in ("tutorial.md", "floor.md")]
# A block of commands or Python, and the output right behind it.
BLOCK = re.compile(
    r'```(?P<language>sh|python)(?: title="(?P<title>[^"]+)")?\n(?P<code>.*?)```\n(?P<output>```text\n.*?```\n)?',
    re.DOTALL,
)
WORKED = {0, 3}  # 3: registered, not accepted


def main(names: Sequence[str]) -> None:
    for page in PAGES:
        if not names or page.name in names:
            with TemporaryDirectory() as folder:
                page.write_text(run_page(page.read_text(), Path(folder)))


def run_page(text: str, folder: Path) -> str:
    """Run the blocks of a page and give it with what they print now."""
    return BLOCK.sub(lambda block: run(block, folder), text)


def run(block: re.Match[str], folder: Path) -> str:
    """Run one block and give it with what it prints now."""
    whole, code = block[0], block["code"]
    if block["title"]:  # a file to be saved, which a later block runs
        (folder / block["title"]).write_text(code)
        return whole
    command = ["bash", "-c", code] if block["language"] == "sh" else [sys.executable, "-c", code]
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        command,
        cwd=folder,
        env=os.environ | {"PATH": path, "COLUMNS": "100"},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        check=False,
    )
    if done.returncode not in WORKED:
        sys.exit(f"{code}failed with exit code {done.returncode}:\n{done.stdout}")
    return whole if block["output"] is None else whole.removesuffix(block["output"]) + f"```text\n{done.stdout}```\n"


if __name__ == "__main__":
    main(sys.argv[1:])
