# SPDX-License-Identifier: BSD-3-Clause
"""Places on the globe (WGS 84, degrees) in metres east, north and up of an origin."""

from dataclasses import dataclass

import numpy as np

from magmatch.errors import ConfigurationError
from magmatch.number_text import told
from magmatch.typing import Matrix, Points, Scalars

# Deg, either way; longitudes are counted from 0 or from -180.
MOST_LATITUDE, MOST_LONGITUDE = 90, 360
# The ellipsoid of WGS 84: semi-major axis in m, and squared eccentricity f (2 - f) of its flattening.
SEMI_MAJOR = 6_378_137.0
FLATTENING = 1 / 298.257223563
ECCENTRICITY_2 = FLATTENING * (2 - FLATTENING)


@dataclass(frozen=True, slots=True)
class Origin:
    """The point where a local frame touches the ellipsoid: x points east there, y north, z up."""

    latitude_deg: float
    longitude_deg: float
    altitude: float = 0.0  # m above the ellipsoid, or on whatever scale the heights are

    def __post_init__(self) -> None:
        wrong = what_is_wrong(np.array([self.latitude_deg]), np.array([self.longitude_deg]))
        if wrong or not np.isfinite(self.altitude):
            msg = f"origin: expected latitude, longitude in degrees, altitude in m; {wrong or 'found no height'}"
            raise ConfigurationError(msg)

    def __str__(self) -> str:
        return ",".join(
            map(repr, [self.latitude_deg, self.longitude_deg, *([self.altitude] if self.altitude else [])])
        )

    @classmethod
    def of(cls, text: str) -> "Origin":
        """The origin that a text such as ``48.1372,11.5756,519`` states."""
        try:
            return cls(*map(float, text.split(",")))
        except (TypeError, ValueError):
            msg = f"origin: expected LATITUDE,LONGITUDE or LATITUDE,LONGITUDE,ALTITUDE; found '{text[:60]}'"
            raise ConfigurationError(msg) from None

    @classmethod
    def near(cls, latitude_deg: float, longitude_deg: float, altitude: float) -> "Origin":
        """An origin within a metre that is short enough to be typed."""
        return cls(round(float(latitude_deg), 5), round(float(longitude_deg), 5), float(round(altitude)))


def what_is_wrong(latitudes_deg: Scalars, longitudes_deg: Scalars) -> str:
    """Say which numbers are no latitude or longitude; nothing if all are."""
    both = ("latitude", latitudes_deg, MOST_LATITUDE), ("longitude", longitudes_deg, MOST_LONGITUDE)
    for name, degrees, most in both:
        beyond = degrees[~(np.abs(degrees) <= most)]
        if len(beyond):
            return f"found a {name} of {told(beyond[0])}, expected degrees within {-most} to {most}"
    return ""


def look_like_radians(latitudes: Scalars, longitudes: Scalars) -> bool:
    """Whether numbers are in radians: as degrees, all lie in the Gulf of Guinea, where no land is."""
    return bool((np.abs(latitudes) <= np.pi / 2).all() and (np.abs(longitudes) <= np.pi).all())


def local_east_north(latitudes_deg: Scalars, longitudes_deg: Scalars, origin: Origin) -> Matrix:
    """Places on the ground, of any height, as metres east and north of the origin: (n, 2)."""
    at = np.full(len(latitudes_deg), origin.altitude)
    return local_east_north_up(latitudes_deg, longitudes_deg, at, origin)[:, :2]


def local_east_north_up(
    latitudes_deg: Scalars, longitudes_deg: Scalars, altitudes: Scalars, origin: Origin
) -> Points:
    """Places as metres east, north and up of the origin, exactly: axes are those of its own horizon.

    Latitudes and longitudes (n,) are on WGS 84, as satellite receivers and phones give them, altitudes (n,), m, on
    the origin's scale of heights. The frame of the places (n, 3) is flat: its horizon lies d^2 / 12,740 km above the
    ground at a distance d (8 cm at 1 km).

    Examples
    --------
    >>> origin = Origin(48.0, 11.0, 500.0)
    >>> local_east_north_up(np.array([48.001]), np.array([11.0]), np.array([500.0]), origin).round(2).tolist()
    [[0.0, 111.2, -0.0]]
    """
    phi, lam = np.radians(origin.latitude_deg), np.radians(origin.longitude_deg)
    east = [-np.sin(lam), np.cos(lam), 0.0]
    north = [-np.sin(phi) * np.cos(lam), -np.sin(phi) * np.sin(lam), np.cos(phi)]
    up = [np.cos(phi) * np.cos(lam), np.cos(phi) * np.sin(lam), np.sin(phi)]
    there = _geocentric(latitudes_deg, longitudes_deg, altitudes)
    here = _geocentric(*(np.array([v]) for v in (origin.latitude_deg, origin.longitude_deg, origin.altitude)))
    return np.asarray((there - here) @ np.array([east, north, up]).T)


def _geocentric(latitudes_deg: Scalars, longitudes_deg: Scalars, altitudes: Scalars) -> Points:
    """Places in the axes of the Earth, m."""
    phi, lam = np.radians(latitudes_deg), np.radians(longitudes_deg)
    normal = SEMI_MAJOR / np.sqrt(1 - ECCENTRICITY_2 * np.sin(phi) ** 2)
    flat = (normal + altitudes) * np.cos(phi)
    z = (normal * (1 - ECCENTRICITY_2) + altitudes) * np.sin(phi)
    return np.column_stack([flat * np.cos(lam), flat * np.sin(lam), z])
