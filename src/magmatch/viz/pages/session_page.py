# SPDX-License-Identifier: BSD-3-Clause
"""The report of slam or merge: the verdict, each log before and after, and where the graph is weak."""

from math import degrees
from pathlib import Path

import numpy as np

from magmatch.number_text import told
from magmatch.slam.result import SlamResult, SlamStatus
from magmatch.slam.session import Session
from magmatch.viz.figures.session_figures import session_figures, weakness_figure
from magmatch.viz.pages.page import (
    Section,
    again,
    bullets,
    figure_row,
    note,
    table,
    verdict,
    write_page,
)

# Most closures listed one by one, the least sure first.
MAX_LISTED = 40

NEXT_STEPS = {
    SlamStatus.CONNECTED: (
        "Use it: the .tum files hold the corrected poses, map.map the field, graph.g2o the graph for other programs.",
        "See below where the graph is weak: walk there again, across known places, to tie it.",
    ),
    SlamStatus.PARTLY_CONNECTED: (
        "Logs of other places belong apart. If they are of one place, let them share some stretches: a few lengths "
        "over which the field changes, in each log.",
        "Check units and --field-frame of a log that is tied to none; calibrate raw logs with 'magmatch prepare'.",
    ),
    SlamStatus.UNCHANGED: (
        "Pass some stretches twice. Walking a corridor there and back is enough.",
        "If places were passed twice, check --field-frame and units, and state the odometry's drift: --odometry-sd.",
    ),
}


def write_session_report(path: str | Path, session: Session, result: SlamResult, command: str) -> None:
    """Write one HTML page about a session; it works offline and on a phone."""
    sections = [_answer(result)]
    for k, logs in enumerate(session.components):
        names = ", ".join(session.names[log] for log in logs)
        sections.append(Section(f"Frame {k}: {names}", [figure_row(session_figures(session, k))]))
    sections.append(Section("Where the graph is weak", [figure_row([weakness_figure(session)])]))
    if result.closures:
        sections.append(_closures(result))
    if result.anchors:
        sections.append(_anchors(result))
    words = f"magmatch {result.version}. Same inputs and settings give the same result. Save them as settings.yaml."
    sections.append(again("Run it again", words, command, result.config))
    write_page(path, "magmatch: " + ", ".join(session.names), sections)


def _answer(result: SlamResult) -> Section:
    headline = result.status.replace("_", " ").capitalize()
    rows = [
        [
            log.name,
            str(log.component),
            f"{log.length:.1f} m",
            str(log.n_closures),
            f"{log.moved:.2f} m",
            f"{log.sd[0]:.2f} m, {degrees(log.sd[1]):.1f} deg",
        ]
        for log in result.logs
    ]
    return Section(
        "",
        [
            verdict(headline, result.reason, is_good=result.is_connected),
            "<h2 id='next'>What to do next</h2>",
            bullets(NEXT_STEPS[result.status]),
            table(rows, ["log", "frame", "path", "closures", "moved (rms)", "end known to"]),
        ],
    )


def _closures(result: SlamResult) -> Section:
    """Table of the closures, the least certain first."""
    listed = sorted(result.closures, key=lambda c: (c.weight, c.probability))[:MAX_LISTED]
    rows = [
        [
            f"{c.log_a}, {c.walked_a:.1f} m",
            f"{c.log_b}, {c.walked_b:.1f} m",
            f"{c.probability:.6f}",
            f"{c.weight:.4f}" if c.weight else "rejected",
        ]
        for c in listed
    ]
    words = f"{len(listed)} of {len(result.closures)}, the least sure first."
    return Section("Closures", [note(words), table(rows, ["at", "and at", "probability", "weight in the graph"])])


def _anchors(result: SlamResult) -> Section:
    """Farthest from where they should be first, in standard deviations."""
    off = [float(np.linalg.norm(a.off)) for a in result.anchors]
    order = sorted(range(len(off)), key=lambda k: -off[k] / result.anchors[k].sd)[:MAX_LISTED]
    rows = [
        [result.anchors[k].log, f"{told(result.anchors[k].t)} s", f"{off[k]:.3f} m", f"{result.anchors[k].sd:g} m"]
        for k in order
    ]
    words = (
        "Largest residual first. A residual far above its standard deviation means a wrong coordinate, time or log."
    )
    return Section("Fixed points", [note(words), table(rows, ["log", "at", "off by", "stated sd"])])
