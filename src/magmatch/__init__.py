# SPDX-License-Identifier: BSD-3-Clause
"""Build magnetic maps, register them, correct odometry drift with them, and localise in them.

Names are resolved on first use, so that importing the package costs nothing until work begins.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from magmatch._version import __version__ as __version__

if TYPE_CHECKING:
    from magmatch.data.read import read_survey
    from magmatch.data.survey import Survey
    from magmatch.data.trajectory import Trajectory
    from magmatch.errors import (
        ConfigurationError,
        DataFormatError,
        DatasetError,
        MagmatchError,
        MissingExtraError,
        SurveyError,
        TaskError,
    )
    from magmatch.features.extract import extract_features
    from magmatch.features.features import Features
    from magmatch.field.build import build_map
    from magmatch.field.config import FieldConfig
    from magmatch.field.hyperparameters import Hyperparameters
    from magmatch.field.live.estimator import FieldEstimator
    from magmatch.field.map import FieldMap
    from magmatch.grid import RegularGrid
    from magmatch.localization.config import LocalizerConfig
    from magmatch.localization.localize import localize
    from magmatch.localization.localizer import Localizer
    from magmatch.localization.result import LocalizationResult
    from magmatch.localization.track import Track
    from magmatch.preparation.config import PreparationConfig
    from magmatch.preparation.prepare import prepare
    from magmatch.registration.config import PRESETS, RegistrationConfig
    from magmatch.registration.index.atlas import Atlas, open_atlas
    from magmatch.registration.index.map_index import MapIndex
    from magmatch.registration.register import judge, register
    from magmatch.registration.result import RegistrationResult, Status
    from magmatch.simulation.simulate import simulate
    from magmatch.slam.config import SlamConfig
    from magmatch.slam.merge import merge
    from magmatch.slam.result import SlamResult
    from magmatch.slam.run import slam
    from magmatch.slam.session import Session
    from magmatch.viz.view import view

_HOMES = {
    "PRESETS": "registration.config",
    "Atlas": "registration.index.atlas",
    "ConfigurationError": "errors",
    "DataFormatError": "errors",
    "DatasetError": "errors",
    "Features": "features.features",
    "FieldConfig": "field.config",
    "FieldEstimator": "field.live.estimator",
    "FieldMap": "field.map",
    "Hyperparameters": "field.hyperparameters",
    "LocalizationResult": "localization.result",
    "Localizer": "localization.localizer",
    "LocalizerConfig": "localization.config",
    "MagmatchError": "errors",
    "MapIndex": "registration.index.map_index",
    "MissingExtraError": "errors",
    "PreparationConfig": "preparation.config",
    "RegistrationConfig": "registration.config",
    "RegistrationResult": "registration.result",
    "RegularGrid": "grid",
    "Session": "slam.session",
    "SlamConfig": "slam.config",
    "SlamResult": "slam.result",
    "Status": "registration.result",
    "Survey": "data.survey",
    "SurveyError": "errors",
    "TaskError": "errors",
    "Track": "localization.track",
    "Trajectory": "data.trajectory",
    "build_map": "field.build",
    "extract_features": "features.extract",
    "judge": "registration.register",
    "localize": "localization.localize",
    "merge": "slam.merge",
    "open_atlas": "registration.index.atlas",
    "prepare": "preparation.prepare",
    "read_survey": "data.read",
    "register": "registration.register",
    "simulate": "simulation.simulate",
    "slam": "slam.run",
    "view": "viz.view",
}

__all__ = [
    "PRESETS",
    "Atlas",
    "ConfigurationError",
    "DataFormatError",
    "DatasetError",
    "Features",
    "FieldConfig",
    "FieldEstimator",
    "FieldMap",
    "Hyperparameters",
    "LocalizationResult",
    "Localizer",
    "LocalizerConfig",
    "MagmatchError",
    "MapIndex",
    "MissingExtraError",
    "PreparationConfig",
    "RegistrationConfig",
    "RegistrationResult",
    "RegularGrid",
    "Session",
    "SlamConfig",
    "SlamResult",
    "Status",
    "Survey",
    "SurveyError",
    "TaskError",
    "Track",
    "Trajectory",
    "build_map",
    "extract_features",
    "judge",
    "localize",
    "merge",
    "open_atlas",
    "prepare",
    "read_survey",
    "register",
    "simulate",
    "slam",
    "view",
]


# One room has the name of its verb. Python names a room here when it is first imported and never again: so that is
# done now, and the name is left to the verb. `from magmatch.slam.x import y` finds the room all the same.
import_module("magmatch.slam")
del globals()["slam"]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        msg = f"module 'magmatch' has no attribute '{name}'"
        raise AttributeError(msg)
    return getattr(import_module(f"magmatch.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
