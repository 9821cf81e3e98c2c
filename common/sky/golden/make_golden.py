"""Writes golden.json, what astropy says about the sky, for tests/agrees_with_astropy.rs.

    python3 -m venv VENV && VENV/bin/pip install astropy && VENV/bin/python make_golden.py

Nothing is fetched: the Earth's orientation is given here, so that both sides use the same numbers.
Astropy uses its built-in ephemeris (epv00, moon98) and no refraction.
"""

import json
import pathlib

import astropy
import astropy.units as u
import numpy as np
from astropy.coordinates import (
    AltAz, EarthLocation, SkyCoord, TETE, get_body, get_body_barycentric, solar_system_ephemeris,
)
from astropy.time import Time, TimeDelta
from astropy.utils import iers
from astropy.wcs import WCS

iers.conf.auto_download = False
solar_system_ephemeris.set("builtin")


class Given(iers.IERS):
    """An Earth orientation that is the same at all times."""

    dut1_s = xp_arcsec = yp_arcsec = 0.0

    def ut1_utc(self, jd1, jd2=0.0, return_status=False):
        value = np.full(np.shape(getattr(jd1, "jd", jd1)), self.dut1_s) * u.s
        return (value, np.zeros(value.shape, int)) if return_status else value

    def pm_xy(self, jd1, jd2=0.0, return_status=False):
        shape = np.shape(getattr(jd1, "jd", jd1))
        x, y = np.full(shape, self.xp_arcsec) * u.arcsec, np.full(shape, self.yp_arcsec) * u.arcsec
        return (x, y, np.zeros(shape, int)) if return_status else (x, y)


given = Given()
iers.earth_orientation_table.set(given)

SITES = [  # name, latitude, longitude east, elevation
    ("paranal", -24.61573, -70.39760, 2518.0),
    ("san-pedro-martir", 31.04350, -115.45450, 2780.0),
    ("zurich", 47.40833, 8.50750, 541.0),
]
EPOCHS = [  # UTC, UT1-UTC s, polar motion arcsec; the first is the day of a leap second
    ("2016-12-31T18:00:00.000000Z", -0.4078, 0.0760, 0.2720),
    ("2021-06-21T03:14:15.926535Z", -0.1711, 0.1190, 0.4370),
    ("2026-11-21T03:00:00.000000Z", 0.0512, 0.1830, 0.3640),
    ("2031-03-01T12:30:00.500000Z", 0.2500, -0.1500, 0.5100),
]
TARGETS = [  # ICRS degrees: a plain one, the galactic centre, one by the pole, one at the seam of right ascension
    (83.633212, 22.014460),
    (266.416837, -29.007811),
    (37.954561, 89.264109),
    (359.999900, -60.500000),
]


def time_of(text, location):
    t = Time(text.rstrip("Z"), format="isot", scale="utc", location=location)
    t.delta_ut1_utc = given.dut1_s
    return t


def two_parts(t):
    day = np.floor(t.jd1)
    return [float(day), float((t.jd1 - day) + t.jd2)]


def altaz(coord, frame):
    there = coord.transform_to(frame)
    return {"altitude_deg": there.alt.deg, "azimuth_deg": there.az.deg}


def sun_altitude(t, location):
    return get_body("sun", t, location).transform_to(AltAz(obstime=t, location=location)).alt.deg


def next_crossing(start, location, altitude_deg, rising):
    """By bisection from astropy's own altitudes, as UTC text."""
    grid = np.arange(0.0, 48.0 * 3600.0, 600.0)
    above = sun_altitude(start + TimeDelta(grid, format="sec"), location) > altitude_deg
    for i in range(len(grid) - 1):
        if bool(above[i + 1]) == rising and bool(above[i]) != rising:
            low, high = grid[i], grid[i + 1]
            while high - low > 0.001:
                middle = (low + high) / 2
                t = start + TimeDelta(middle, format="sec")
                low, high = (low, middle) if bool(sun_altitude(t, location) > altitude_deg) == rising else (middle, high)
            return (start + TimeDelta((low + high) / 2, format="sec")).utc.isot + "Z"
    return None


def moon_fraction(t, location):
    """Lit part of the disk seen from the site: the phase angle from barycentric vectors, which know no aberration."""
    moon = get_body("moon", t, location).icrs.cartesian.xyz.to_value(u.au)
    sun = get_body("sun", t, location).icrs.cartesian.xyz.to_value(u.au)
    site = (get_body_barycentric("earth", t) + location.get_gcrs_posvel(t)[0]).xyz.to_value(u.au)
    to_sun, to_us = sun - moon, site - moon
    return float((1 + to_sun @ to_us / np.linalg.norm(to_sun) / np.linalg.norm(to_us)) / 2)


cases = []
for site, latitude, longitude, elevation in SITES:
    location = EarthLocation.from_geodetic(longitude * u.deg, latitude * u.deg, elevation * u.m)
    for utc, given.dut1_s, given.xp_arcsec, given.yp_arcsec in EPOCHS:
        t = time_of(utc, location)
        frame = AltAz(obstime=t, location=location)
        targets = []
        for ra, dec in TARGETS:
            coord = SkyCoord(ra, dec, unit="deg")
            of_date = coord.transform_to(TETE(obstime=t, location=location))
            targets.append({
                "ra_deg": ra, "dec_deg": dec, **altaz(coord, frame),
                "of_date_ra_deg": of_date.ra.deg, "of_date_dec_deg": of_date.dec.deg,
                "bjd_tdb": two_parts(t.tdb + t.light_travel_time(coord, "barycentric")),
                "heliocentric_light_time_s": t.light_travel_time(coord, "heliocentric").to_value(u.s),
            })
        cases.append({
            "site": site, "latitude_deg": latitude, "longitude_east_deg": longitude, "elevation_m": elevation,
            "utc": utc, "dut1_s": given.dut1_s,
            "polar_x_arcsec": given.xp_arcsec, "polar_y_arcsec": given.yp_arcsec,
            "apparent_sidereal_h": t.sidereal_time("apparent", longitude * u.deg).hour,
            "mean_sidereal_h": t.sidereal_time("mean", longitude * u.deg).hour,
            "sun": altaz(get_body("sun", t, location), frame),
            "moon": altaz(get_body("moon", t, location), frame),
            "moon_fraction": moon_fraction(t, location),
            "next_sunset": next_crossing(t, location, -0.833, False),
            "next_sunrise": next_crossing(t, location, -0.833, True),
            "next_dusk": next_crossing(t, location, -18.0, False),
            "targets": targets,
        })

tangent = []
for ra0, dec0 in [(83.633212, 22.01446), (0.05, -60.5), (37.95, 89.26)]:
    wcs = WCS(naxis=2)
    wcs.wcs.ctype, wcs.wcs.crval, wcs.wcs.crpix, wcs.wcs.cdelt = ["RA---TAN", "DEC--TAN"], [ra0, dec0], [0, 0], [1, 1]
    for xi, eta in [(0.0, 0.0), (0.25, -0.4), (-1.5, 1.1)]:
        ra, dec = wcs.wcs_pix2world([[xi, eta]], 1)[0]
        tangent.append({"center_ra_deg": ra0, "center_dec_deg": dec0, "xi_deg": xi, "eta_deg": eta,
                        "ra_deg": float(ra), "dec_deg": float(dec)})

golden = {"made_by": f"astropy {astropy.__version__}", "cases": cases, "tangent": tangent}
path = pathlib.Path(__file__).with_name("golden.json")
path.write_text(json.dumps(golden, indent=1, default=float) + "\n")
