# SPDX-License-Identifier: BSD-3-Clause
"""Run every block of the tutorial in an empty folder and write what it prints into the block behind it.

Run: make tutorial
"""

import os
import re
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

TUTORIAL = Path(__file__).parents[1] / "docs" / "tutorial.md"
# A block of commands or Python, and the output right behind it.
BLOCK = re.compile(
    r'```(?P<language>sh|python)(?: title="(?P<title>[^"]+)")?\n(?P<code>.*?)```\n(?P<output>```text\n.*?```\n)?',
    re.DOTALL,
)
WORKED = {0, 3}  # 3: registered, not accepted


def main() -> None:
    with TemporaryDirectory() as folder:
        TUTORIAL.write_text(BLOCK.sub(lambda block: run(block, Path(folder)), TUTORIAL.read_text()))


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
    main()
