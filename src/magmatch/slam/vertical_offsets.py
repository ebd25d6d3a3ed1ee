# SPDX-License-Identifier: BSD-3-Clause
"""Level logs whose magnetometers differ along the vertical: another look at those that nothing connects.

Hard iron along the vertical is a constant in the field of a level log, so no log of its own shows it, and where it
differs the windows of one log match no other log. The medians of the vertical fields say by how much, up to how the
places that both passed differ. The rest is solved with the map.
"""

import logging
from collections.abc import Callable, Iterable, Sequence

import numpy as np

from magmatch.data.units import field_text
from magmatch.slam.loop_closer import LoopCloser
from magmatch.slam.windows import Path

logger = logging.getLogger(__name__)

# Searches for closures of some logs.
Look = Callable[[LoopCloser, Sequence[Path]], None]


def with_vertical_offsets(closer: LoopCloser, look: Look, first: int = 0) -> LoopCloser:
    """A closer whose logs are connected once their vertical fields are alike in the median; or ``closer``.

    Asked of logs from the ``first`` on. Those that share a frame are shifted together, and only what this connects to
    earlier logs stays so.
    """
    asked = set[int]()
    for log in range(first, len(closer.places.paths) if closer.places.stated.is_gravity_aligned else 0):
        places, frames = closer.places, closer.places.graph.frames()
        path, others = places.paths[log], places.others(places.paths[log])
        if not others or frames[log] in asked:
            continue
        asked.add(int(frames[log]))
        mine = np.flatnonzero(frames == frames[log]).tolist()
        offset = _vertical([places.paths[k] for k in mine]) - _vertical(others)
        again = LoopCloser(places.without_vertical(mine, offset), closer.search.run)
        look(again, [again.places.paths[k] for k in mine])
        if len(np.unique(again.places.graph.frames())) < len(np.unique(frames)):
            words = "%s: its sensor differs by %s along the vertical from those before it, which is taken out"
            logger.warning(words, path.survey.name, field_text(offset))
            closer = again
    return closer


def _vertical(paths: Iterable[Path]) -> float:
    """The vertical field of some logs, T: its median, since a magnet would pull a mean."""
    return float(np.median(np.concatenate([path.survey.field[:, 2] for path in paths])))
