"""Fields of the real sky, drawn through astropy's WCS with noise from fixed seeds, and what `starmesh solve` says of them."""

import json
import pathlib
import subprocess

import numpy as np
import pytest
from astropy.io import fits
from astropy.wcs import WCS
from shipped_sky import stars

SHAPE = (1000, 800)
SCALE_ARCSEC_PX = 8.0
# centre (deg), position angle of +y (deg), mirror image
FIELDS = [(84.0, 4.0, 30.0, False), (211.0, -62.0, -130.0, True), (0.4, 86.0, 75.0, True), (150.0, -31.0, 170.0, False)]


def tan(ra, dec, scale_arcsec_px, rotation_deg, mirrored) -> WCS:
    """A WCS by the meaning of what `starmesh solve` answers."""
    wcs, turn, side = WCS(naxis=2), np.radians(rotation_deg), -1 if mirrored else 1
    wcs.wcs.ctype = ["RA---TAN", "DEC--TAN"]
    wcs.wcs.crval = [ra, dec]
    wcs.wcs.crpix = [(SHAPE[0] + 1) / 2, (SHAPE[1] + 1) / 2]
    cd = [[side * np.cos(turn), np.sin(turn)], [-side * np.sin(turn), np.cos(turn)]]
    wcs.wcs.cd = np.array(cd) * scale_arcsec_px / 3600
    return wcs


def draw(path: pathlib.Path, truth: WCS, sky, seed: int) -> None:
    """Stars of the sky with a width of 3 px, photon noise, and nothing in the header."""
    ra, dec, mag = sky
    centre = np.radians(truth.wcs.crval)
    near = np.sin(np.radians(dec)) * np.sin(centre[1]) + np.cos(np.radians(dec)) * np.cos(centre[1]) * np.cos(
        np.radians(ra) - centre[0]
    ) > np.cos(np.radians(2.0))
    x, y = truth.all_world2pix(ra[near], dec[near], 0)
    image, rng = np.full((SHAPE[1], SHAPE[0]), 300.0), np.random.default_rng(seed)
    for at_x, at_y, brightness in zip(x, y, mag[near]):
        if not (-8 < at_x < SHAPE[0] + 7 and -8 < at_y < SHAPE[1] + 7):
            continue
        columns = np.arange(max(0, int(at_x) - 8), min(SHAPE[0], int(at_x) + 10))
        rows = np.arange(max(0, int(at_y) - 8), min(SHAPE[1], int(at_y) + 10))
        shape = np.exp(-((columns - at_x) ** 2 + (rows[:, None] - at_y) ** 2) / (2 * (3.0 / 2.3548) ** 2))
        image[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1] += 1500 * 10 ** (-0.4 * (brightness - 11)) * shape
    image = rng.poisson(image) + rng.normal(0, 5, image.shape)
    fits.writeto(path, np.clip(image, 0, 65535).astype(np.uint16))


def apart_px(one: WCS, other: WCS) -> float:
    """The greatest distance of centre and corners of the frame between two solutions, px."""
    right, top = SHAPE[0] - 1, SHAPE[1] - 1
    places = np.array([(right / 2, top / 2), (0, 0), (right, 0), (0, top), (right, top)])
    back = one.all_world2pix(other.all_pix2world(places, 0), 0)
    return float(np.hypot(*(back - places).T).max())


def ours(starmesh: str, frame: pathlib.Path, *options: str) -> WCS:
    """What `starmesh solve` answers, by our own means alone."""
    command = [starmesh, "solve", "--json", *options, str(frame)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, env={"PATH": "/nowhere"})
    answer = json.loads(done.stdout)
    assert answer["solved"] and answer["matched"] >= 10 and answer["false_alarm"] < 1e-6, answer
    return tan(*(answer[key] for key in ("ra_deg", "dec_deg", "scale_arcsec_px", "rotation_deg", "mirrored")))


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    """The frames with their truth."""
    sky, folder, frames = stars(), tmp_path_factory.mktemp("frames"), []
    for number, (ra, dec, rotation, mirrored) in enumerate(FIELDS):
        truth = tan(ra, dec, SCALE_ARCSEC_PX, rotation, mirrored)
        frame = folder / f"field{number}.fits"
        draw(frame, truth, sky, number)
        frames.append((frame, truth))
    return frames
