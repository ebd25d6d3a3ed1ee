# SPDX-License-Identifier: BSD-3-Clause
"""One body as a tracker follows it: its localizer, what was said last, and where it was."""

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from magmatch.localization.config import LocalizerConfig
from magmatch.localization.estimate import LocalizerStatus, PoseEstimate
from magmatch.localization.kept_state import KINDS, restored, state_of
from magmatch.localization.known_places import KnownPlaces
from magmatch.localization.localizer import Localizer
from magmatch.store import dumps, loads
from magmatch_serve.messages import read_samples, write_pose
from magmatch_serve.refusals import RefusedError

# Places of its past that a picture shows, and path between two, m.
MAX_TRAIL, TRAIL_STEP = 200, 0.1
MAX_HYPOTHESES = 8
SCHEMA = "magmatch.client/1"
NOTHING = PoseEstimate(LocalizerStatus.SEARCHING, "no sample has come yet")


@dataclass(eq=False, slots=True)
class Body:
    """A client's body."""

    known: KnownPlaces
    config: LocalizerConfig
    # The localizer is made for the first sample: a client that only connects costs nothing.
    localizer: Localizer | None = None
    name: str = ""
    is_binary: bool = False
    n: int = 0  # samples taken
    t: float | None = None
    now: PoseEstimate = NOTHING
    is_kept: bool = True  # whether its last state is on the disk
    left_at: float | None = None  # s: when its client left
    trail: deque[tuple[float, float, str]] = field(default_factory=lambda: deque(maxlen=MAX_TRAIL))

    @classmethod
    def resumed(cls, known: KnownPlaces, config: LocalizerConfig, state: bytes) -> "Body | None":
        """Continue from a kept state; None where that is of other maps, settings or another version."""
        try:
            about = loads(state, SCHEMA, KINDS)
            localizer = restored(known, config, about["localizer"])
        except ValueError:
            return None
        return cls(known, config, localizer, about["name"], n=about["n"], t=about["t"], now=localizer.estimate())

    def state(self) -> bytes:
        """Give all that a restart shall not lose."""
        assert self.localizer is not None
        about = {"name": self.name, "n": self.n, "t": self.t, "localizer": state_of(self.localizer)}
        return dumps(SCHEMA, about)

    def take(self, message: str | bytes, most: int, *, may_search: Callable[[], bool] = lambda: True) -> str | bytes:
        """Take the samples of a message; gives the answer."""
        times, poses, field = read_samples(message, most)
        localizer = self.localizer = self.localizer or Localizer(self.known, self.config)
        for k, t in enumerate(times.tolist()):
            try:
                localizer.update_by_matrix(t, poses[k], field[k], may_search=may_search)
            except ValueError as error:
                place = f"sample {k}: " if len(times) > 1 else ""
                raise RefusedError(422, place + str(error)) from None
            self.n, self.t, self.is_kept = self.n + 1, t, False
        self.now = localizer.estimate()
        self._remember()
        return write_pose(self.n, self.t or 0.0, self.now, binary=self.is_binary)

    def move_on(self, known: KnownPlaces) -> None:
        """Begin anew in newer maps, unless what is known in the older ones is worth to be kept."""
        if self.known is not known and not self.now.is_stated:
            self.known, self.localizer = known, None

    def _remember(self) -> None:
        if self.now.matrix is None:
            return
        x, y = self.now.matrix[:2, 3].tolist()
        if not self.trail or math.hypot(x - self.trail[-1][0], y - self.trail[-1][1]) > TRAIL_STEP:
            self.trail.append((x, y, self.now.map or ""))

    def picture(self, client: str, *, with_trail: bool) -> dict[str, Any]:
        """Give what the page draws of it, in the map's frame, seen from above."""
        now = self.now
        said: dict[str, Any] = {
            "client": client[:8], "name": self.name, "is_here": self.left_at is None, "status": now.status.value,
            "reason": now.reason, "probability": now.probability, "map": now.map, "t": self.t, "n": self.n,
        }  # fmt: skip
        if now.matrix is not None and now.covariance is not None:
            T = now.matrix
            R, C = T[:3, :3], now.covariance[3:, 3:]
            said |= {"T_map_body": T.tolist(), "covariance_xy": (R @ C @ R.T)[:2, :2].tolist()}
        elif self.localizer is not None:
            said["hypotheses"] = [
                [h.map, *h.T_map_body.translation.tolist(), h.probability]
                for h in self.localizer.hypotheses()[:MAX_HYPOTHESES]
            ]
        if with_trail:
            said["trail"] = list(self.trail)
        return said
