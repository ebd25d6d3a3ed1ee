# SPDX-License-Identifier: BSD-3-Clause
"""Is the survey's mean field that of the Earth at its place and date? Magnitude and inclination against the IGRF."""

from dataclasses import dataclass
from datetime import date, datetime
from typing import Any

import numpy as np

from magmatch.data.diagnoses import PLAUSIBLE_BEND, inclination_deg
from magmatch.data.units import field_text
from magmatch.errors import ConfigurationError, import_extra
from magmatch.typing import Vectors

# Indoors, steel changes the mean field of a room by some tens of percent and bends it by some tens of degrees.
PLAUSIBLE_RATIO = (0.6, 1.6)
# The 14th generation of the model holds for these years.
FIRST_YEAR, LAST_YEAR = 1900, 2030
NANOTESLA = 1e-9


@dataclass(frozen=True, slots=True)
class Place:
    """Where and when a survey was made."""

    latitude_deg: float  # geodetic, degrees north and east
    longitude_deg: float
    height: float  # m: above the ellipsoid (above sea level does as well: 100 m change the field by 0.005 %)
    day: date

    def __post_init__(self) -> None:
        if not (-90 <= self.latitude_deg <= 90 and -180 <= self.longitude_deg <= 360):
            place = f"{self.latitude_deg:g}, {self.longitude_deg:g}"
            msg = f"expected a latitude of -90 to 90 and a longitude of -180 to 360 degrees, got {place}"
            raise ConfigurationError(msg)
        if not -10e3 <= self.height <= 600e3:
            msg = f"expected a height of -10 to 600 km in metres, got {self.height:g} m"
            raise ConfigurationError(msg)
        if not FIRST_YEAR <= self.day.year < LAST_YEAR:
            msg = f"expected a date from {FIRST_YEAR} to {LAST_YEAR - 1}, which the model covers, got {self.day}"
            raise ConfigurationError(msg)


@dataclass(frozen=True, slots=True)
class EarthFieldCheck:
    """The survey's field beside the model's."""

    magnitude: float  # T: of the mean vector
    expected_magnitude: float  # T
    inclination_deg: float  # angle below the horizontal; taken from the survey's z axis as the vertical
    expected_inclination_deg: float
    words: str  # what is odd about it, or that nothing is
    is_plausible: bool

    def figures(self) -> dict[str, Any]:
        """Plain numbers for the report."""
        return {
            "magnitude": self.magnitude,
            "expected_magnitude": self.expected_magnitude,
            "inclination_deg": self.inclination_deg,
            "expected_inclination_deg": self.expected_inclination_deg,
            "is_plausible": self.is_plausible,
        }


def check_earth_field(field: Vectors, place: Place) -> EarthFieldCheck:
    """Compare a survey's mean field with the International Geomagnetic Reference Field."""
    model, mean = earth_field(place), field.mean(axis=0)
    expected = float(np.linalg.norm(model))
    magnitude = float(np.linalg.norm(mean))
    dip, expected_dip = inclination_deg(mean), inclination_deg(model)
    ratio, bend = magnitude / expected, abs(dip - expected_dip)
    oddities = []
    if not PLAUSIBLE_RATIO[0] <= ratio <= PLAUSIBLE_RATIO[1]:
        oddities.append(f"its magnitude is {ratio:.3g} times that: {_ratio_advice(ratio)}")
    if bend > PLAUSIBLE_BEND:
        oddities.append(
            f"its inclination is {bend:.0f} deg off: z is not up in this frame, the field frame is wrong, "
            "or hard iron is left"
        )
    words = (
        f"mean field {field_text(magnitude)} at {dip:.0f} deg, Earth's field here "
        f"{field_text(expected)} at {expected_dip:.0f} deg"
    )
    words += ": " + ("; ".join(oddities) if oddities else "plausible")
    return EarthFieldCheck(magnitude, expected, dip, expected_dip, words, not oddities)


def earth_field(place: Place) -> np.ndarray:
    """Earth's field of the IGRF."""
    ppigrf = import_extra("ppigrf", "the check against the Earth's field", "igrf")
    when = datetime(place.day.year, place.day.month, place.day.day)
    components = ppigrf.igrf(place.longitude_deg, place.latitude_deg, place.height / 1e3, when)
    return np.array([float(np.ravel(c)[0]) for c in components]) * NANOTESLA


def _ratio_advice(ratio: float) -> str:
    """What a wrong magnitude most likely means."""
    power = np.log10(ratio)
    if abs(power - round(power)) < 0.25 and round(power) != 0:
        return f"a unit that is off by 10^{round(power)} (--field-unit)?"
    return "strong steel nearby, hard iron left, or another place?"
