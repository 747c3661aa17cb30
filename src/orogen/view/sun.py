"""Where the sun stands at a place and time (The Astronomical Almanac, low precision formulas: 0.01 degrees)."""

from __future__ import annotations

import math
from datetime import UTC, datetime

J2000 = datetime(2000, 1, 1, 12, tzinfo=UTC)


def sun_position(longitude: float, latitude: float, when: datetime) -> tuple[float, float]:
    """Azimuth (degrees clockwise from true north) and elevation (degrees, without refraction) of the sun.

    `longitude`, `latitude`: degrees east and north. `when`: with a time zone; without one it is in UTC. Good between
    the years 1950 and 2050.
    """
    if when.tzinfo is None:
        when = when.replace(tzinfo=UTC)
    days = (when - J2000).total_seconds() / 86400
    mean_longitude = 280.460 + 0.9856474 * days
    anomaly = math.radians(357.528 + 0.9856003 * days)
    ecliptic = math.radians(mean_longitude + 1.915 * math.sin(anomaly) + 0.020 * math.sin(2 * anomaly))
    obliquity = math.radians(23.439 - 0.0000004 * days)
    ascension = math.atan2(math.cos(obliquity) * math.sin(ecliptic), math.cos(ecliptic))
    declination = math.asin(math.sin(obliquity) * math.sin(ecliptic))
    sidereal = math.radians((280.46062 + 360.98564737 * days + longitude) % 360)
    hour, lat = sidereal - ascension, math.radians(latitude)
    elevation = math.asin(
        math.sin(lat) * math.sin(declination) + math.cos(lat) * math.cos(declination) * math.cos(hour)
    )
    azimuth = math.atan2(
        -math.sin(hour) * math.cos(declination),
        math.cos(lat) * math.sin(declination) - math.sin(lat) * math.cos(declination) * math.cos(hour),
    )
    return math.degrees(azimuth) % 360, math.degrees(elevation)


def parse_time(text: str) -> datetime:
    """A time such as "2026-06-21 09:30" (UTC) or "2026-06-21 09:30+02:00"; ValueError where it is none."""
    when = datetime.fromisoformat(text.strip())
    return when if when.tzinfo else when.replace(tzinfo=UTC)
