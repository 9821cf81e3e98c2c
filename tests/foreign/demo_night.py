"""What the tests of other people's programs share: a night of the demo that has ended, a series of its frames with their stars, and how a program is run."""

import os
import pathlib
import shutil
import subprocess
import warnings

import numpy as np
import pytest
import shipped_sky
from astropy import units as u
from astropy.coordinates import SkyCoord
from astropy.io import fits
from astropy.wcs import WCS
from ports import free_port


class Night:
    """A demo that has ended: its files by type, and its folder."""

    def __init__(self, folder: pathlib.Path):
        self.folder = folder
        self.files = sorted((folder / "images").glob("2*/*.fits"))
        self.headers = {path: fits.getheader(path) for path in self.files}

    def of(self, kind: str) -> list[pathlib.Path]:
        return [path for path, header in self.headers.items() if header["IMAGETYP"] == f"{kind} Frame"]

    def solved(self) -> pathlib.Path:
        return next(path for path in self.of("Light") if self.headers[path].get("SOLVED"))


class Series:
    """The solved light frames of one target, what the shipped catalogue has around them, and its stars that are bright, alone and not saturated in all of them."""

    EDGE_PX, ALONE_PX, LEAST_ADU, MOST_ADU = 40, 20, 3000.0, 45_000.0

    def __init__(self, night: Night, paths: list[pathlib.Path]):
        self.paths, self.headers = paths, [night.headers[path] for path in paths]
        self.first = self.headers[0]
        ra, dec, mag = shipped_sky.stars()
        around = SkyCoord(self.first["RA"], self.first["DEC"], unit="deg").separation(SkyCoord(ra, dec, unit="deg"))
        near = around < self.first["NAXIS1"] * self.first["PIXSCALE"] * u.arcsec
        self.catalogue = ra, dec, mag = ra[near], dec[near], mag[near]
        good = np.full(len(ra), True)
        for path, header in zip(paths, self.headers):
            light = fits.getdata(path) - header["BKGLEVEL"]
            x, y = places(header, ra, dec)
            apart = np.hypot(x[:, None] - x, y[:, None] - y)
            np.fill_diagonal(apart, np.inf)
            good &= (np.minimum(x, y) > self.EDGE_PX) & (x < light.shape[1] - self.EDGE_PX) & (y < light.shape[0] - self.EDGE_PX)
            good &= apart.min(axis=1) > self.ALONE_PX
            brightest = [light[round(y[star]) - 3:round(y[star]) + 4, round(x[star]) - 3:round(x[star]) + 4].max() for star in np.flatnonzero(good)]
            good[good] = (self.LEAST_ADU < np.array(brightest)) & (np.array(brightest) < self.MOST_ADU)
        self.places, self.mag = SkyCoord(ra[good], dec[good], unit="deg"), mag[good]


def places(header, ra, dec) -> tuple[np.ndarray, np.ndarray]:
    """Columns and rows, from 0, of places in the sky."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # SWarp writes MJD-OBS alone, and astropy tells that it takes the date from there
        return WCS(header).all_world2pix(ra, dec, 0, quiet=True)


@pytest.fixture(scope="module")
def series(night) -> Series:
    """The one with the most stars that can be measured."""
    by_target: dict[str, list[pathlib.Path]] = {}
    for path in night.of("Light"):
        if night.headers[path].get("SOLVED"):
            by_target.setdefault(night.headers[path]["OBJECT"], []).append(path)
    best = max((Series(night, paths) for paths in by_target.values() if len(paths) >= 10), key=lambda series: len(series.mag))
    assert len(best.mag) >= 5, {target: len(paths) for target, paths in by_target.items()}
    return best


@pytest.fixture(scope="module")
def night(starmesh, tmp_path_factory) -> Night:
    """Where a kept night is given (`STARMESH_NIGHT`), that one."""
    if given := os.environ.get("STARMESH_NIGHT"):
        return Night(pathlib.Path(given))
    folder = tmp_path_factory.mktemp("demo") / "night"
    subprocess.run([starmesh, "demo", "--speed", "300", "--size-px", "1024", "--port", str(free_port()), "--keep", str(folder)],
                   capture_output=True, timeout=600, check=False)
    return Night(folder)


@pytest.fixture(scope="module")
def lco(night, starmesh, tmp_path_factory) -> list[pathlib.Path]:
    """Copies of all files by the profile of LCO's archive."""
    out = tmp_path_factory.mktemp("copies") / "lco"
    run(starmesh, "fits", "convert", *night.files, "--profile", "lco", "--out", out, "--set", "SITEID=dem", "--set", "TELID=0m3a")
    return sorted(out.iterdir())


def run(*command, **options) -> str:
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True, timeout=1800, **options)
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return done.stdout


def debian(program: str, package: str) -> str:
    """The version of a program's package."""
    assert shutil.which(program), f"{program} is missing: apt-get install {package} (scripts/setup proof does)"
    return run("dpkg-query", "-W", "-f", "${Version}", package)
