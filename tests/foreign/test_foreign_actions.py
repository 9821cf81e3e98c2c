"""The actions on hardware that we did not write, under a twilight that we did not write: from flats of the dusk to whole headers.

Hardware and sky: PyPI alpaca-simulators, whose camera (PyPI cabaret) adds the light of the Sun by its true altitude at the site:
the site is put where the Sun goes down now. `open` under a sky that turns bad is in test_foreign_night.py; `autofocus`,
`calibrate_guiding` and guided objects with their figures are in test_foreign_sky.py. Of the ten actions all have so run on these
devices. What they cannot show: their camera sees neither cover nor lamp, so the light of a panel's flats is that of their sky.
"""

import pathlib
import re
import sqlite3
import subprocess
import sys

import numpy as np
import pytest
import shapes
from astropy import units as u
from astropy.coordinates import AltAz, EarthLocation, SkyCoord, get_body_barycentric, get_sun
from astropy.io import fits
from astropy.time import Time
from bus_subscriber import BusSubscriber
from site_under_test import ELEVATION, LATITUDE, PREFIX, Record, Site, observing

STATE = f"{PREFIX}/observatory/%s/state"
SUN_DEG = -9.7  # when the night begins; it then sinks by a sixth of a degree a minute
BIAS_ADU, TARGET_ADU = 300, 900  # cabaret's bias; 4 s of that sky
BLOCKS = {
    "camera": f"flats = {{ target_adu = {TARGET_ADU}, exposure_min_s = 0.5, exposure_max_s = 20.0, dither_arcsec = 30.0 }}",
    # their dome turns slowly, and is followed in the other two nights
    "dome": 'follow = "off"',
}
PLACES = 2
ROWS = [
    # action, frames that count
    ("cool_camera", 0), ("open", 0), ("flats", 2), ("pointing_model", PLACES), ("object", 2), ("object", 2),
    ("close", 0), ("flats", 2), ("calibration", 4), ("complete_headers", 0),
]

SIMULATORS = {
    "devices": {
        # the camera draws ICRS
        "telescope": {0: {"equatorialsystem": 2}},
        "covercalibrator": {0: {"calibratorstate": 1, "coverstate": 1}},
    },
    "pointing_error_ra": 0.8,  # arcmin of the coordinate
    "pointing_error_dec": -0.6,
    "sunlight": True,
}


def place(longitude: float) -> EarthLocation:
    return EarthLocation.from_geodetic(longitude, LATITUDE, ELEVATION)


def soon(seconds: float) -> Time:
    """So long from now."""
    at = Time.now() + seconds * u.s
    at.delta_ut1_utc = 0.0
    return at


def where_the_sun_sets() -> float:
    """The longitude of the site whose Sun stands at SUN_DEG now and sinks."""
    def sun(longitudes, when):
        return get_sun(when).transform_to(AltAz(obstime=when, location=place(longitudes))).alt.deg

    longitudes = np.arange(-180.0, 180.0, 0.25)
    off = np.abs(sun(longitudes, soon(0)) - SUN_DEG)
    off[sun(longitudes, soon(60)) > sun(longitudes, soon(0))] = np.inf
    return float(longitudes[np.argmin(off)])


def seen(elements: dict, when: Time) -> SkyCoord:
    """Where a body on a circle round the Sun stands, from the middle of the Earth; light takes no time."""
    a, node, lean = elements["a_au"], np.radians(elements["node_deg"]), np.radians(elements["i_deg"])
    days = when.tt.jd - elements["epoch_jd"]
    along = np.radians(elements["m_deg"] + 0.9856076686 / a**1.5 * days)  # Gauss' constant, degrees a day
    x, y, tilt = a * np.cos(along), a * np.sin(along), np.radians(23.4392911)
    ecliptic = [x * np.cos(node) - y * np.cos(lean) * np.sin(node), x * np.sin(node) + y * np.cos(lean) * np.cos(node),
                y * np.sin(lean)]
    place = np.array([ecliptic[0], ecliptic[1] * np.cos(tilt) - ecliptic[2] * np.sin(tilt),
                      ecliptic[1] * np.sin(tilt) + ecliptic[2] * np.cos(tilt)])
    for body, sign in [("sun", 1), ("earth", -1)]:
        place = place + sign * get_body_barycentric(body, when, ephemeris="builtin").xyz.to_value(u.au)
    at = SkyCoord(*place, unit=u.au, representation_type="cartesian", frame="icrs").spherical
    return SkyCoord(ra=at.lon, dec=at.lat, frame="icrs")


def asteroid(here: EarthLocation) -> dict:
    """Elements of a small body, made up so that it stands high for the next minutes."""
    when = soon(90)
    horizon = AltAz(obstime=when, location=here)
    circle = {"a_au": 2.4, "e": 0.0, "i_deg": 40.0, "peri_deg": 0.0, "epoch_jd": round(when.tt.jd, 4)}
    bodies = [circle | {"node_deg": node, "m_deg": mean} for node in range(0, 360, 45) for mean in range(0, 360, 10)]
    places = SkyCoord([seen(body, when) for body in bodies]).transform_to(horizon).alt.deg
    assert places.max() > 40, places.max()
    return bodies[int(np.argmax(places))]


class NightRecord(Record):
    """What is left of the night for the tests below."""

    elements: dict
    rates: list[float]
    rates_at_end: list[float]
    at: Time
    cover: list[tuple[str, str, int]]


@pytest.fixture(scope="module")
def night(starmesh, tmp_path_factory):
    longitude = where_the_sun_sets()
    here = place(longitude)
    folder = tmp_path_factory.mktemp("actions")
    # a minute from now the rows look at these places
    later = soon(60)
    target, *model = SkyCoord(alt=[75, 85, 30] * u.deg, az=[90, 0, 0] * u.deg,
                              frame=AltAz(obstime=later, location=here)).transform_to("icrs")
    catalogue = folder / "stars.db"
    dense = [word for at in [target, *model] for word in ("--dense", f"{at.ra.deg:.4f}", f"{at.dec.deg:.4f}")]
    script = pathlib.Path(__file__).with_name("make_catalogue.py")
    subprocess.run([sys.executable, str(script), str(catalogue), "--small", *dense], check=True, stdout=subprocess.DEVNULL)
    changed = {**SIMULATORS, "devices": {**SIMULATORS["devices"], "telescope": {
        0: {**SIMULATORS["devices"]["telescope"][0], "sitelongitude": longitude}}}}
    site = Site(starmesh, folder, catalogue, changed, longitude=longitude, blocks=BLOCKS)
    record = NightRecord()
    record.site = site
    with observing(record):
        observe(site, record, target, asteroid(here))
    yield record


def observe(site: Site, record: NightRecord, target: SkyCoord, elements: dict):
    record.elements = elements
    where = {"ra": float(target.ra.deg), "dec": float(target.dec.deg)}
    site.put("safetymonitor/0/issafe", IsSafe="true")
    site.start_nodes()
    subscriber = record.subscriber = BusSubscriber(site.endpoint)
    # rows that ask nothing of the sky would go before those that wait for a safe one
    subscriber.wait_for("the sky is safe", lambda n: n.get(STATE % "safety", {}).get("verdict") == "safe", 60)
    site.schedule([
        ("cool_camera", {}),
        ("open", {}),
        ("flats", {"filter": ["Clear"], "n": [2]}),
        ("pointing_model", {"n": PLACES, "exptime": 1.0, "dark_subtraction": True}),
        ("object", where | {"object": "Field", "exptime": 1.0, "n": 2, "filter": "Clear", "pointing": True}),
        ("object", {"object": "asteroid", "exptime": 2.0, "n": 2, "elements": elements}),
        ("close", {}),
        ("flats", {"filter": ["Clear"], "n": [2], "source": "panel", "brightness": 200}),
        ("calibration", {"exptime": [0, 1.0], "n": [2, 2]}),
        ("complete_headers", {}),
    ], seconds=600)
    subscriber.wait_for("the schedule is seen", lambda n: len(n.get(STATE % "schedule", {}).get("rows", [])) == len(ROWS), 10)
    subscriber.wait_for("frames of the body that moves", lambda n: any(
        now["row"] == 5 and now["step"].startswith("exposing") for now in n[STATE % "night"]["actions"]), 150)
    record.rates, record.at = rates(site), soon(0)
    subscriber.wait_for("the night ends", lambda n: n[STATE % "night"]["ended"] and n[STATE % "night"]["frames"] > 0, 120)
    record.rates_at_end = rates(site)
    record.cover = [(p["fields"].get("cover"), p["fields"].get("calibrator"), p["fields"].get("brightness"))
                    for k, p in subscriber.received if k == f"{PREFIX}/device/covercalibrator/covercalibrator_1/state"]


def rates(site: Site) -> list[float]:
    """Of the mount beside the stars: seconds of right ascension a sidereal second, arcsec a second."""
    return [site.get(f"telescope/0/{name}") for name in ("rightascensionrate", "declinationrate")]


def frames(night) -> dict[str, dict]:
    """Announced frames by their ids; what a spool says twice counts once."""
    return {p["id"]: p for k, p in night.subscriber.received if k.endswith("/device/camera/camera_1/frame")}


def of_row(night, row: int, image_type: str) -> list[dict]:
    return [p for p in frames(night).values() if p["purpose"]["row"] == row and p["purpose"]["image_type"] == image_type]


def test_every_row_is_finished_in_its_order_with_its_frames(night):
    rows = night.subscriber.newest[STATE % "schedule"]["rows"]
    assert [(row["action"], row["status"], row["frames"]) for row in rows] == [(a, "finished", n) for a, n in ROWS], rows
    finished = []
    for key, payload in night.subscriber.received:
        if key == STATE % "schedule":
            finished += [row["row"] for row in payload["rows"] if row["status"] == "finished" and row["row"] not in finished]
    assert finished == list(range(len(ROWS)))
    nodes = {name: code for name, code in night.exit_codes.items() if name != "simulators"}
    assert nodes == {"observatory": 0, "device": 0, "archive": 0, "web": 0}


def test_every_exposure_is_one_file_and_one_row(night):
    """What the simulators' own log says they were asked to expose."""
    log = (night.site.folder / "simulators.log").read_text()
    exposed = len(re.findall(r'"PUT /api/v1/camera/0/startexposure HTTP/1.1" 200', log))
    ids = [fits.getheader(path)["FRAMEID"] for path in night.site.fits()]
    database = sqlite3.connect(night.site.folder / "data" / "archive.db")
    rows = dict(database.execute("SELECT frame_id, complete_hdr FROM images").fetchall())
    assert exposed > 15 and len(ids) == len(set(ids)) == exposed
    assert set(ids) == set(rows) == set(frames(night)) and set(rows.values()) == {1}
    # the pointing model has taken its dark, the calibrations are what was asked for
    assert len(of_row(night, 3, "Dark Frame")) == 1
    assert (len(of_row(night, 8, "Bias Frame")), len(of_row(night, 8, "Dark Frame"))) == (2, 2)


def test_it_ends_closed_parked_covered_and_dark(night):
    newest = night.subscriber.newest
    assert newest[f"{PREFIX}/device/dome/dome_1/state"]["fields"]["shutter"] == "closed"
    assert newest[f"{PREFIX}/device/telescope/telescope_1/state"]["fields"]["at_park"] is True
    assert night.cover[-1][:2] == ("closed", "off"), night.cover[-1]
    # open under the sky, and lit behind the closed cover
    assert any(cover == "open" for cover, _, _ in night.cover)
    lit = [(cover, brightness) for cover, calibrator, brightness in night.cover if calibrator == "ready"]
    assert lit and set(lit) == {("closed", 200)}, set(lit)


def test_flats_have_the_level_that_was_asked_for(night):
    for row in (2, 7):
        flats = {frame["id"] for frame in of_row(night, row, "Flat Frame")}
        levels = []
        for path in night.site.fits():
            header, data = fits.getheader(path), fits.getdata(path)
            if header["FRAMEID"] in flats and "REFUSED" not in header:
                levels.append(float(np.median(data)))
                assert header["BKGLEVEL"] == pytest.approx(levels[-1], abs=2)
        print(f"row {row}: {levels} ADU, {TARGET_ADU} wanted")
        assert len(levels) == 2 and all(abs(level - TARGET_ADU) <= 0.2 * TARGET_ADU for level in levels)


def test_the_model_learns_how_the_mount_misses(night):
    """The simulators draw the sky 0.8 arcmin of right ascension and 0.6 arcmin of declination beside what the mount says."""
    models = night.subscriber.newest[STATE % "pointing"]["models"]
    points = [point for model in models for point in model["points"]]
    assert len(points) >= PLACES, models
    for point in points:
        east = SIMULATORS["pointing_error_ra"] * np.cos(np.radians(point["dec_deg"]))
        # refraction is no matter of these simulators, and the first slew ends within their step
        assert point["east_arcmin"] == pytest.approx(east, abs=0.15), point
        assert point["north_arcmin"] == pytest.approx(SIMULATORS["pointing_error_dec"], abs=0.15), point


def test_a_target_that_moves_is_followed_and_the_stars_again_after_it(night):
    """By the rates that astropy and Kepler expect; the Earth's turning adds some percent, by parallax."""
    before, after = (seen(night.elements, night.at + side * 300 * u.s) for side in (-1, 1))
    ra_s = (after.ra - before.ra).wrap_at(180 * u.deg).deg * 240 / 600 / 1.00273790935
    dec_arcsec = (after.dec - before.dec).arcsec / 600
    print(f"rates {night.rates}, expected {ra_s:.6f} s/s, {dec_arcsec:.5f} arcsec/s")
    slack = 0.1 * np.hypot(15 * ra_s, dec_arcsec)
    assert night.rates[0] == pytest.approx(ra_s, abs=slack / 15) and night.rates[1] == pytest.approx(dec_arcsec, abs=slack)
    assert night.rates_at_end == [0, 0]
    assert len(of_row(night, 5, "Light Frame")) == 2


def test_every_payload_has_its_golden_shape(night):
    assert night.subscriber.unreadable == []
    faults = {f"{key}: {fault}" for key, payload in night.subscriber.received for fault in shapes.check(key, payload)}
    assert not faults, "\n".join(sorted(faults)[:20])
