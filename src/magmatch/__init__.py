# SPDX-License-Identifier: BSD-3-Clause
"""Build magnetic maps, register them, correct odometry drift with them, and localise in them.

Names are resolved on first use, so that importing the package costs nothing until work begins. What is public is
here, or in `magmatch.published`, `magmatch.phones`, `magmatch.simulation` or `magmatch.viz`.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from magmatch._version import __version__ as __version__

if TYPE_CHECKING:
    from magmatch.cli.command import command
    from magmatch.data.formats.format import SurveyFormat
    from magmatch.data.logs.drift import read_drift
    from magmatch.data.read import read_survey
    from magmatch.data.recordings import load_recordings
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
    from magmatch.features.extract import Features, extract_features
    from magmatch.field.build import build_map
    from magmatch.field.config import FieldConfig
    from magmatch.field.hyperparameters import Hyperparameters
    from magmatch.field.live.estimator import FieldEstimator
    from magmatch.field.map import FieldMap
    from magmatch.field.query import query_map
    from magmatch.field.saved_map import MapRecord
    from magmatch.grid import RegularGrid
    from magmatch.localization.config import LocalizerConfig
    from magmatch.localization.estimate import LocalizerStatus, PoseEstimate
    from magmatch.localization.localize import localize
    from magmatch.localization.localizer import Localizer
    from magmatch.localization.result import LocalizationResult, Segment
    from magmatch.localization.track import Track
    from magmatch.preparation.config import PreparationConfig
    from magmatch.preparation.earth_field import Place
    from magmatch.preparation.odometry.drift import OdometryConfig
    from magmatch.preparation.preparation_report import PreparationReport
    from magmatch.preparation.prepare import prepare
    from magmatch.progress import followed
    from magmatch.registration.config import PRESETS, RegistrationConfig
    from magmatch.registration.index.atlas import Atlas, open_atlas
    from magmatch.registration.index.map_index import MapIndex
    from magmatch.registration.register import judge, register
    from magmatch.registration.result import RegistrationResult, Status
    from magmatch.simulation.simulate import simulate
    from magmatch.slam.config import SlamConfig
    from magmatch.slam.graph.anchors import Anchor, read_anchors
    from magmatch.slam.merge import merge
    from magmatch.slam.output.folder import write_folder
    from magmatch.slam.output.kept_session import read_session
    from magmatch.slam.result import AnchorResult, ClosureResult, LogResult, SlamResult
    from magmatch.slam.run import slam
    from magmatch.slam.session import Session
    from magmatch.viz.view import view
    from magmatch.workers import DaskRunner

# Where each name lives.
_NAMES = {
    "cli.command": "command",
    "data.formats.format": "SurveyFormat",
    "data.logs.drift": "read_drift",
    "data.read": "read_survey",
    "data.recordings": "load_recordings",
    "data.survey": "Survey",
    "data.trajectory": "Trajectory",
    "errors": "ConfigurationError DataFormatError DatasetError MagmatchError MissingExtraError SurveyError TaskError",
    "features.extract": "Features extract_features",
    "field.build": "build_map",
    "field.config": "FieldConfig",
    "field.hyperparameters": "Hyperparameters",
    "field.live.estimator": "FieldEstimator",
    "field.map": "FieldMap",
    "field.query": "query_map",
    "field.saved_map": "MapRecord",
    "grid": "RegularGrid",
    "localization.config": "LocalizerConfig",
    "localization.estimate": "LocalizerStatus PoseEstimate",
    "localization.localize": "localize",
    "localization.localizer": "Localizer",
    "localization.result": "LocalizationResult Segment",
    "localization.track": "Track",
    "preparation.config": "PreparationConfig",
    "preparation.earth_field": "Place",
    "preparation.odometry.drift": "OdometryConfig",
    "preparation.preparation_report": "PreparationReport",
    "preparation.prepare": "prepare",
    "progress": "followed",
    "registration.config": "PRESETS RegistrationConfig",
    "registration.index.atlas": "Atlas open_atlas",
    "registration.index.map_index": "MapIndex",
    "registration.register": "judge register",
    "registration.result": "RegistrationResult Status",
    "simulation.simulate": "simulate",
    "slam.config": "SlamConfig",
    "slam.graph.anchors": "Anchor read_anchors",
    "slam.merge": "merge",
    "slam.output.folder": "write_folder",
    "slam.output.kept_session": "read_session",
    "slam.result": "AnchorResult ClosureResult LogResult SlamResult",
    "slam.run": "slam",
    "slam.session": "Session",
    "viz.view": "view",
    "workers": "DaskRunner",
}
_HOMES = {name: home for home, names in _NAMES.items() for name in names.split()}

__all__ = [
    "PRESETS", "Anchor", "AnchorResult", "Atlas", "ClosureResult", "ConfigurationError", "DaskRunner",
    "DataFormatError", "DatasetError", "Features", "FieldConfig", "FieldEstimator", "FieldMap", "Hyperparameters",
    "LocalizationResult", "Localizer", "LocalizerConfig", "LocalizerStatus", "LogResult", "MagmatchError",
    "MapIndex", "MapRecord", "MissingExtraError", "OdometryConfig", "Place", "PoseEstimate", "PreparationConfig",
    "PreparationReport", "RegistrationConfig", "RegistrationResult", "RegularGrid", "Segment", "Session",
    "SlamConfig", "SlamResult", "Status", "Survey", "SurveyError", "SurveyFormat", "TaskError", "Track",
    "Trajectory", "build_map", "command", "extract_features", "followed", "judge", "load_recordings", "localize",
    "merge", "open_atlas", "prepare", "query_map", "read_anchors", "read_drift", "read_session", "read_survey",
    "register", "simulate", "slam", "view", "write_folder",
]  # fmt: skip


# One room has the name of its verb. Python names a room here when it is first imported and never again: so that is
# done now, and the name is left to the verb. `from magmatch.slam.x import y` finds the room all the same.
import_module("magmatch.slam")
del globals()["slam"]


# Public rooms beside this one.
_ROOMS = {"phones", "published", "simulation", "viz"}


def __getattr__(name: str) -> Any:
    if name in _ROOMS:
        return import_module(f"magmatch.{name}")
    if name not in _HOMES:
        msg = f"module 'magmatch' has no attribute '{name}'"
        raise AttributeError(msg)
    return getattr(import_module(f"magmatch.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
