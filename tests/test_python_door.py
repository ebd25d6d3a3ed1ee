# SPDX-License-Identifier: BSD-3-Clause
"""The Python door is as careful as the command line: bad calls get one sentence, good ones the rows in order."""

import sys
import traceback
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.spatial.transform import RigidTransform, Rotation

import magmatch as mm
from magmatch.field.live.estimator import FieldEstimator
from magmatch.registration.result import Links

N = 40
SETTINGS = mm.FieldConfig(lengthscale=1.0, signal_sd=5e-6, noise_sd=1e-7, spacing=0.5)
NUMBERS = mm.Hyperparameters(0.5, 1e-5, 5e-7, 0.2, 100.0)
COLUMNS = ["x", "y", "z", "bx", "by", "bz"]


def field_at(p):
    return np.array([2e-5, 0, -4.5e-5]) + 2e-6 * np.sin(2 * p)


@pytest.fixture(scope="module")
def survey():
    p = np.random.default_rng(0).uniform(0, 2, (N, 3))
    return mm.Survey(p, field_at(p), times=np.arange(N), orientations=Rotation.identity(N), name="room")


@pytest.fixture(scope="module")
def field_map(survey):
    return mm.build_map(survey, SETTINGS)


@pytest.fixture
def frame(survey):
    pd = pytest.importorskip("pandas")
    index = np.random.default_rng(1).permutation(3 * N)[:N]
    return pd.DataFrame(np.c_[survey.positions, 1e6 * survey.field], columns=COLUMNS, index=index)


def is_refused(call):
    """The one sentence of a bad call, raised by this package and none that it stands on."""
    with pytest.raises((ValueError, TypeError, mm.MagmatchError)) as caught:
        call()
    message = str(caught.value)
    assert message
    assert "\n" not in message
    assert len(message) < 400
    assert "magmatch" in traceback.extract_tb(caught.value.__traceback__)[-1].filename
    return message


# --- arrays -----------------------------------------------------------------------------------------------------


def column_frame(values):
    return pytest.importorskip("pandas").DataFrame(values)


BAD_ROWS = {
    "one point": (lambda p: p[0], "(n, 3)"),
    "four columns": (lambda p: np.c_[p, p[:, 0]], "(n, 3)"),
    "columns": (lambda p: p.T, "transpose it"),
    "NaN": (lambda p: np.where(p == p[4], np.nan, p), "4"),
    "complex": (lambda p: p + 0j, "complex numbers"),
    "text": (lambda p: p.astype(str), "text"),
    "booleans": (lambda p: p > 0, "booleans"),
    "dates": (lambda p: p.astype("M8[s]"), "dates"),
    "ragged": (lambda p: [[1.0, 2.0, 3.0], [1.0, 2.0]], "equal length"),
    "masked": (lambda p: np.ma.masked_less(p, 1.0), "masked"),
    "nothing": (lambda p: None, "None"),
    "a path": (lambda p: "points.csv", "text"),
    "mixed frame": (lambda p: column_frame({"x": p[:, 0], "y": "north", "z": 0}), "'north'"),
}
ROW_DOORS = {
    "Survey.positions": lambda m, rows: mm.Survey(rows, m.survey.field),
    "Survey.field": lambda m, rows: mm.Survey(m.survey.positions, rows),
    "Trajectory": lambda m, rows: mm.Trajectory(np.arange(N), rows, Rotation.identity(N)),
    "evaluate": lambda m, rows: m.evaluate(rows),
    "knows": lambda m, rows: m.knows(rows),
    "covariance": lambda m, rows: m.covariance(rows),
    "draw": lambda m, rows: m.draw(rows, 2, 0, np.random.default_rng(0)),
    "RegularGrid.over": lambda m, rows: mm.RegularGrid.over(rows, 0.5),
    "predict": lambda m, rows: FieldEstimator(NUMBERS).predict(rows),
}


@pytest.mark.parametrize("door", ROW_DOORS)
@pytest.mark.parametrize("bad", BAD_ROWS)
def test_rows_that_are_none_are_refused_at_every_door(door, bad, field_map):
    change, words = BAD_ROWS[bad]
    message = is_refused(lambda: ROW_DOORS[door](field_map, change(field_map.survey.positions)))
    assert words in message


@settings(deadline=None, max_examples=150)
@given(
    door=st.sampled_from(sorted(ROW_DOORS)),
    rows=hnp.arrays(
        st.sampled_from(["f8", ">f4", "f2", "i8", "u1", "c8", "U3", "O", "?", "M8[D]"]),
        hnp.array_shapes(min_dims=0, max_dims=4, max_side=4).filter(lambda shape: len(shape) != 2 or shape[1] != 3),
    ),
)
def test_rows_of_no_shape_are_refused_whatever_they_hold(door, rows, field_map):
    is_refused(lambda: ROW_DOORS[door](field_map, rows))


ANYTHING = st.one_of(
    st.none(), st.text(max_size=5), st.floats(), st.integers(-5, 5), st.lists(st.integers(), max_size=3),
    st.dictionaries(st.text(max_size=2), st.integers(), max_size=2), st.just(object()), st.just(np.zeros((5, 3))),
)  # fmt: skip
NOUN_DOORS = {
    "register base": lambda m, bad: mm.register(bad, m),
    "register target": mm.register,
    "build_map": lambda m, bad: mm.build_map(bad),
    "build_map, several": lambda m, bad: mm.build_map([m.survey, bad]),
    "with_surveys": lambda m, bad: m.with_surveys(bad),
    "merged": lambda m, bad: m.survey.merged(bad),
    "prepare": lambda m, bad: mm.prepare(bad),
    "extract_features": lambda m, bad: mm.extract_features(bad),
    "localize": lambda m, bad: mm.localize(bad, m),
    "on_grid": lambda m, bad: m.on_grid(bad),
    "transformed": lambda m, bad: m.transformed(bad),
    "survey transformed": lambda m, bad: m.survey.transformed(bad),
    "view": lambda m, bad: mm.view(bad),
    "from_dataframe": lambda m, bad: mm.Survey.from_dataframe(bad),
    "from_xarray": lambda m, bad: mm.Survey.from_xarray(bad),
    "read_survey": lambda m, bad: mm.read_survey(bad),
    "load": lambda m, bad: mm.FieldMap.load(bad),
    "open_atlas": lambda m, bad: mm.open_atlas(bad),
}


@settings(deadline=None, max_examples=200)
@given(door=st.sampled_from(sorted(NOUN_DOORS)), bad=ANYTHING)
def test_what_is_no_noun_is_refused_at_every_verb(door, bad, field_map):
    is_refused(lambda: NOUN_DOORS[door](field_map, bad))


# --- surveys ----------------------------------------------------------------------------------------------------

BAD_SURVEYS = {
    "empty": (lambda s: mm.Survey(np.zeros((0, 3)), np.zeros((0, 3))), "at least 1"),
    "field for fewer": (lambda s: mm.Survey(s.positions, s.field[:5]), r"(40, 3) and (5, 3)"),
    "times backward": (lambda s: mm.Survey(s.positions, s.field, s.times[::-1]), "runs backward"),
    "times repeat": (lambda s: mm.Survey(s.positions, s.field, s.times // 2), "time repeats at sample 1"),
    "quaternions": (lambda s: mm.Survey(s.positions, s.field, None, np.zeros((N, 4))), "Rotation.from_quat"),
    "one rotation": (lambda s: mm.Survey(s.positions, s.field, None, Rotation.identity()), "each of 40 samples"),
    "pose_sd negative": (lambda s: mm.Survey(s.positions, s.field, pose_sd=-1.0), "non-negative"),
    "rows beyond": (lambda s: s.subset([N]), "40 samples"),
    "matrix": (lambda s: s.transformed(np.eye(4)), "RigidTransform.from_matrix"),
    "two transforms": (lambda s: s.transformed(RigidTransform.identity(2)), "one RigidTransform"),
}


@pytest.mark.parametrize("bad", BAD_SURVEYS)
def test_surveys_that_are_none_are_refused(bad, survey):
    call, words = BAD_SURVEYS[bad]
    assert words in is_refused(lambda: call(survey))


BAD_SAMPLES = {
    "no time": (None, [2e-5, 0, -4e-5], "t: expected one number, in s, got None"),
    "many times": (np.arange(9.0), [2e-5, 0, -4e-5], "one finite number, in s, got an array of shape (9,)"),
    "NaN": (0.0, [np.nan, 0, -4e-5], "got [nan, 0.0, -4e-05]; leave such samples out"),
    "microtesla": (0.0, [20.0, 0, -40.0], "if it is in uT, multiply by 1e-6"),
}


@pytest.mark.parametrize("bad", BAD_SAMPLES)
def test_samples_that_are_none_are_refused_by_a_localizer(bad, field_map):
    t, field, words = BAD_SAMPLES[bad]
    assert words in is_refused(lambda: mm.Localizer(field_map).update(t, RigidTransform.identity(), field))


TAKES_SURVEYS = {
    "register base": mm.register,
    "register target": lambda s, m: mm.register(m, s),
    "build_map": lambda s, m: mm.build_map(s),
    "build_map, with another": lambda s, m: mm.build_map([m.survey, s]),
    "with_surveys": lambda s, m: m.with_surveys(s),
    "prepare": lambda s, m: mm.prepare(s),
}


def with_nan(survey):
    changed = replace(survey, field=survey.field.copy())
    changed.field[3] = np.nan
    return changed


WRONG_SURVEYS = {
    "microtesla": (lambda s: replace(s, field=1e6 * s.field), "if the numbers are in uT, multiply them by 1e-06"),
    "changed to hold NaN": (with_nan, r"room: expected finite field, got NaN .* sample 3"),
}


@pytest.mark.parametrize("door", TAKES_SURVEYS)
@pytest.mark.parametrize("wrong", WRONG_SURVEYS)
def test_surveys_that_cannot_be_are_refused_at_every_door(wrong, door, survey, field_map):
    change, words = WRONG_SURVEYS[wrong]
    with pytest.raises(mm.SurveyError, match=words):
        TAKES_SURVEYS[door](change(survey), field_map)


def test_what_makes_a_survey_is_said(survey, frame, field_map):
    assert "read_survey" in is_refused(lambda: mm.register("room.csv", survey))
    assert "Survey.from_dataframe" in is_refused(lambda: mm.register(frame, survey))
    assert "Survey(positions, field)" in is_refused(lambda: mm.build_map(survey.positions))
    assert "PRESETS" in is_refused(lambda: mm.register(survey, survey, "paper"))
    assert ".survey" in is_refused(lambda: mm.build_map(field_map))
    assert "build_map makes one map of several" in is_refused(lambda: mm.register([survey, survey], survey))
    assert "read_survey" in is_refused(lambda: mm.slam("walk.csv"))


@pytest.mark.parametrize("bad", [None, 3, object()])
@pytest.mark.parametrize("noun", ["survey", "field_map", "result", "trajectory"])
def test_what_is_no_path_is_refused_where_something_is_saved(noun, bad, survey, request):
    poses = mm.Trajectory(survey.times, survey.positions, survey.orientations)
    saved = poses if noun == "trajectory" else request.getfixturevalue(noun)
    assert "path" in is_refused(lambda: saved.save(bad))


# --- what other programs hold -------------------------------------------------------------------------------------


def test_lists_integers_and_foreign_byte_orders_are_taken(survey):
    p = np.rint(10 * survey.positions)
    for rows in (p.tolist(), p.astype(">f4"), p.astype("i4"), np.asfortranarray(p)):
        np.testing.assert_array_equal(mm.Survey(rows, survey.field.tolist()).positions, p)


def test_the_order_of_numbers_in_memory_changes_no_bit(survey):
    # As pandas gives them: sums of rows depend on it.
    taken = mm.Survey(np.asfortranarray(survey.positions), np.asfortranarray(survey.field))
    assert taken.positions.flags.c_contiguous
    assert taken.field.flags.c_contiguous


def test_frames_are_taken_by_position_whatever_their_index(survey, frame, field_map):
    taken = mm.Survey(frame[["x", "y", "z"]], 1e-6 * frame[["bx", "by", "bz"]])
    np.testing.assert_array_equal(taken.positions, survey.positions)
    np.testing.assert_allclose(taken.field, survey.field, rtol=1e-15)
    said = field_map.evaluate(frame[["x", "y", "z"]]).field
    np.testing.assert_array_equal(said, field_map.evaluate(survey.positions).field)


def test_nullable_columns_are_numbers(survey, frame):
    whole = frame[["x", "y", "z"]].astype("Float64")
    np.testing.assert_array_equal(mm.Survey(whole, survey.field).positions, survey.positions)
    whole.iloc[2, 1] = None
    assert "sample 2" in is_refused(lambda: mm.Survey(whole, survey.field))


def test_frame_gives_its_rows_in_order_and_in_units(survey, frame):
    pd = pytest.importorskip("pandas")
    times, columns = pd.to_datetime(survey.times, unit="s"), {"x": "east", "bx": "mag x"}
    renamed = frame.rename(columns={"x": "East", "bx": "Mag X"}).assign(t=times, other="a")
    taken = mm.Survey.from_dataframe(renamed, "uT", "cm", columns=columns, name="walk", pose_sd=0.1)
    np.testing.assert_allclose(taken.positions, survey.positions / 100, rtol=1e-15)
    np.testing.assert_allclose(taken.field, survey.field, rtol=1e-14)
    np.testing.assert_array_equal(taken.times, survey.times)
    assert (taken.name, taken.pose_sd) == ("walk", 0.1)


def test_sensor_vectors_of_a_frame_are_turned(survey, frame):
    turn = Rotation.from_rotvec(np.linspace(0, 3, N)[:, None] * [0, 0, 1])
    turned = frame.assign(**dict(zip(("qx", "qy", "qz", "qw"), turn.as_quat().T, strict=True)))
    taken = mm.Survey.from_dataframe(turned, "uT", field_frame="sensor")
    np.testing.assert_allclose(taken.field, turn.apply(survey.field), rtol=1e-12)
    assert "qx" in is_refused(lambda: mm.Survey.from_dataframe(frame, "uT", field_frame="sensor"))


BAD_FRAMES = {
    "no z": (lambda f: mm.Survey.from_dataframe(f.drop(columns="z")), "missing z"),
    "unit": (lambda f: mm.Survey.from_dataframe(f, "gauss"), "T, mT, uT"),
    "length": (lambda f: mm.Survey.from_dataframe(f, "uT", "km"), "m, cm, mm"),
    "their name": (lambda f: mm.Survey.from_dataframe(f, columns={"x": "east"}), "'east' for x"),
    "two names for one": (lambda f: mm.Survey.from_dataframe(f, columns={"bx": ["bx", "by"]}), "for bx"),
    "a list of names": (lambda f: mm.Survey.from_dataframe(f, columns=COLUMNS), "ours to theirs"),
    "frame of a phone": (lambda f: mm.Survey.from_dataframe(f, field_frame="phone"), "survey, sensor"),
    "decimal commas": (lambda f: mm.Survey.from_dataframe(f.assign(by="2,5")), "text such as '2,5'"),
    "times of day": (lambda f: mm.Survey.from_dataframe(f.assign(t="12:00:01")), "to_datetime"),
    "one name twice": (lambda f: mm.Survey.from_dataframe(f[[*COLUMNS, "bx"]]), "found 2 of that name"),
    "array": (lambda f: mm.Survey.from_dataframe(f.to_numpy()), "Survey(positions, field)"),
    "no rows": (lambda f: mm.Survey.from_dataframe(f.iloc[:0]), "at least 1"),
}


@pytest.mark.parametrize("bad", BAD_FRAMES)
def test_frames_that_are_no_survey_are_refused(bad, frame):
    call, words = BAD_FRAMES[bad]
    assert words in is_refused(lambda: call(frame))


def test_an_index_that_is_named_as_a_column_is_one(survey, frame):
    timed = frame.assign(t=survey.times)
    for index in ("t", ["x", "t"]):
        taken = mm.Survey.from_dataframe(timed.set_index(index), "uT")
        np.testing.assert_array_equal(taken.times, survey.times)
        np.testing.assert_array_equal(taken.positions, survey.positions)
    plain = mm.Survey.from_dataframe(timed.rename_axis("row"), "uT")
    np.testing.assert_array_equal(plain.times, survey.times)


def test_dataset_states_its_units(survey):
    xr = pytest.importorskip("xarray")
    data = {n: ("sample", v, {"units": "m"}) for n, v in zip("xyz", survey.positions.T, strict=True)}
    data |= {n: ("sample", v, {"units": "uT"}) for n, v in zip(COLUMNS[3:], 1e6 * survey.field.T, strict=True)}
    taken = mm.Survey.from_xarray(xr.Dataset(data))
    np.testing.assert_array_equal(taken.positions, survey.positions)
    np.testing.assert_allclose(taken.field, survey.field, rtol=1e-15)
    data["by"][2]["units"] = "nT"
    assert "uT" in is_refused(lambda: mm.Survey.from_xarray(xr.Dataset(data)))


@pytest.mark.parametrize("cut", [None, ("z", 1.0)])
def test_map_becomes_a_dataset_that_can_be_a_survey(cut, field_map):
    pytest.importorskip("xarray")
    dataset = field_map.to_xarray(0.5, cut)
    assert set(dataset.sizes) == ({"x", "y", "z"} if cut is None else {"x", "y"})
    taken = mm.Survey.from_xarray(dataset)
    np.testing.assert_allclose(taken.field, field_map.evaluate(taken.positions).field, atol=1e-15)
    assert len(taken) == dataset["bx"].size


def test_dataset_without_xarray_names_the_extra(field_map, monkeypatch):
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(mm.MissingExtraError, match=r"xarray.*pip install '\.\[grid\]'"):
        field_map.to_xarray()


BAD_MAP_CALLS = {
    "order": lambda m: m.evaluate([[0, 0, 0]], 3),
    "seed for rng": lambda m: m.draw([[0, 0, 0]], 2, 0, 5),
    "spacing": lambda m: m.grid_over(0.0),
    "cut": lambda m: m.to_xarray(0.5, "z"),
    "matrix": lambda m: m.transformed(np.eye(4)),
    "indices for a mask": lambda m: m.without_samples(np.arange(3)),
    "seed": lambda m: mm.register(m, m, seed=-1),
    "settings": lambda m: mm.build_map(m.survey, {"prior": "spline"}),
    "unknown prior": lambda m: mm.FieldConfig(prior="magic"),
    "unknown setting within": lambda m: mm.RegistrationConfig(field={"colour": 1}),
    "box inside out": lambda m: mm.FieldConfig(domain=(1, 0, 0, 0, 1, 1)),
    "setting without a name": lambda m: mm.FieldConfig("spline"),
    "numbers": lambda m: FieldEstimator({"lengthscale": 1}),
    "text sample": lambda m: FieldEstimator(NUMBERS).update("here", [0, 0, 0]),
}  # fmt: skip


@pytest.mark.parametrize("bad", BAD_MAP_CALLS)
def test_settings_that_are_none_are_refused(bad, field_map):
    is_refused(lambda: BAD_MAP_CALLS[bad](field_map))


@pytest.mark.parametrize("far", [1e9, 1e100, 1e300])
def test_points_at_the_end_of_the_world_are_answered(far, field_map):
    said = field_map.evaluate([[far, 0, 0], [0, -far, 0]])
    assert np.isfinite(said.field).all()
    assert not field_map.knows([[far, 0, 0], [0, -far, 0]]).any()


# --- what a notebook shows ----------------------------------------------------------------------------------------


@pytest.fixture
def result(survey):
    links = Links(survey.positions[:5], survey.positions[:5])
    T = RigidTransform.identity()
    return mm.RegistrationResult(mm.Status.ACCEPTED, "9 of\n9 cells agree", T, probability=0.99, links=links)


def test_nouns_are_told_in_three_lines_and_a_light_picture(survey, field_map, result):
    refused = mm.RegistrationResult(mm.Status.NO_OVERLAP, "no overlap", None)
    odd = replace(survey, name="<b>\nroom", times=None, orientations=None)
    for noun in (survey, field_map, result, refused, odd, survey.subset([])):
        assert len(repr(noun).splitlines()) <= 3
        page = noun._repr_html_()
        assert len(page) < 20_000
        assert "http" not in page.replace('xmlns="http://www.w3.org/2000/svg"', "")
        ElementTree.fromstring(page)
    assert "40 samples" in repr(survey)
    assert "40 samples" in repr(field_map)
    assert "0.99" in repr(result)


def test_view_draws_each_noun(survey, field_map, result):
    go = pytest.importorskip("plotly.graph_objects")
    for figure in (mm.view(survey), mm.view(field_map), mm.view(result), mm.view(result, field_map, survey)):
        assert isinstance(figure, go.Figure)
    bare = mm.RegistrationResult(mm.Status.NO_OVERLAP, "no overlap", None)
    assert "view(result, base, target)" in is_refused(lambda: mm.view(bare))
    is_refused(lambda: mm.view(result, survey))
