# SPDX-License-Identifier: BSD-3-Clause
"""Register magnetic surveys: two maps of one place in, one SE(3) transform and its certainty out.

Names are resolved on first use, so that importing the package costs nothing until work begins.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from magmatch._version import __version__ as __version__

if TYPE_CHECKING:
    from magmatch.atlas.atlas import Atlas, open_atlas
    from magmatch.atlas.localize import localize
    from magmatch.data.read import read_survey
    from magmatch.data.survey import Survey
    from magmatch.data.trajectory import Trajectory
    from magmatch.features.extract import extract_features
    from magmatch.features.features import Features
    from magmatch.field.build import build_map
    from magmatch.field.config import FieldConfig
    from magmatch.field.live.estimator import FieldEstimator
    from magmatch.field.map import FieldMap
    from magmatch.grid import RegularGrid
    from magmatch.preparation.config import PreparationConfig
    from magmatch.preparation.prepare import prepare
    from magmatch.registration.config import RegistrationConfig
    from magmatch.registration.register import register
    from magmatch.registration.result import RegistrationResult, Status
    from magmatch.simulation.simulate import simulate

_HOMES = {
    "Atlas": "atlas.atlas",
    "Features": "features.features",
    "FieldConfig": "field.config",
    "FieldEstimator": "field.live.estimator",
    "FieldMap": "field.map",
    "PreparationConfig": "preparation.config",
    "RegistrationConfig": "registration.config",
    "RegistrationResult": "registration.result",
    "RegularGrid": "grid",
    "Status": "registration.result",
    "Survey": "data.survey",
    "Trajectory": "data.trajectory",
    "build_map": "field.build",
    "extract_features": "features.extract",
    "localize": "atlas.localize",
    "open_atlas": "atlas.atlas",
    "prepare": "preparation.prepare",
    "read_survey": "data.read",
    "register": "registration.register",
    "simulate": "simulation.simulate",
}

__all__ = [
    "Atlas",
    "Features",
    "FieldConfig",
    "FieldEstimator",
    "FieldMap",
    "PreparationConfig",
    "RegistrationConfig",
    "RegistrationResult",
    "RegularGrid",
    "Status",
    "Survey",
    "Trajectory",
    "build_map",
    "extract_features",
    "localize",
    "open_atlas",
    "prepare",
    "read_survey",
    "register",
    "simulate",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        msg = f"module 'magmatch' has no attribute '{name}'"
        raise AttributeError(msg)
    return getattr(import_module(f"magmatch.{_HOMES[name]}"), name)
