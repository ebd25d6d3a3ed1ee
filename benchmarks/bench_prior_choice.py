# SPDX-License-Identifier: BSD-3-Clause
"""What the choice of a prior costs: maps with defaults (`auto`) against maps with `--prior spline`, as ratios.

    python benchmarks/bench_prior_choice.py --from DIR [--rows training test ...]

Processor seconds of `build_map` for walks of the CEA building, the two in turns after a first that compiles.
"""

from collections.abc import Iterator

from magmatch.data.recordings import load_recordings
from magmatch.field.build import build_map
from magmatch.field.config import FieldConfig
from magmatch_evaluation.script import arguments, timed


def measured(asked) -> Iterator[str]:
    """One line for each walk."""
    for name, survey in load_recordings("cea", asked.recordings).items():
        if name not in asked.rows:
            continue
        seconds = {"spline": [], "auto": []}
        for _ in range(asked.rounds):
            for prior, spent in seconds.items():
                built, _, cpu = timed(build_map, survey, FieldConfig(prior=prior))
                spent.append(cpu)
        spline, auto = (min(spent) for spent in seconds.values())
        yield (
            f"{name:16s} {len(survey):6d} samples  spline {spline:.1f} s  auto {auto:.1f} s ({built.config.prior})  "
            f"ratio {auto / spline:.2f}"
        )


def main() -> None:
    """Print the table."""
    asked = arguments(__doc__, recordings=None, rows=["training"], rounds=3)
    for line in measured(asked):
        print(line, flush=True)


if __name__ == "__main__":
    main()
