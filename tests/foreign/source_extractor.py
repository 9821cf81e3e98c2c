"""What source-extractor finds in a frame of the demo's night, and how far what a program has found is from the stars of the catalogue."""

import pathlib
import warnings

import numpy as np
import pytest
from astropy.coordinates import SkyCoord
from astropy.io import fits
from demo_night import Series, debian, run

SEX = pathlib.Path("/usr/share/source-extractor")
HOT_BELOW = 0.3  # half of the light of a hot pixel lies within less than this part of the FWHM of a star
JUMPED_PX = 0.2  # where the mount was moved during the exposure stars have tails, and each program has a middle of its own


def extract(path: pathlib.Path, folder: pathlib.Path, catalogue: str, columns: tuple[str, ...], *options) -> pathlib.Path:
    """The catalogue of what source-extractor finds with its own default configuration."""
    (folder / "columns").write_text("\n".join(columns))
    run("source-extractor", path, "-c", SEX / "default.sex", "-FILTER_NAME", SEX / "default.conv", "-STARNNW_NAME", SEX / "default.nnw",
        "-PARAMETERS_NAME", folder / "columns", "-CATALOG_TYPE", "FITS_LDAC", "-CATALOG_NAME", folder / catalogue, "-VERBOSE_TYPE", "QUIET",
        "-PIXEL_SCALE", 0, *options)  # 0: by the header's solution
    return folder / catalogue


def table_of(xml: pathlib.Path, name: str) -> np.ndarray:
    """A table of the notes that source-extractor, SCAMP and PSFEx write."""
    from astropy.io.votable import parse

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it is older than the standard
        return next(table for table in parse(xml).iter_tables() if table.name == name).array.data


def source_extractor(path: pathlib.Path, folder: pathlib.Path) -> tuple[np.ndarray, dict]:
    """What source-extractor finds, and what it notes of the frame."""
    columns = ("X_IMAGE", "Y_IMAGE", "XMIN_IMAGE", "XMAX_IMAGE", "YMIN_IMAGE", "YMAX_IMAGE", "ALPHA_J2000", "DELTA_J2000", "FLUX_APER(1)", "FLUXERR_APER(1)", "FLUX_RADIUS",
               "FLAGS")
    found = extract(path, folder, "found.cat", columns, "-WRITE_XML", "Y", "-XML_NAME", folder / "found.xml")
    noted = table_of(folder / "found.xml", "Extension_Data")[0]
    return fits.getdata(found, 2, memmap=False), {name: np.ravel(noted[name])[0] for name in noted.dtype.names}


def from_catalogue(series: Series, found: np.ndarray | dict) -> np.ndarray:
    """Distance, pixels, of each star of the catalogue from the source that is nearest by the coordinates that a program gave it."""
    sources = SkyCoord(found["ALPHA_J2000"], found["DELTA_J2000"], unit="deg")
    return series.places.match_to_catalog_sky(sources)[1].arcsec / series.first["PIXSCALE"]


@pytest.fixture(scope="module")
def catalogues(series, tmp_path_factory) -> list[pathlib.Path]:
    """What SCAMP and PSFEx ask source-extractor for, of each third frame: with a cut-out of each star."""
    debian("source-extractor", "source-extractor")
    columns = ("X_IMAGE", "Y_IMAGE", "XWIN_IMAGE", "YWIN_IMAGE", "ERRAWIN_IMAGE", "ERRBWIN_IMAGE", "ERRTHETAWIN_IMAGE", "FLUX_AUTO", "FLUXERR_AUTO",
               "FLUX_APER(1)", "FLUXERR_APER(1)", "FLUX_RADIUS", "SNR_WIN", "ELONGATION", "FLAGS", "VIGNET(25,25)")
    folder = tmp_path_factory.mktemp("catalogues")
    return [extract(path, folder, f"{path.stem}.cat", columns, "-PHOT_APERTURES", 4 * series.first["FWHM"]) for path in series.paths[::3]]
