# SPDX-License-Identifier: BSD-3-Clause
"""A worker process reads a whole log, localizes or registers it, and says the result."""

import logging
import multiprocessing
import os
import signal
import threading
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal

import numpy as np
from pydantic import Field, ValidationError

from magmatch.data.formats.format import SurveyFormat
from magmatch.data.read import read_survey
from magmatch.data.survey import Survey
from magmatch.errors import DataFormatError, MagmatchError, MissingExtraError, first_fault
from magmatch.estimation.pose_prior import PosePriorConfig
from magmatch.field.map import FieldMap
from magmatch.localization.config import LocalizerConfig
from magmatch.localization.known_places import Place, open_place
from magmatch.localization.localize import localize
from magmatch.registration.config import RegistrationConfig
from magmatch.registration.index.atlas import Atlas
from magmatch.registration.register import register
from magmatch.settings import of_vertical
from magmatch.viz.figures.draw import magnitude_ut
from magmatch.viz.figures.slices import cut_normal_to, field_on
from magmatch_serve.catalogue import Listing
from magmatch_serve.config import ServeConfig
from magmatch_serve.logs.bounds import bounded, give_back_memory
from magmatch_serve.logs.remarks import in_query_words, listening
from magmatch_serve.refusals import RefusedError, without_paths

log = logging.getLogger("magmatch.serve")
Verb = Literal["localize", "register"]
# Settings of a format that name files, which no client may.
FILES = {"trajectory", "trajectory_time_unit", "extrinsic"}
_one_at_a_time = threading.Lock()


class LogQuestion(SurveyFormat):
    """The words of a query: how a log is to be read, and what is asked of it."""

    @classmethod
    def words(cls) -> set[str]:
        """Those that a client may say."""
        return set(cls.model_fields) - FILES

    @property
    def format(self) -> SurveyFormat:
        """How the log is to be read."""
        return SurveyFormat.model_validate(self.model_dump(include={*SurveyFormat.model_fields}, exclude_unset=True))


class WhereOfLog(LogQuestion):
    """The questions about a log that is localized."""

    live: bool = Field(default=False, description="As it was known live, instead of with hindsight.")
    planar: bool = Field(default=False, description="z is up, and all poses lie at one height.")
    no_gravity: bool = Field(default=False, description="z of the log is not up.")


class PoseOfLog(LogQuestion):
    """The questions about a log that is registered."""

    gravity_aligned: bool = Field(default=False, description="z points up in the log and in the map.")
    planar: bool = Field(default=False, description="As gravity_aligned, and both frames agree in height.")
    seed: int = Field(default=0, ge=0, lt=2**32, description="Same log and map: same answer.")


QUESTIONS: dict[Verb, type[LogQuestion]] = {"localize": WhereOfLog, "register": PoseOfLog}


def read_question(verb: Verb, words: list[tuple[str, str]]) -> LogQuestion:
    """Read the query of a request."""
    kind = QUESTIONS[verb]
    given: dict[str, str] = {}
    for name, value in words:
        if name not in kind.words() or name in given:
            expected = ", ".join(sorted(kind.words()))
            fault = "twice" if name in given else "among the words of the query"
            raise RefusedError(422, f"found '{name[:40]}' {fault}; expected each at most once of {expected}")
        given[name] = value
    try:
        found = kind.model_validate(given)
    except ValidationError as error:
        place, fault = first_fault(error)
        raise RefusedError(422, f"{place}: {fault}") from None
    if isinstance(found, WhereOfLog) and found.planar and found.no_gravity:
        raise RefusedError(422, "planar: expected z up, as one floor needs, found no_gravity")
    return found


def begin_worker() -> None:
    """Let those that answer live go first; the service says when to stop."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.nice(10)
    threading.Thread(target=_end_with_service, daemon=True).start()


def _end_with_service() -> None:
    """End with the service, however that ended."""
    service = multiprocessing.parent_process()
    if service is not None:
        service.join()
        os._exit(1)


def work_on_log(
    place: Path, served: Listing, upload: Path, question: LogQuestion, config: ServeConfig
) -> dict[str, Any] | RefusedError:
    """Answer a question of a log; what cannot be done is an answer, too."""
    try:
        with _ended_after(config.max_work_time):
            return _answer(place, served, upload, question, config)
    except RefusedError as refused:
        return refused
    except TimeoutError:
        return RefusedError(503, f"the log took longer than {config.max_work_time:g} s; send a shorter one")
    except MemoryError:
        return RefusedError(413, "the log needs more room than it may take; send a shorter one")
    except MagmatchError as error:
        is_of_maps = isinstance(error, DataFormatError) and error.path.parent == place
        status = 501 if isinstance(error, MissingExtraError) else 503 if is_of_maps else 422
        words = _for_client(str(error), place, upload, question)
        return RefusedError(status, words or "log: cannot be read")
    except Exception:
        log.exception("a log was not worked on")
        return RefusedError(500, "the service made a mistake with this log; please report it")
    finally:
        give_back_memory()


def work_on_sent_log(
    place: Path, served: Listing, content: bytes, question: LogQuestion, config: ServeConfig
) -> dict[str, Any] | RefusedError:
    """Do the same on a machine that does not see the file; one at a time, whose maps no other thread changes."""
    with TemporaryDirectory(prefix="magmatch-") as folder, _one_at_a_time:
        upload = Path(folder) / "log"
        upload.write_bytes(content)
        return work_on_log(place, served, upload, question, config)


def _answer(place: Path, served: Listing, upload: Path, question: LogQuestion, config: ServeConfig) -> dict[str, Any]:
    _refuse_bombs(upload, config.max_unpacked)
    with listening() as remarks:
        with bounded(config.max_reading, config.max_unpacked, config.max_work_time):
            survey = read_survey(upload, question.format)
        if len(survey) > config.max_log:
            raise RefusedError(413, f"expected a log of at most {config.max_log} samples, found {len(survey)}")
        survey, known = replace(survey, name="log"), _place(place, served)
        if isinstance(question, PoseOfLog):
            document = _registered(known, survey, question)
        else:
            assert isinstance(question, WhereOfLog)
            document = _localized(known, survey, question, config.localizer)
    told = (_for_client(words, place, upload, question) for words in (document["reason"], *remarks))
    document["reason"], *others = told
    return document | {"warnings": list(dict.fromkeys(words for words in others if words))}


def _for_client(words: str, place: Path, upload: Path, question: LogQuestion) -> str:
    """Words of the library as a client may read them; empty where they are of this machine."""
    names = {upload: "log", upload.parent: "log", place: "maps", place.parent: "maps"}
    words = without_paths(words, names)
    switches = {name for name, one in type(question).model_fields.items() if one.annotation is bool}
    # A user without a home has "/", "~" or nothing.
    home = os.path.expanduser("~")  # noqa: PTH111  # Path.home() raises an error instead
    is_ours = len(home) > 1 and home in words
    return "" if is_ours else in_query_words(words, switches, question.words())


def _registered(known: Place, survey: Survey, question: PoseOfLog) -> dict[str, Any]:
    prior = PosePriorConfig(is_gravity_aligned=question.gravity_aligned, is_planar=question.planar)
    config = RegistrationConfig(prior=prior)
    base = replace(known, config=config) if isinstance(known, Atlas) else known
    return register(base, survey, config, seed=question.seed).to_dict()


def _localized(known: Place, survey: Survey, question: WhereOfLog, config: LocalizerConfig) -> dict[str, Any]:
    settings = config.model_copy(update=of_vertical(planar=question.planar, no_gravity=question.no_gravity))
    track = localize(known, survey, settings, live=question.live)
    document = track.result().to_dict()
    times, rows = survey.times, np.flatnonzero(track.is_stated)
    assert times is not None
    document["trajectory"] = []
    if len(rows):
        T = track.poses
        document["trajectory"] = np.column_stack([times[rows], T.translation, T.rotation.as_quat()]).tolist()
    return document


@lru_cache(maxsize=2)
def _place(path: Path, served: Listing) -> Place:
    """Maps, held in memory by this process; what else lies beside them may be half written."""
    with _maps_readable(path):
        return open_place(path, served.names)


@contextmanager
def _maps_readable(path: Path) -> Iterator[None]:
    """Say of maps that cannot be read that this is not the client's fault."""
    try:
        yield
    except MagmatchError as error:
        raise RefusedError(503, without_paths(str(error), {path: "maps"}), retry_after=30) from None


def _refuse_bombs(upload: Path, most: int) -> None:
    """Refuse an archive that says itself that it is too large; readers hold those that lie to what they said."""
    if not zipfile.is_zipfile(upload):
        return
    try:
        with zipfile.ZipFile(upload) as archive:
            size = sum(info.file_size for info in archive.infolist())
    except (zipfile.BadZipFile, ValueError, NotImplementedError, OSError):
        raise RefusedError(422, "log: is a zip archive that is damaged") from None
    if size > most:
        raise RefusedError(413, f"unpacks to more than {most} bytes")


@contextmanager
def _ended_after(seconds: float) -> Iterator[None]:
    """Raise TimeoutError in work that takes too long; where it runs in a thread, nothing can."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def end(*_: object) -> None:
        raise TimeoutError

    before = signal.signal(signal.SIGALRM, end)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def picture_of(place: Path, served: Listing, name: str) -> dict[str, Any]:
    """A map from above: magnitude of the field (uT) at the median height of its samples, None where not known."""
    known = _place(place, served)
    if isinstance(known, Atlas):
        entry = next(entry for entry in known.entries if entry.name == name)
        with _maps_readable(place):
            field_map = known.load(entry).field_map
    else:
        field_map = known if isinstance(known, FieldMap) else known.field_map
    cut = cut_normal_to(field_map.survey.positions, 2)
    field, is_known = field_on(cut, field_map)
    values = np.round(magnitude_ut(field), 2).tolist()
    shown = [v if k else None for v, k in zip(values, is_known.tolist(), strict=True)]
    n, (x, y) = len(cut.first), ([float(side[0]), float(side[-1])] for side in (cut.first, cut.second))
    return {
        "name": name, "x": x, "y": y,
        "height": cut.height, "shape": [len(cut.second), n],
        "field_ut": [shown[k : k + n] for k in range(0, len(shown), n)],
    }  # fmt: skip
