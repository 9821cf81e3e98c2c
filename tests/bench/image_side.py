#!/usr/bin/env python3
"""Measures the image side of Starmesh and of its predecessor's libraries on the same frames; see README.md beside this file.

It needs the example `bench_frames` of the crate `catalogue`, and makes the environment of side_by_side.py, in which it
runs itself again: cabaret draws the frames, and astra, donuts and astrafocus are what is measured."""

import contextlib
import csv
import datetime
import os
import pathlib
import random
import sqlite3
import statistics
import subprocess
import sys
import tempfile
import time
import warnings

from systems import PROJECT, VENV, install

BINARY = pathlib.Path(os.environ.get("STARMESH_BENCH_FRAMES", PROJECT / "target/release/examples/bench_frames"))
RUNS, SLOW_RUNS = int(os.environ.get("RUNS", "25")), int(os.environ.get("SLOW_RUNS", "3"))
RA_DEG, DEC_DEG = 90.0, 50.4
FOCAL_M, PITCH_UM = 8.0, 10.0
SCALE_ARCSEC_PX = PITCH_UM * 1e-6 / FOCAL_M * 206_264.806
SHIFT_PX = (3.37, -2.21)
STARS = 4000
BRIGHTEST_MAG, FAINTEST_MAG = 13.0, 17.5  # none saturates the drawn camera
ROWS = {
    "clean_detect": ("clean + detect, all stars measured", 60),
    "solve_shift": ("solve after detection, learnt camera (level 0)", 10),
    "solve_field": ("solve after detection, place and scale (level 1)", 10),
    "file_shift": ("file to WCS, level 0", 75),
    "file_field": ("file to WCS, level 1", 75),
    "guide": ("guide measurement", 30),
    "hfd": ("HFD of the brightest stars, found and measured", 80),
    "hfd_at": ("of it measuring", 10),
}


def write_catalogue(folder: pathlib.Path):
    """The same stars for all: as SQLite in tables of a degree of declination, and as CSV."""
    chance = random.Random(7)
    names = ["ra", "dec", "pmra", "pmdec", "phot_g_mean_mag", "phot_bp_mean_mag", "phot_rp_mean_mag", "j_m", "h_m", "ks_m"]
    rows = [(RA_DEG + chance.uniform(-0.3, 0.3), DEC_DEG + chance.uniform(-0.2, 0.2), 0.0, 0.0,
             *[chance.uniform(BRIGHTEST_MAG, FAINTEST_MAG)] * 6) for _ in range(STARS)]
    with contextlib.closing(sqlite3.connect(folder / "stars.db")) as database, database:
        for low in range(-90, 90):
            database.execute(f"CREATE TABLE `{low}_{low + 1}` ({', '.join(f'{name} REAL' for name in names)})")
        for row in rows:
            database.execute(f"INSERT INTO `{int(row[1])}_{int(row[1]) + 1}` VALUES ({', '.join('?' * len(row))})", row)
    with open(folder / "stars.csv", "w", newline="") as out:
        csv.writer(out).writerows([names, *rows])


def draw(folder: pathlib.Path, name: str, side_px: int, seed: int, shift_px=(0.0, 0.0)):
    """A frame as cabaret sees it, with the header that the predecessor's solver reads."""
    import cabaret
    import numpy
    from astropy.coordinates import SkyCoord
    from astropy.io import fits

    camera = cabaret.Camera(width=side_px, height=side_px, pitch=PITCH_UM, gain=1.0, read_noise=6.2)
    camera.set_plate_scale_from_focal_length(FOCAL_M)
    observatory = cabaret.Observatory(camera=camera, telescope=cabaret.Telescope(focal_length=FOCAL_M, diameter=1.0),
                                      site=cabaret.Site(sky_background=150, seeing=1.0))
    wcs = camera.get_wcs(SkyCoord(RA_DEG, DEC_DEG, unit="deg"))
    wcs.wcs.crpix = numpy.array(wcs.wcs.crpix) + shift_px
    at = datetime.datetime(2026, 11, 21, 3, tzinfo=datetime.UTC)
    image = observatory.generate_image(ra=RA_DEG, dec=DEC_DEG, exp_time=2.0, dateobs=at, seed=seed,
                                       tap_source=str(folder / "stars.db"), wcs=wcs)
    header = fits.Header()
    header.update({"DATE-OBS": "2026-11-21T03:00:00.000", "EXPTIME": 2.0, "FOCALLEN": (FOCAL_M, "[m]"), "XPIXSZ": PITCH_UM,
                   "RA": RA_DEG, "DEC": DEC_DEG, "FILTER": "Clear", "IMAGETYP": "Light Frame"})
    fits.PrimaryHDU(numpy.asarray(image, numpy.uint16), header).writeto(folder / name)


def ours(folder: pathlib.Path) -> tuple[dict[str, list[str]], str]:
    """Name of the work to best, median and processor time in ms and what came out; and the memory for 4096 x 4096."""
    place = [str(folder / "stars.csv"), str(RA_DEG), str(DEC_DEG), str(SCALE_ARCSEC_PX), str(RUNS)]
    called = lambda *files: subprocess.run([str(BINARY), *place, *[str(folder / file) for file in files]], check=True,
                                           capture_output=True, text=True).stdout
    lines = [line.split("\t") for line in called("first.fits", "moved.fits").splitlines()]
    _, memory_mb, _ = called("large.fits").strip().split("\t")
    return {name: figures for name, *figures in lines}, memory_mb


def timed(work, runs: int = SLOW_RUNS):
    """Best, median and processor time of some runs after a first, ms, and what the last one answered."""
    answer = work()
    wall_ms, processor_ms = [], []
    for _ in range(runs):
        began, began_processor = time.perf_counter(), time.process_time()
        answer = work()
        wall_ms.append((time.perf_counter() - began) * 1e3)
        processor_ms.append((time.process_time() - began_processor) * 1e3)
    return min(wall_ms), statistics.median(wall_ms), statistics.median(processor_ms), answer


def theirs(folder: pathlib.Path) -> dict[str, tuple]:
    """The same works by astra and the libraries it calls."""
    import logging

    import astra.config
    astra.config.Config(allow_default=True)
    import twirl
    from astra import pointer
    from astra.utils import optics
    from astra.utils.image import CustomImageClass, clean_image
    from astrafocus import FocusMeasureOperatorRegistry
    from astropy.io import fits
    from donuts import Donuts
    logging.disable(logging.CRITICAL)
    file, moved = folder / "first.fits", folder / "moved.fits"
    image = fits.getdata(file)
    scale = optics.plate_scale(PITCH_UM * 1e-6, FOCAL_M)
    fwhm = optics.fwhm_pixels(scale, 2.0)
    figures = {"clean_detect": timed(lambda: f"{len(pointer.find_stars(clean_image(image), threshold=7, fwhm=fwhm))} stars")}

    solve = lambda: pointer.calculate_pointing_correction_from_fits(str(file), use_local_db=True)
    *times, (correction, solution, _) = timed(solve)
    agree = solution.number_of_matched_stars(10)
    figures["file_field"] = (*times, f"{agree} stars agree, {correction.angular_separation * 3600:.3f} arcsec from where it was drawn")
    field = optics.fov_from_plate_scale(image.shape, scale) * 1.25
    at = datetime.datetime(2026, 11, 21, 3, tzinfo=datetime.UTC)
    known = pointer.local_gaia_db_query(center=(RA_DEG, DEC_DEG), fov=field, limit=40, dateobs=at)
    *times, _ = timed(lambda: twirl.compute_wcs(solution.stars_in_image, known))
    figures["solve_field"] = (*times, f"twirl, {len(solution.stars_in_image)} of the image, {len(known)} of the catalogue")

    guider = Donuts(str(file), normalise=False, subtract_bkg=False, downweight_edges=False, image_class=CustomImageClass)
    *times, shift = timed(lambda: guider.measure_shift(str(moved)))
    figures["guide"] = (*times, f"{-shift.x.value:.4f} {-shift.y.value:.4f} px")

    size = FocusMeasureOperatorRegistry.from_name("hfr")
    *found, focus = timed(lambda: size(ref_image=image))
    *measured, _ = timed(lambda: focus(image))
    stars = f"{len(focus.star_finder.selected_stars)} stars"
    figures["hfd"] = (*[a + b for a, b in zip(found, measured)], stars)
    figures["hfd_at"] = (*measured, stars)
    return figures


def table(ours_ms: dict, theirs_ms: dict, memory_mb: str):
    """Best / median / processor time of either, and how many times less processor time."""
    load = " ".join(f"{load:.1f}" for load in os.getloadavg())
    print(f"ms: best / median wall time / processor time; load average {load} at the end, {os.cpu_count()} cores")
    print("| work on 2048 x 2048 | asked | Starmesh | predecessor | ratio of processor time |\n|---|--:|--:|--:|--:|")
    for name, (work, asked_ms) in ROWS.items():
        *our, what = ours_ms[name]
        cell = " / ".join(f"{float(value):.1f}" for value in our)
        if their := theirs_ms.get(name):
            other, ratio = " / ".join(f"{value:.0f}" for value in their[:3]), f"{their[2] / max(float(our[2]), 0.1):.0f}"
        else:
            other, ratio = "no such mode", "-"
        print(f"| {work} | {asked_ms} | {cell} | {other} | {ratio} |")
        print(f"  {name}: {what}; predecessor: {their[3] if their else '-'}", file=sys.stderr)
    print(f"| memory of one file of 4096 x 4096 to its WCS, MB | 400 | {memory_mb} | - | - |")
    guide = [float(word) for word in ours_ms["guide"][3].split()[:2]]
    guide_theirs = [float(word) for word in theirs_ms["guide"][3].split()[:2]]
    error = lambda seen: max(abs(a - b) for a, b in zip(seen, SHIFT_PX))
    print(f"| error of the guide measurement, px | 0.02 | {error(guide):.4f} | {error(guide_theirs):.4f} | - |")


def main():
    if not BINARY.exists():
        raise SystemExit(f"bench: {BINARY} is missing: cargo build --release -p catalogue --example bench_frames")
    install()
    if pathlib.Path(sys.prefix).resolve() != VENV:
        python = str(VENV / "bin/python")
        # by its whole path: Python takes the environment from how it was called
        os.execv(python, [python, "-B", *sys.argv])
    warnings.simplefilter("ignore")
    with tempfile.TemporaryDirectory(prefix="starmesh-image-side-") as name:
        folder = pathlib.Path(name)
        # astra reads its catalogue's place from the home folder
        (folder / ".astra").mkdir()
        (folder / "assets").mkdir()
        (folder / ".astra/astra_config.yml").write_text(
            f"folder_assets: {folder / 'assets'}\ngaia_db: {folder / 'stars.db'}\nobservatory_name: sim\n")
        os.environ["HOME"] = name
        write_catalogue(folder)
        draw(folder, "first.fits", 2048, 2)
        draw(folder, "moved.fits", 2048, 3, SHIFT_PX)
        draw(folder, "large.fits", 4096, 4)
        our, memory_mb = ours(folder)
        table(our, theirs(folder), memory_mb)


if __name__ == "__main__":
    main()
