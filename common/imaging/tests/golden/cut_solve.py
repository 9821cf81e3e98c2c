"""Makes solve.csv.gz: what tests/solve_golden.rs needs of the project's shared/golden.

    python3 cut_solve.py ../shared/golden

Standard library only. Lines: `frame,NAME,width,height,target_ra,target_dec,scale_arcsec,fwhm_px,crval1,crval2,crpix1,
crpix2,cd11,cd12,cd21,cd22` (CRPIX counts from 1), then the frame's drawn stars `star,x,y,flux_e` (px from 0), then
the catalogue around it `known,ra,dec,mag` (deg, moved to DATE-OBS 2026-11-21 as the frames were drawn: without
1/cos(dec)), the brightest first.
"""

import glob
import gzip
import json
import math
import os
import sqlite3
import sys

YEARS = 2026 + 324 / 365.25 - 2016.0


def known(catalogue, ra, dec, radius, most):
    found = []
    for low in range(math.floor(dec - radius), math.floor(dec + radius) + 1):
        rows = catalogue.execute(
            f'select ra, dec, pmra, pmdec, phot_g_mean_mag from "{low}_{low + 1}" where dec between ? and ?',
            (dec - radius, dec + radius),
        )
        for a, d, pm_a, pm_d, mag in rows:
            a, d = (a + YEARS * pm_a / 3.6e6) % 360.0, d + YEARS * pm_d / 3.6e6
            east = ((a - ra + 180.0) % 360.0 - 180.0) * math.cos(math.radians(dec))
            if math.hypot(east, d - dec) < radius:
                found.append((mag, a, d))
    return sorted(found)[:most]


def main(folder):
    catalogue = sqlite3.connect(f"file:{folder}/catalogue_shared.db?mode=ro", uri=True)
    lines = []
    for path in sorted(glob.glob(f"{folder}/frames/*.truth.json")):
        frame = json.load(open(path))
        height, width = frame["shape_hw"]
        scale, wcs = frame["header_scale_arcsec"], frame["wcs"]
        numbers = [width, height, *frame["target_deg"], scale, frame["psf"]["fwhm_px"], *wcs["crval"]]
        numbers += wcs["crpix_fits_1based"] + wcs["cd_deg"][0] + wcs["cd_deg"][1]
        lines.append(",".join(["frame", frame["name"], *map(repr, numbers)]))
        shown = sorted(frame["stars"], key=lambda s: -s["flux_e"])
        lines += [f"star,{s['x']:.3f},{s['y']:.3f},{s['flux_e']:.0f}" for s in shown]
        reach = 1.9 * max(width, height) * scale / 3600.0
        stars = known(catalogue, *frame["target_deg"], reach, 1500 if len(shown) > 100 else 500)
        lines += [f"known,{a:.7f},{d:.7f},{mag:.2f}" for mag, a, d in stars]
    # no time of day in the file: the same input gives the same bytes
    target = os.path.join(os.path.dirname(os.path.abspath(__file__)), "solve.csv.gz")
    with open(target, "wb") as raw, gzip.GzipFile("", "wb", 9, raw, mtime=0) as out:
        out.write(("\n".join(lines) + "\n").encode())


main(sys.argv[1])
