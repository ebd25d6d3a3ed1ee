# SPDX-License-Identifier: BSD-3-Clause
"""What the command line leaves out is what Python leaves out: one place states each default."""

import importlib.util
import inspect
import pkgutil
import re
import sys
import typing
from dataclasses import dataclass, field
from math import degrees

import numpy as np
import pytest
import typer
from pydantic import BaseModel
from scipy.spatial.transform import Rotation

import magmatch as mm
from magmatch.cli.command import G2oRotation
from magmatch.cli.main import build_app
from magmatch.cli.settings import Preset, Sensor
from magmatch.errors import ConfigurationError
from magmatch.registration.config import PRESETS
from magmatch.registration.decide.decision import MAX_SD_IN_LENGTHS
from magmatch.registration.g2o import RotationTangent
from magmatch.registration.refine.sensors import SensorMode
from magmatch.settings import Settings

N = 40
NUMBERS = mm.FieldConfig(prior="spline", lengthscale=1.0, signal_sd=5e-6, noise_sd=1e-7, spacing=0.5)
# How the work is done and kept, not what comes of it.
MEANS = {"progress", "run", "keep", "on_start", "on_pose"}


@dataclass(frozen=True)
class Door:
    """A command with what it needs at least, and the functions that it calls for all that its options say."""

    words: list
    calls: list
    # What it states itself, not as a default but as what follows from its files.
    derived: dict = field(default_factory=dict)


DOORS = {
    "register": Door(["walk.csv", "walk.csv"], ["registration.register.register_keeping_maps"]),
    "map": Door(["walk.csv", "--out", "new.map"], ["field.build.build_map"]),
    "slam": Door(["walk.csv", "--out", "new"], ["slam.session.Session"]),
    "merge": Door(["walk.csv", "room.map", "--out", "new"], ["slam.merge.merge"]),
    "localize": Door(["room.map", "walk.csv", "--out", "new.tum"], ["localization.localize.localize"]),
    "prepare": Door(["walk.csv", "--out", "new.csv"], ["preparation.prepare.prepare"]),
    "odometry": Door(["walk.csv", "--out", "new.tum"], ["preparation.odometry.dead_reckon.dead_reckon"]),
    "query": Door(["room.map", "points.csv", "--out", "new.csv"], ["field.query.query_map"]),
    "simulate": Door(["office", "--out", "new"], ["simulation.simulate.simulate"]),
    "evaluate": Door(["refusals", "--out", "new"], ["magmatch_evaluation.plan.make_plan"]),
    "serve": Door(["room.map"], ["magmatch_serve.serve.serve"], {"states": "beside the map"}),
    "replay": Door(["walk.csv", "--url", "http://127.0.0.1:1"], ["magmatch_serve.replay.replay"]),
}
# Nothing is computed, so that nothing can be left out of it.
OTHERS = {"transform", "info", "view", "convert", "datasets", "demo", "glossary"}
# What the help says is used where an option is not given, in the option's units.
STATED = {
    ("register", "--prior-pose-sd"): lambda c: (c.prior.sd_translation, degrees(c.prior.sd_rotation)),
    ("register", "--gravity-sd"): lambda c: (degrees(c.prior.gravity_sd),),
    ("register", "--min-probability"): lambda c: (c.decision.min_probability,),
    ("register", "--max-sd"): lambda c: (MAX_SD_IN_LENGTHS, degrees(c.decision.max_sd_rotation)),
    ("slam", "--odometry-sd"): lambda c: c.odometry.sd,
    ("localize", "--odometry-sd"): lambda c: c.settled().odometry.sd,
    ("localize", "--min-probability"): lambda c: (c.decision.min_probability,),
    ("localize", "--max-sd"): lambda c: (c.decision.max_sd_translation, degrees(c.decision.max_sd_rotation)),
}  # fmt: skip
COMMANDS = typer.main.get_command(build_app()).commands
CONFIGS = {"register": mm.RegistrationConfig(), "slam": mm.SlamConfig(), "localize": mm.LocalizerConfig()}


@pytest.fixture(scope="module")
def everything():
    """All modules: one that is first imported while a function is watched would keep the watched one."""
    for package in ("magmatch", "magmatch_serve", "magmatch_evaluation"):
        if importlib.util.find_spec(package):
            paths = importlib.import_module(package).__path__
            for module in pkgutil.walk_packages(paths, f"{package}."):
                if not module.name.endswith("__main__"):
                    importlib.import_module(module.name)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    rng = np.random.default_rng(0)
    survey = mm.Survey(
        rng.uniform(0, 2, (N, 3)), 1e-6 * rng.normal([20, 0, -45], 2, (N, 3)), np.arange(N), Rotation.identity(N)
    )
    survey.save(tmp_path / "walk.csv")
    mm.build_map(survey, NUMBERS).save(tmp_path / "room.map")
    (tmp_path / "points.csv").write_text("x,y,z\n1,1,1\n")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def configs_of(function):
    """Default of each parameter that is a configuration, or None for it."""
    hints = typing.get_type_hints(function)
    for name in inspect.signature(function).parameters:
        kinds = [kind for kind in (hints.get(name), *typing.get_args(hints.get(name))) if isinstance(kind, type)]
        for kind in kinds:
            if issubclass(kind, BaseModel) and kind is not Settings:
                yield name, kind


@pytest.mark.parametrize("name", DOORS)
def test_a_command_without_options_asks_for_what_its_function_does_by_default(
    name, folder, run, everything, monkeypatch
):
    if name not in COMMANDS:
        pytest.skip("its distribution is not installed")
    door, said = DOORS[name], []
    monkeypatch.setattr("magmatch.data.formats.phones.read.read_phone_log", lambda *_, **__: None)
    if name == "odometry":
        monkeypatch.setattr("magmatch.data.formats.sniff.sniff", lambda _: "phone")
    for path in door.calls:
        room, _, verb = (path if path.startswith("magmatch_") else f"magmatch.{path}").rpartition(".")
        function = getattr(sys.modules[room], verb)

        def heard(*args, function=function, **named):
            said.append((function, inspect.signature(function).bind(*args, **named).arguments))
            raise ConfigurationError("is called, and that is enough")

        for module in [m for n, m in sys.modules.items() if n.startswith("magmatch") and verb in vars(m)]:
            if vars(module)[verb] is function:
                monkeypatch.setattr(module, verb, heard)
    done = run(name, *door.words)
    assert "enough" in done.err, done
    ((function, given),) = said
    configs = dict(configs_of(function))
    if name == "slam":  # a session may be of merged surveys too
        configs["config"] = mm.SlamConfig
    for key, parameter in inspect.signature(function).parameters.items():
        value = given.get(key, parameter.default)
        if key in MEANS:
            continue
        if key in configs:
            stated = {name: getattr(value, name) for name in door.derived}
            assert (configs[key](**stated) if value is not None else None) == value, key
        elif parameter.default is not inspect.Parameter.empty:
            assert value == parameter.default or (not value and not parameter.default), key


def test_every_command_is_asked_for_its_defaults():
    assert set(COMMANDS) <= {*DOORS, *OTHERS}
    assert {*DOORS, *OTHERS} - set(COMMANDS) <= {"evaluate", "serve", "replay"}


def test_a_default_that_the_help_states_is_that_of_the_configuration():
    told = {
        (name, option.opts[0]): words[1]
        for name, command in COMMANDS.items()
        for option in command.params
        if (words := re.search(r"\[default: (.*?\d.*?)\]", getattr(option, "help", None) or ""))
    }
    assert set(told) == set(STATED)
    for place, words in told.items():
        numbers = STATED[place](CONFIGS[place[0]])
        said = [float(n) for n in re.findall(r"\d+(?:\.\d+)?", words.split("else")[-1].split(";")[0])]
        assert said == [float(f"{n:.2g}") for n in numbers], place


def models():
    """Every class of settings that has others within."""
    for name in mm.__all__:
        thing = getattr(mm, name)
        if isinstance(thing, type) and issubclass(thing, BaseModel) and thing is not mm.MapRecord:
            yield thing


@pytest.mark.parametrize("model", list(models()), ids=lambda model: model.__name__)
def test_a_part_given_as_a_mapping_changes_what_it_names_and_no_more(model):
    for name, part in model():
        if isinstance(part, BaseModel):
            for key, value in part:
                assert model(**{name: {key: value}}) == model(), (name, key)
                assert model.model_validate({name: {key: value}}) == model(), (name, key)


VERBS = [name for name in mm.__all__ if inspect.isfunction(getattr(mm, name)) and name not in {"command", "followed"}]


@pytest.mark.parametrize("verb", VERBS)
def test_a_verb_gives_one_type(verb):
    given = inspect.signature(getattr(mm, verb)).return_annotation
    assert given is not inspect.Signature.empty
    assert "|" not in str(given).replace("| None", ""), given


def test_the_values_of_options_are_those_of_the_settings():
    """The command line names some itself: the modules of the settings take a second to import."""
    assert typing.get_args(Preset) == tuple(PRESETS)
    assert typing.get_args(Sensor) == typing.get_args(SensorMode)
    assert typing.get_args(G2oRotation) == typing.get_args(RotationTangent)
