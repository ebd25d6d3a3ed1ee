# SPDX-License-Identifier: BSD-3-Clause
"""Settings of the service: where it listens, whom it answers, and the bounds of what it takes."""

import re
from pathlib import Path
from urllib.parse import urlsplit

from pydantic import Field, field_validator, model_validator

from magmatch.localization.config import LocalizerConfig
from magmatch.settings import Settings

LOOPBACK = ("127.0.0.1", "::1", "localhost")
# A token has to hold this so that nobody guesses it.
LEAST_TOKEN = 16
TOKEN = re.compile(rf"[A-Za-z0-9._~-]{{{LEAST_TOKEN},}}")


class ServeConfig(Settings):
    """Everything that shapes the service; bounds are stated in docs/serve.md."""

    # Where it listens. Other machines reach it only where a token is set.
    host: str = "127.0.0.1"
    port: int = Field(default=8123, ge=0, le=65535)
    # A token that every client has to know.
    token: str | None = None
    # Web pages from elsewhere that may ask, such as https://maps.example.org: that of a reverse proxy.
    origins: tuple[str, ...] = ()
    # Where states are kept, and for how long after a client's last sample, s.
    states: Path
    keep: float = Field(default=86400.0, gt=0)
    # Seconds of samples that a crash may cost.
    checkpoint_every: float = Field(default=5.0, gt=0)
    # Processes that follow clients, and those that work on whole logs.
    trackers: int = Field(default=2, ge=1)
    log_workers: int = Field(default=1, ge=1)
    # Scheduler of a Dask cluster that works on whole logs instead, such as tcp://host:8786.
    dask: str | None = None
    # Connected clients, and states in memory a tracker (about 0.3 MB each).
    max_clients: int = Field(default=200, ge=1)
    # Samples a second and client: what comes faster waits. A magnetometer gives 100 at most.
    max_rate: float = Field(default=200.0, gt=0)
    # Bytes of one message, samples in it, and messages of a client that are under way at once.
    max_message: int = Field(default=65_536, ge=256)
    max_samples: int = Field(default=500, ge=1)
    max_under_way: int = Field(default=64, ge=1)
    # Bytes of a request's body, as sent and unpacked; samples of a log; seconds to send it, and to work on it.
    max_body: int = Field(default=64 << 20, ge=1)
    max_unpacked: int = Field(default=256 << 20, ge=1)
    # Memory that reading a log may take, which the operating system bounds.
    max_reading: int = Field(default=1 << 30, ge=1)
    max_log: int = Field(default=200_000, ge=1)
    max_upload_time: float = Field(default=60.0, gt=0)
    max_work_time: float = Field(default=600.0, gt=0)
    # Logs that come, wait or are worked on; requests a minute and address, and connections a minute and address.
    max_logs: int = Field(default=8, ge=1)
    max_requests: float = Field(default=600.0, gt=0)
    max_connects: float = Field(default=1200.0, gt=0)
    # Messages of a client that could not be read before it is sent away; one a second is forgiven.
    max_mistakes: int = Field(default=50, ge=1)
    # Seconds until a client has to have introduced itself, sent a request, or taken something of an answer.
    patience: float = Field(default=10.0, gt=0)
    # Seconds between two looks at the folder of maps, and between two pictures of the page.
    look_every: float = Field(default=2.0, gt=0)
    draw_every: float = Field(default=0.25, gt=0)
    # Port of Foxglove's protocol on this machine, for ROS users' viewers; none unless given.
    foxglove_port: int | None = Field(default=None, ge=0, le=65535)
    localizer: LocalizerConfig = Field(default_factory=LocalizerConfig)

    @field_validator("token")
    @classmethod
    def _is_hard_to_guess(cls, token: str | None) -> str | None:
        # Not said back: words of a command that fails are kept in logs.
        if token is not None and not TOKEN.fullmatch(token):
            msg = f"expected at least {LEAST_TOKEN} letters, digits or . _ ~ -, found {len(token)} characters"
            raise ValueError(msg)
        return token

    @field_validator("origins")
    @classmethod
    def _are_origins(cls, origins: tuple[str, ...]) -> tuple[str, ...]:
        for one in origins:
            parts = urlsplit(one)
            if parts.scheme not in {"http", "https"} or not parts.netloc or one != f"{parts.scheme}://{parts.netloc}":
                msg = f"expected an origin such as https://maps.example.org, found '{one}'"
                raise ValueError(msg)
        return origins

    @model_validator(mode="after")
    def _needs_token(self) -> "ServeConfig":
        if self.host not in LOOPBACK and self.token is None:
            msg = (
                f"host: {self.host} can be reached from other machines, which needs a token: write one of at least "
                f"{LEAST_TOKEN} characters to a file and say --token-file FILE"
            )
            raise ValueError(msg)
        return self
