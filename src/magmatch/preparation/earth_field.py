# SPDX-License-Identifier: BSD-3-Clause
"""Is the survey's mean field that of the Earth at its place and date? Magnitude and inclination against the IGRF."""

from dataclasses import dataclass
from datetime import date, datetime

import numpy as np

from magmatch.data.diagnoses import PLAUSIBLE_BEND, inclination_deg
from magmatch.data.geodesy import MOST_LATITUDE
from magmatch.data.units import TESLA_PER_UNIT, field_text
from magmatch.errors import ConfigurationError, import_extra
from magmatch.preparation.preparation_report import StepReport
from magmatch.typing import Vectors

# Indoors, steel changes the mean field of a room by some tens of percent and bends it by some tens of degrees.
PLAUSIBLE_RATIO = (0.6, 1.6)
# The 14th generation of the model holds for these years.
FIRST_YEAR, LAST_YEAR = 1900, 2030
# At a pole no direction is east, and the model divides by zero; nearer than 0.1 m it is not asked.
MOST_LATITUDE_DEG = MOST_LATITUDE - 1e-6


@dataclass(frozen=True, slots=True)
class Place:
    """The place and time of a survey."""

    latitude_deg: float  # geodetic, degrees north and east
    longitude_deg: float
    height: float  # m: above the ellipsoid (above sea level does as well: 100 m change the field by 0.005 %)
    day: date

    def __post_init__(self) -> None:
        if not (abs(self.latitude_deg) <= MOST_LATITUDE and -180 <= self.longitude_deg <= 360):
            place = f"{self.latitude_deg:g}, {self.longitude_deg:g}"
            msg = f"expected a latitude of -90 to 90 and a longitude of -180 to 360 degrees, got {place}"
            raise ConfigurationError(msg)
        if not -10e3 <= self.height <= 600e3:
            msg = f"expected a height of -10 to 600 km in metres, got {self.height:g} m"
            raise ConfigurationError(msg)
        if not FIRST_YEAR <= self.day.year < LAST_YEAR:
            msg = f"expected a date from {FIRST_YEAR} to {LAST_YEAR - 1}, which the model covers, got {self.day}"
            raise ConfigurationError(msg)


def earth_step(field: Vectors, place: Place | None) -> StepReport:
    """Compare a survey's mean field, its z axis up, with the International Geomagnetic Reference Field of a place."""
    if place is None:
        return StepReport("earth field", "off", "no place and date given")
    model, mean = earth_field(place), field.mean(axis=0)
    expected = float(np.linalg.norm(model))
    magnitude = float(np.linalg.norm(mean))
    dip, expected_dip = inclination_deg(mean), inclination_deg(model)
    ratio, bend = magnitude / expected, abs(dip - expected_dip)
    oddities = []
    if not PLAUSIBLE_RATIO[0] <= ratio <= PLAUSIBLE_RATIO[1]:
        oddities.append(f"its magnitude is {ratio:.3g} times that: {_ratio_advice(ratio)}")
    if bend > PLAUSIBLE_BEND:
        why = "z is not up in this frame, the field frame is wrong, or hard iron is left"
        oddities.append(f"its inclination is {bend:.0f} deg off: {why}")
    here, there = f"{field_text(magnitude)} at {dip:.0f} deg", f"{field_text(expected)} at {expected_dip:.0f} deg"
    words = f"mean field {here}, Earth's field here {there}: {'; '.join(oddities) or 'plausible'}"
    figures = {
        "magnitude": magnitude, "expected_magnitude": expected, "inclination_deg": dip,
        "expected_inclination_deg": expected_dip, "is_plausible": not oddities,
    }  # fmt: skip
    return StepReport("earth field", "flagged" if oddities else "unchanged", words, figures=figures)


def earth_field(place: Place) -> np.ndarray:
    """Earth's field of the IGRF."""
    ppigrf = import_extra("ppigrf", "the check against the Earth's field", "igrf")
    when = datetime(place.day.year, place.day.month, place.day.day)
    latitude = float(np.clip(place.latitude_deg, -MOST_LATITUDE_DEG, MOST_LATITUDE_DEG))
    components = ppigrf.igrf(place.longitude_deg, latitude, place.height / 1e3, when)
    return np.array([float(np.ravel(c)[0]) for c in components]) * TESLA_PER_UNIT["nT"]


def _ratio_advice(ratio: float) -> str:
    """Say what a wrong magnitude most likely means."""
    power = np.log10(ratio) if ratio > 0 else 0.0
    if abs(power - round(power)) < 0.25 and round(power) != 0:
        return f"a unit that is off by 10^{round(power)} (--field-unit)?"
    return "strong steel nearby, hard iron left, or another place?"
