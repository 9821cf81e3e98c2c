"""The light curve that prose (PyPI) makes of a folder of our files as they are: `prose_curve.py FOLDER RA_DEG DEC_DEG`, by the Python that has prose.

Prints JSON: `points` (middle of the exposure in seconds since 1970, and flux), and what prose chose.
"""

import json
import sys
import warnings

import numpy as np
from astropy.time import Time
from prose import FITSImage, FitsManager, Sequence, blocks

warnings.simplefilter("ignore")


def main() -> None:
    folder, ra_deg, dec_deg = sys.argv[1], float(sys.argv[2]), float(sys.argv[3])
    # what a file is, and which frames calibrate it, prose finds in our headers
    manager = FitsManager(folder, depth=3, verbose=False)
    lights = manager.observations(type="light", hide_exposure=False).sort_values("files")
    files = {kind: list(map(str, paths)) for kind, paths in manager.observation_files(int(lights.index[-1]), show=False).items()}
    calibration = blocks.Calibration(darks=files["darks"], flats=files["flats"], bias=files["bias"], verbose=False)
    detection = [calibration, blocks.PointSourceDetection(n=40), blocks.Cutouts(21), blocks.MedianEPSF()]
    reference = FITSImage(files["images"][0])
    Sequence([*detection, blocks.psf.Moffat2D()]).run(reference, show_progress=False)
    middle = lambda image: Time(image.header["DATE-OBS"], scale="utc").unix + image.header["EXPTIME"] / 2
    fluxes = blocks.GetFluxes("fwhm", middle=middle)
    photometry = Sequence([*detection, blocks.psf.Moffat2D(reference), blocks.ComputeTransformTwirl(reference),
                           blocks.AlignReferenceSources(reference), blocks.CentroidQuadratic(), blocks.AperturePhotometry(),
                           blocks.AnnulusBackground(), fluxes])
    photometry.run(files["images"], show_progress=False)
    measured = fluxes.fluxes
    # the target is where the solution in the header of the first frame puts it
    target = np.array(reference.wcs.world_to_pixel_values(ra_deg, dec_deg))
    off = np.linalg.norm(reference.sources.coords - target, axis=1)
    assert off.min() < 3, f"prose found no star within 3 px of the target at {target}"
    # prose compares no star that left the frame once
    whole = np.isfinite(measured.fluxes).all(axis=(0, 2))
    measured = measured.mask_stars(whole, keep_indexing=False)
    measured.target = int(np.argmin(off[whole]))
    curve = measured.autodiff()
    points = sorted(zip(map(float, curve.data["middle"]), map(float, curve.flux)))
    radii = np.median(curve.apertures, axis=0) if curve.apertures.ndim == 2 else curve.apertures
    print(json.dumps({"points": points, "radius_px": float(radii[curve.aperture]), "fwhm_px": float(np.median(curve.data["fwhm"])),
                      "comparison_stars": len(curve.comparisons), "files": {kind: len(paths) for kind, paths in files.items()}}))


if __name__ == "__main__":
    main()
