# SPDX-License-Identifier: BSD-3-Clause
"""`slam`: logs whose poses drift in, corrected logs in one frame out."""

from collections.abc import Sequence
from pathlib import Path

from magmatch.arguments import expect_kind
from magmatch.data.checks import require_survey
from magmatch.data.survey import Survey
from magmatch.progress import Progress
from magmatch.runner import Workers
from magmatch.slam.config import SlamConfig
from magmatch.slam.graph.anchors import Anchor
from magmatch.slam.session import Session


def slam(
    logs: Survey | Sequence[Survey],
    config: SlamConfig | None = None,
    *,
    anchors: Sequence[Anchor] | str | Path = (),
    waypoints: bool = True,
    run: Workers | None = None,
    progress: Progress | None = None,
    keep: str | Path | None = None,
) -> Session:
    """Correct the drift of logs by the magnetic field, and bring them into one frame.

    Parameters
    ----------
    logs : Survey or sequence of Survey
        Each with positions from odometry, in its own frame; the field in that frame.
    config : SlamConfig, optional
    anchors : sequence of Anchor, or path, optional
        Fixed points, or a table of them (``log,t,x,y,z,sd``, or ``lat,lon`` for ``x,y``). If they determine the
        frame, the logs that they fix are in it.
    waypoints : bool
        Points that the logs hold themselves are fixed points too.
    run : callable, optional
        Lets other processes make and compare submaps, such as `magmatch.DaskRunner`: called with a function
        and tasks, which can be pickled, it gives the results in the tasks' order. By default this process does all
        of it; it makes submaps on the cores that are free. The result is the same bit for bit.
    progress : callable, optional
        Called with the current step and the fraction done; see `magmatch.progress`.
    keep : path, optional
        Folder for intermediate results. After an interruption, the same call resumes from there, with the same
        result bit for bit; it can be deleted afterwards.

    Returns
    -------
    Session
        Corrected trajectories with their closures; unconnected logs stay in components of their own.

    Raises
    ------
    SurveyError
        A log holds NaN, impossible values or too few samples.
    DataFormatError, ConfigurationError
        The table holds no fixed points, or one that no log passed; says which and why.
    """
    logs = [logs] if isinstance(logs, Survey) else logs
    # A path or a DataFrame has parts, too, but none that is a log.
    if isinstance(logs, str) or hasattr(logs, "columns") or not hasattr(logs, "__iter__"):
        require_survey(logs, name="logs")
    config, given = config or SlamConfig(), list(logs)
    expect_kind(config, "config", (SlamConfig,))
    if not given:
        msg = "expected at least one log, got none"
        raise ValueError(msg)
    session = Session(config)
    session.add_logs(given, anchors, waypoints=waypoints, run=run, progress=progress, keep=keep)
    return session
