# SPDX-License-Identifier: BSD-3-Clause
"""No setting lies: changing it changes an answer, or raises."""

from collections.abc import Iterator
from functools import cache
from typing import Any

import numpy as np
import pytest
from pydantic import BaseModel, ValidationError

from magmatch.errors import MagmatchError
from magmatch.registration.config import PRESETS, RegistrationConfig
from magmatch.registration.register import register
from magmatch.simulation.config import SimulationConfig
from magmatch.simulation.simulate import simulate
