"""Focus, calibrate, point and guide under a sky and on a mount that we did not write.

Hardware and sky: PyPI alpaca-simulators, whose camera draws (with PyPI cabaret) the stars of the catalogue that
make_catalogue.py invents, where the mount says it points plus an error that it does not tell; the mount drifts, and the
stars widen with the distance from the focus. Starmesh is given the same catalogue and nothing else of that sky. Judges:
astropy, and what the simulators were told. (That solutions fall on the light of the stars is proven in
test_foreign_night.py.)
"""

import numpy as np
import pytest
import shapes
from astropy import units as u
from astropy.coordinates import EarthLocation, SkyCoord
from astropy.io import fits
from astropy.time import Time
from astropy.wcs import WCS
from bus_subscriber import BusSubscriber
from site_under_test import ELEVATION, LATITUDE, LONGITUDE, PREFIX, Record, Site, dense_field, observing

STATE = f"{PREFIX}/observatory/%s/state"
OBJECT = "Foreign field"
FRAMES = 24
EXPOSURE_S = 1.0
SCALE_ARCSEC_PX = 0.2578  # 10 um at 8 m
GUIDE_ARCSEC_S = 3.6  # 0.001 deg/s
BEST_FOCUS = 10_000  # written in the simulators' camera.py
DRIFT_ARCSEC_S = 0.02  # in right ascension (of the coordinate) and in declination, since the last slew

SIMULATORS = {
    "devices": {
        # the camera draws ICRS, and the template's 0 says "other" while its comment says J2000
        "telescope": {0: {"equatorialsystem": 2}},
        "camera": {0: {"rotation": 17.0}},
        "focuser": {0: {"position": BEST_FOCUS + 130}},
    },
    "pointing_error_ra": 1.5,  # arcmin of the coordinate
    "pointing_error_dec": -1.0,
    "bad_tracking": True,
    "bad_tracking_rate": DRIFT_ARCSEC_S,
}


class NightRecord(Record):
    """What is left of the night for the tests below."""

    target: SkyCoord
    focuser_position: int


@pytest.fixture(scope="module")
def night(starmesh, catalogue, tmp_path_factory):
    site = Site(starmesh, tmp_path_factory.mktemp("sky"), catalogue, SIMULATORS)
    record = NightRecord()
    record.site = site
    with observing(record):
        observe(site, record)
    yield record


def observe(site: Site, record: NightRecord):
    now = Time.now()
    now.delta_ut1_utc = 0.0
    sidereal = now.sidereal_time("mean", EarthLocation.from_geodetic(LONGITUDE, LATITUDE, ELEVATION).lon).deg
    target = record.target = SkyCoord(dense_field(sidereal) * u.deg, 50.0 * u.deg)
    where = {"ra": target.ra.deg, "dec": target.dec.deg, "filter": "Clear"}
    site.put("safetymonitor/0/issafe", IsSafe="true")
    site.schedule([
        ("open", {}),
        ("autofocus", where | {"exptime": 0.5, "search_range": [BEST_FOCUS - 300, BEST_FOCUS + 300]}),
        ("calibrate_guiding", where | {"exptime": 0.5, "settle_time": 0.2}),
        ("object", where | {"object": OBJECT, "exptime": EXPOSURE_S, "n": FRAMES, "pointing": True, "guiding": True}),
        ("complete_headers", {}),
    ], seconds=900)
    site.start_nodes()
    subscriber = record.subscriber = BusSubscriber(site.endpoint)
    subscriber.wait_for("the night ends", lambda n: n.get(STATE % "night", {}).get("ended"), 420)
    record.focuser_position = site.get("focuser/0/position")


def lights(night) -> list[fits.Header]:
    """Headers of the frames that the row itself has taken, oldest first; those of the pointing are not among them."""
    own = {p["id"] for p in received(night, "/frame") if (p["purpose"]["action"], p["purpose"].get("object")) == ("object", OBJECT)}
    headers = [fits.getheader(path) for path in night.site.fits()]
    return sorted((header for header in headers if header["FRAMEID"] in own), key=lambda header: header["DATE-OBS"])


def received(night, ending: str) -> list[dict]:
    return [payload for key, payload in night.subscriber.received if key.endswith(ending)]


def test_every_row_is_finished(night):
    rows = night.subscriber.newest[STATE % "schedule"]["rows"]
    assert [row["status"] for row in rows] == ["finished"] * 5, rows
    assert len(lights(night)) == FRAMES
    nodes = {name: code for name, code in night.exit_codes.items() if name != "simulators"}
    assert nodes == {"observatory": 0, "device": 0, "archive": 0, "web": 0}


def test_every_payload_has_its_golden_shape(night):
    assert night.subscriber.unreadable == []
    faults = {f"{key}: {fault}" for key, payload in night.subscriber.received for fault in shapes.check(key, payload)}
    assert not faults, "\n".join(sorted(faults)[:20])


def test_the_focus_is_found_within_a_fifth_of_the_critical_zone(night):
    runs = received(night, "/observatory/focus/run")
    assert runs and runs[-1]["outcome"] == "focused", runs[-1:]
    off = abs(night.focuser_position - BEST_FOCUS)
    assert off <= 0.2 * runs[-1]["critical_zone"], (night.focuser_position, runs[-1])


def test_pulses_move_the_stars_as_the_mount_and_the_camera_are_built(night):
    calibration = [payload.get("calibration") for payload in received(night, "/observatory/guiding/state")]
    calibration = [learned for learned in calibration if learned and learned["source"] == "pulses"][-1]
    east, north = np.array(calibration["east_px_per_s"]), np.array(calibration["north_px_per_s"])
    expected = GUIDE_ARCSEC_S / SCALE_ARCSEC_PX
    # the mount drifts while it is calibrated, by up to a tenth of what a pulse moves it until the next frame
    print(f"East {east}, North {north} px/s, expected {expected} px/s, {calibration}")
    assert np.hypot(*north) == pytest.approx(expected, rel=0.03)
    assert np.hypot(*east) == pytest.approx(expected * np.cos(night.target.dec.rad), rel=0.03)
    between = np.degrees(np.arccos(east @ north / np.hypot(*east) / np.hypot(*north)))
    assert between == pytest.approx(90.0, abs=2.0)


def test_the_target_is_in_the_middle_of_every_frame(night):
    """The mount is off by 1.4 arcmin; the issue asks for 0.1."""
    for header in lights(night):
        assert header.get("SOLVED") is True, [str(line) for line in header.get("HISTORY", [])]
        middle = WCS(header).pixel_to_world((header["NAXIS1"] - 1) / 2, (header["NAXIS2"] - 1) / 2)
        off = middle.separation(night.target).arcmin
        assert off < 0.12, (header["DATE-OBS"], off)  # 0.1 when it began, and what guiding has not yet taken back


def test_guiding_holds_the_field_that_would_drift_away(night):
    """At most 0.35 px rms, measured by astropy on the solutions in the headers; unguided it drifts by pixels."""
    frames = lights(night)
    times = np.array([Time(header["DATE-OBS"]).unix for header in frames])
    # where the target stands in each frame
    places = np.array([WCS(header).world_to_pixel(night.target) for header in frames])
    unguided_px = DRIFT_ARCSEC_S * np.hypot(np.cos(night.target.dec.rad), 1) * (times[-1] - times[0]) / SCALE_ARCSEC_PX
    held = places[5:] - places[5:].mean(axis=0)
    rms_px = np.sqrt((held**2).sum(axis=1).mean())
    print(f"rms {rms_px:.3f} px over {times[-1] - times[5]:.0f} s, unguided {unguided_px:.1f} px")
    assert unguided_px > 1.5
    assert rms_px <= 0.35, places
    corrections = received(night, "/observatory/guiding/correction")
    assert len(corrections) >= FRAMES - 2, "each frame's correction is published"
