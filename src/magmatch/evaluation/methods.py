# SPDX-License-Identifier: BSD-3-Clause
"""The methods that are compared."""

from magmatch.evaluation.method import Method, Preset
from magmatch.registration.config import PRESETS

METHODS: dict[str, Method] = {
    method.name: method
    for method in (
        Preset("default", "this package's method", PRESETS["default"]),
        Preset("paper", "the published method (Mag-Match), corrections of docs/theory.md", PRESETS["paper"]),
    )
}
