"""The light curve that prose (PyPI) makes of a folder of our files as they are: `prose_curve.py FOLDER RA_DEG DEC_DEG [OBJECT]`, by the Python that
has prose (`target/venv-prose`); without OBJECT, of the one with the most frames.

Prints JSON: the points of the star (middle of the exposure in seconds since 1970, and flux), and what prose found and chose.
"""

import json
import pathlib
import sys
import warnings
from importlib.metadata import version

import numpy as np
from astropy.time import Time

# On its first start prose fetches from GitHub the weights of a network for centroids, which is not used here: an empty file stands for it.
weights = pathlib.Path.home() / ".prose/centroid.h5"
weights.parent.mkdir(parents=True, exist_ok=True)
weights.touch()

from prose import FITSImage, FitsManager, Sequence, blocks  # noqa: E402

warnings.simplefilter("ignore")
# up to this share of SATURATE a pixel counts all of its light
LINEAR = 0.9


def main() -> None:
    folder, ra_deg, dec_deg = sys.argv[1], float(sys.argv[2]), float(sys.argv[3])
    # what a file is, and which frames calibrate it, prose finds in our headers
    manager = FitsManager(folder, depth=3, verbose=False)
    lights = manager.observations(type="light", target=(sys.argv + [None])[4], hide_exposure=False).sort_values("files")
    files = {kind: list(map(str, paths)) for kind, paths in manager.observation_files(int(lights.index[-1]), show=False).items()}
    calibration = blocks.Calibration(darks=files["darks"], flats=files["flats"], bias=files["bias"], verbose=False)

    def detection(most=None) -> list:
        return [calibration, blocks.PointSourceDetection(n=most), blocks.Cutouts(21), blocks.MedianEPSF()]
    reference = FITSImage(files["images"][0])
    raw = reference.data.copy()
    Sequence([*detection(), blocks.psf.Moffat2D()]).run(reference, show_progress=False)
    fluxes = blocks.GetFluxes("fwhm", bjd=lambda image: image.header["BJD_TDB"],
                              middle=lambda image: Time(image.header["DATE-OBS"], scale="utc").unix + image.header["EXPTIME"] / 2)
    photometry = Sequence([*detection(40), blocks.psf.Moffat2D(reference), blocks.ComputeTransformTwirl(reference),
                           blocks.AlignReferenceSources(reference), blocks.CentroidQuadratic(), blocks.AperturePhotometry(),
                           blocks.AnnulusBackground(), fluxes])
    photometry.run(files["images"], show_progress=False)
    measured = fluxes.fluxes
    # the target is where the solution in the header of the first frame puts it
    target = np.array(reference.wcs.world_to_pixel_values(ra_deg, dec_deg))
    off = np.linalg.norm(reference.sources.coords - target, axis=1)
    assert off.min() < 3, f"prose found no star within 3 px of the target at {target}"
    # no comparison is a star that left the frame once, or a saturated one: it does not get fainter under a cloud
    around = [raw[max(y - 3, 0):y + 4, max(x - 3, 0):x + 4].max() for x, y in reference.sources.coords.round().astype(int)]
    good = np.isfinite(measured.fluxes).all(axis=(0, 2)) & (np.array(around) < LINEAR * reference.header["SATURATE"])
    good[off.argmin()] = True
    measured = measured.mask_stars(good, keep_indexing=False)
    measured.target = int(np.argmin(off[good]))
    curve = measured.autodiff()
    points = sorted(zip(map(float, curve.data["middle"]), map(float, curve.flux)))
    radii = np.median(curve.apertures, axis=0) if curve.apertures.ndim == 2 else curve.apertures
    print(json.dumps({"version": version("prose"), "telescope": reference.telescope.name, "points": points, "jd": list(curve.time),
                      "bjd": list(map(float, curve.data["bjd"])), "radius_px": float(radii[curve.aperture]),
                      "fwhm_px": float(np.median(curve.data["fwhm"])), "comparison_stars": len(curve.comparisons), "sources": len(off),
                      "off_px": float(off.min()), "files": {kind: [pathlib.Path(path).name for path in paths] for kind, paths in files.items()}}))


if __name__ == "__main__":
    main()
