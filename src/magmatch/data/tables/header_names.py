# SPDX-License-Identifier: BSD-3-Clause
"""Names of columns as people write them, such as ``p_RS_R_x [m]`` or ``pose.position.x``: our names of them."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from magmatch.data.units import FieldUnit, LengthUnit, TimeUnit

# What words before an axis say that it is of: positions, orientations, the field, or another vector.
_KINDS: Mapping[str, str] = {
    **dict.fromkeys(("p", "pos", "pose", "position", "t", "trans", "translation", "loc", "location", "coord"), ""),
    **dict.fromkeys(("q", "quat", "quaternion", "o", "ori", "rot", "rotation", "orientation", "attitude"), "q"),
    **dict.fromkeys(("b", "m", "mag", "magn", "magnetic", "magnetometer", "magfield", "field"), "b"),
    **dict.fromkeys(("v", "vel", "velocity", "twist", "linear", "a", "acc", "accel", "acceleration"), "?"),
    **dict.fromkeys(("w", "omega", "angular", "g", "gyr", "gyro", "rate", "rotvec", "bias", "ba", "bg"), "?"),
    **dict.fromkeys(("cov", "covariance", "sd", "sigma", "std", "var"), "?"),
}
_TIMES = {
    "t", "time", "times", "timestamp", "timestamps", "stamp", "epoch", "sec", "secs", "seconds", "nsec", "nsecs"
}  # fmt: skip
_UNITS: Mapping[str, TimeUnit | LengthUnit | FieldUnit] = {
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), "s"),
    **dict.fromkeys(("ms", "msec", "msecs", "millisecond", "milliseconds"), "ms"),
    **dict.fromkeys(("us", "µs", "μs", "usec", "usecs", "microsecond", "microseconds"), "us"),
    **dict.fromkeys(("ns", "nsec", "nsecs", "nanosec", "nanosecond", "nanoseconds"), "ns"),
    **dict.fromkeys(("m", "meter", "meters", "metre", "metres"), "m"),
    **dict.fromkeys(("cm", "centimeter", "centimeters", "centimetre", "centimetres"), "cm"),
    **dict.fromkeys(("mm", "millimeter", "millimeters", "millimetre", "millimetres"), "mm"),
    **dict.fromkeys(("ut", "µt", "μt", "microtesla"), "uT"),
    **dict.fromkeys(("nt", "nanotesla"), "nT"),
}
# How `rostopic echo -p` names what it prints: fields, and among them the time of the measurement.
_OF_MESSAGE, _STAMP = "field.", "field.header.stamp"
_BRACKETS = re.compile(r"\s*[\[({]([^\[\](){}]*)[\])}]")


@dataclass(frozen=True, slots=True)
class Header:
    """The names of a table's columns, and ours of them."""

    words: tuple[str, ...]  # as they stand there
    names: tuple[str, ...]  # "" where a word is not known, "?" where it is known to be something else
    units: Mapping[str, str]  # of names that state one

    def names_all(self, wanted: Sequence[str]) -> bool:
        """Whether each of some columns is named, and once."""
        return all(self.names.count(name) == 1 for name in wanted)

    def against(self, wanted: Sequence[str]) -> str:
        """The first word that does not fit where a column of this order should be; empty where all may."""
        for word, name, expected in zip(self.words, self.names, wanted, strict=False):
            # An axis alone says nothing about the kind: x y z x y z w. Of q0, q[1] nobody knows which is w.
            is_axis = _BRACKETS.sub("", word.lower()) == expected[-1]
            is_part = not name and word.lower().startswith("q")
            if is_part or not (name in ("", expected) or is_axis):
                return f"'{word}' stands where {expected} is expected ({' '.join(wanted)})"
        return ""


def is_of_rostopic(words: Sequence[str]) -> bool:
    """Whether these are the names of ``rostopic echo -p``: fields of a message, below when it was received."""
    return bool(words) and words[0] == "%time" and any(word.startswith(_OF_MESSAGE) for word in words)


def header_of(words: Sequence[str], lone: str = "") -> Header:
    """Read names of columns; `lone` is what axes without a word before them are of: "b" of the field."""
    if is_of_rostopic(words):
        clock = _STAMP if _STAMP in words else words[0]
        of_fields = (_name_of(word.removeprefix(_OF_MESSAGE), lone) for word in words)
        found = [("?" if name == "t" else name, unit) for name, unit in of_fields]  # no further times
        found = [("t", "ns") if word == clock else one for word, one in zip(words, found, strict=True)]
    else:
        found = [_name_of(word, lone) for word in words]
    units = {name: unit for name, unit in found if name and unit}
    return Header(tuple(word.strip() for word in words), tuple(name for name, _ in found), units)


def unit_of(word: str) -> str:
    """The unit that a column's name states, of whatever the column is; "" where it states none."""
    return _name_of(word, "")[1]


def words_of(line: str) -> list[str]:
    """Names of columns in one line, whatever parts them; units in brackets stay with their name."""
    held = _BRACKETS.sub(lambda found: f"[{''.join(found[1].split())}]".replace(",", "").replace(";", ""), line)
    mark = next((mark for mark in (",", ";", "\t") if mark in held), None)
    words = [word.strip().strip("'\"") for word in held.split(mark)]
    while words and not words[-1]:
        words.pop()
    return words


def _name_of(word: str, lone: str) -> tuple[str, str]:
    """Our name of a column ("" where it is not known, "?" where it is something else), and the unit it states."""
    word = re.sub(r"^[^:]*:\s+", "", word.lower())  # "format: t"
    brackets = _BRACKETS.search(word)
    unit = _UNITS.get(brackets[1].strip(), "") if brackets else ""
    parts = re.findall(r"[^\W\d_]+|\d+", _BRACKETS.sub("", word))
    if len(parts) > 1 and parts[-1] in _UNITS:
        unit = unit or _UNITS[parts.pop()]
    if not parts:
        return "", unit
    if parts[-1] in _TIMES and (parts[-1] != "t" or len(parts) == 1):
        return "t", unit or _UNITS.get(parts[-1], "")
    *before, last = parts
    if len(last) > 1 and last[-1] in "xyzw" and last[:-1] in _KINDS:
        before, last = [*before, last[:-1]], last[-1]
    elif last not in tuple("xyzw") and parts[0] in tuple("xyzw") and len(parts) > 1:
        before, last = parts[1:], parts[0]
    if last not in tuple("xyzw"):
        return "", unit
    kind = _kind_of(before) if before else lone
    if last == "w":
        return ("qw" if kind in ("q", "") else "" if kind is None else "?"), unit
    return ("" if kind is None else "?" if kind == "?" else kind + last), unit


def _kind_of(parts: Sequence[str]) -> str | None:
    """Find what an axis belongs to: the last whole word says it, else the first letter; letters behind are frames."""
    words = [part for part in reversed(parts) if len(part) > 2] + [part for part in parts if len(part) <= 2]
    return next((_KINDS[part] for part in words if part in _KINDS), None)
