"""Makes stars.csv.gz and centres.csv: what tests/solves_images.rs needs of the project's shared/golden.

    python3 cut_catalogue.py ../shared/golden

Standard library only. stars.csv.gz: the brightest stars of catalogue_shared.db around each piece of a frame
that common/imaging/tests/golden holds, as they stand there (epoch 2016.0, mas/yr). centres.csv: where the geometric
centre of each piece is by the WCS it was drawn with (TAN), and what the header of the whole frame told its solver.
"""

import gzip
import json
import math
import os
import sqlite3
import sys

HERE = os.path.dirname(os.path.abspath(__file__))
FRAMES = os.path.join(HERE, "../../../common/imaging/tests/golden")
MOST = 120


def header(path):
    """The numbers of a header of one block or two."""
    block, numbers = gzip.open(path).read(5760), {}
    for card in (block[i : i + 80].decode("latin1") for i in range(0, len(block), 80)):
        if card.startswith("END "):
            return numbers
        try:
            numbers[card[:8].strip()] = float(card[10:].split("/")[0])
        except ValueError:
            pass


def centre(wcs, x, y):
    """The direction of a pixel, counted from 1."""
    u, v = x - wcs["crpix_fits_1based"][0], y - wcs["crpix_fits_1based"][1]
    (a, b), (c, d) = wcs["cd_deg"]
    xi, eta = math.radians(a * u + b * v), math.radians(c * u + d * v)
    ra0, dec0 = map(math.radians, wcs["crval"])
    down = math.cos(dec0) - eta * math.sin(dec0)
    ra = ra0 + math.atan2(xi, down)
    dec = math.atan2(math.sin(dec0) + eta * math.cos(dec0), math.hypot(xi, down))
    return math.degrees(ra) % 360.0, math.degrees(dec)


def main(folder):
    catalogue = sqlite3.connect(f"file:{folder}/catalogue_shared.db?mode=ro", uri=True)
    stars, centres = set(), []
    for name in sorted(f.removesuffix(".fits.gz") for f in os.listdir(FRAMES) if f.startswith("f") and f.endswith("gz")):
        frame = json.load(open(f"{folder}/frames/{name}.truth.json"))
        piece, whole = header(f"{FRAMES}/{name}.fits.gz"), header(f"{folder}/frames/{name}.fits.gz")
        width, height = piece["NAXIS1"], piece["NAXIS2"]
        ra, dec = centre(frame["wcs"], (width + 1) / 2 - piece.get("LTV1", 0), (height + 1) / 2 - piece.get("LTV2", 0))
        scale = frame["header_scale_arcsec"]
        told = ",".join(f"{whole[key]}" for key in ("RA", "DEC", "FOCALLEN", "XPIXSZ"))
        centres.append(f"{name},{ra:.7f},{dec:.7f},{scale:.6f},{told}")
        reach, near = 1.5 * max(width, height) * scale / 3600.0, []
        for low in range(math.floor(dec - reach), math.floor(dec + reach) + 1):
            rows = catalogue.execute(
                f'select ra, dec, pmra, pmdec, phot_g_mean_mag from "{low}_{low + 1}" where dec between ? and ?',
                (dec - reach, dec + reach),
            )
            east = lambda a: ((a - ra + 180.0) % 360.0 - 180.0) * math.cos(math.radians(dec))
            near += [row for row in rows if abs(east(row[0])) < reach]
        stars.update(sorted(near, key=lambda row: row[4])[:MOST])
    lines = ["ra,dec,pmra,pmdec,phot_g_mean_mag"]
    lines += [f"{a:.7f},{d:.7f},{pm_a:.3f},{pm_d:.3f},{mag:.3f}" for a, d, pm_a, pm_d, mag in sorted(stars)]
    # no time of day in the file: the same input gives the same bytes
    with open(os.path.join(HERE, "stars.csv.gz"), "wb") as raw, gzip.GzipFile("", "wb", 9, raw, mtime=0) as out:
        out.write(("\n".join(lines) + "\n").encode())
    with open(os.path.join(HERE, "centres.csv"), "w") as out:
        out.write("frame,ra_deg,dec_deg,scale_arcsec_px,header_ra,header_dec,focallen_m,xpixsz_um\n" + "\n".join(centres) + "\n")


main(sys.argv[1])
