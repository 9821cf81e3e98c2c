"""The files and the database of the demo's night, as they are, by the programs that people use; and what each said, in docs/operator/files.md.

`UPDATE_DOCS=1` writes the table there again.
"""

import json
import os
import pathlib
import re
import shutil
import sqlite3
import warnings
from collections import Counter
from importlib.metadata import version

import numpy as np
import pytest
import siril
from astropy import units as u
from astropy.coordinates import SkyCoord
from astropy.io import fits
from astropy.nddata import CCDData
from astropy.table import Table
from astropy.time import Time
from astropy.wcs import WCS
from demo_night import debian, lco, night, places, run, series  # noqa: F401 (fixtures)
from shared import PROJECT
from source_extractor import HOT_BELOW, JUMPED_PX, catalogues, from_catalogue, source_extractor, table_of  # noqa: F401 (a fixture)

DOCUMENT = PROJECT / "docs/operator/files.md"
BEGIN, END = "<!-- tools: begin -->\n", "<!-- tools: end -->"
NAME = re.compile(r"\d{8}T\d{6}-\d{3}_[A-Za-z0-9+-]+_(light|acquisition|bias|dark|flat|test)(_[A-Za-z0-9+-]+){1,3}\.fits")
SAID: dict[str, tuple[str, str]] = {}


def test_names_are_plain_and_in_the_order_of_exposure(night):
    assert len(night.files) > 30 and all(NAME.fullmatch(path.name) for path in night.files), [path.name for path in night.files]
    begun = [night.headers[path]["DATE-OBS"] for path in night.files]
    assert begun == sorted(begun)
    assert all(path.name[:19] == Time(at).strftime("%Y%m%dT%H%M%S") + f"-{at[20:23]}" for path, at in zip(night.files, begun))


def test_kinds_of_frames_are_apart(night):
    assert all(night.of(kind) for kind in ("Light", "Acquisition", "Bias", "Dark", "Flat"))
    with sqlite3.connect(f"file:{night.folder}/data/archive.db?mode=ro", uri=True) as database:
        counted = dict(database.execute("SELECT image_type, count(*) FROM frames GROUP BY 1"))
    assert counted["Acquisition Frame"] == len(night.of("Acquisition"))
    for path in night.of("Light"):
        assert night.headers[path].get("OFFTARG", 0) < 1.0, f"{path} is off its target"
    spooled = list((night.folder / "data").glob("spool-*/*.pixels"))
    assert spooled == [], "frames that the archive has are in no spool"


def test_starmesh_asks_for_nothing_more(night, starmesh):
    checked = run(starmesh, "fits", "check", *night.files, "--profile", "plain")
    SAID["`starmesh fits check --profile plain`"] = (run(starmesh, "--version").split()[-1], f"{len(night.files)} files, nothing missing")
    assert "missing" not in checked, checked


def test_fitsverify(night):
    assert shutil.which("fitsverify"), "fitsverify is missing: apt-get install fitsverify (scripts/setup does)"
    said = run("fitsverify", *night.files)
    clean = said.count("Verification found 0 warning(s) and 0 error(s)")
    SAID["`fitsverify`"] = (re.search(r"fitsverify (\S+)", said).group(1), f"{clean} of {len(night.files)} files without a warning")
    assert clean == len(night.files), said


def test_astropy_reads_units_times_and_coordinates(night):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for path, header in night.headers.items():
            for card in header.cards:
                if unit := re.match(r"\[([^]]+)\]", card.comment):
                    u.Unit(unit.group(1), format="fits")
            assert u.Unit(header["BUNIT"], format="fits") == u.adu
            assert abs(Time(header["DATE-AVG"]).mjd - header["MJD-AVG"]) < 1e-8
            if header["IMAGETYP"] in ("Bias Frame", "Dark Frame"):
                assert not {"AIRMASS", "AIRMMID", "BJD-OBS", "BJD_TDB", "HJD-OBS"} & set(header), path
        solved = [header for header in night.headers.values() if header.get("SOLVED")]
        for header in solved:
            wcs = WCS(header)
            assert list(wcs.wcs.ctype) == ["RA---TAN-SIP", "DEC--TAN-SIP"] and header["MIRRORED"] == bool(np.linalg.det(wcs.wcs.cd) > 0)
    SAID["`astropy`"] = (version("astropy"), f"units, dates and {len(solved)} plate solutions without a warning")
    assert len(solved) > 10


def test_ccdproc_makes_the_uncertainty_of_a_frame(night):
    import ccdproc

    path = night.of("Light")[0]
    header, frame = night.headers[path], CCDData.read(path)
    assert frame.unit == u.adu
    with_error = ccdproc.create_deviation(frame, gain=header["GAIN"] * u.electron / u.adu, readnoise=header["RDNOISE"] * u.electron)
    assert np.median(with_error.uncertainty.array) > header["RDNOISE"] / header["GAIN"]
    assert 0 < header["SATURATE"] <= 65535
    collection = ccdproc.ImageFileCollection(filenames=[str(path) for path in night.files])
    lights = len(collection.files_filtered(imagetyp="Light Frame"))
    SAID["`ccdproc`"] = (version("ccdproc"), f"uncertainties by GAIN and RDNOISE; {lights} light frames")
    assert lights == len(night.of("Light"))


def test_ocs_archive_takes_the_names_and_a_whole_night_by_the_profile_lco(night, lco):
    os.environ.setdefault("FILESTORE_TYPE", "local")
    from ocs_archive.input.file import File
    from ocs_archive.input.filefactory import FileFactory

    for path in [*night.files, *lco]:
        with open(path, "rb") as opened:
            file = File(opened, path.name)
            assert (file.basename, file.extension) == (path.stem, ".fits"), path
            FileFactory.get_datafile_class_for_extension(file.extension)(file, required_headers=[])
    SAID["`ocs-archive`"] = (version("ocs-archive"), f"{len(lco)} copies of {len(night.files)} frames by profile `lco`")
    assert len(lco) == len(night.files)


def test_ocs_ingester_makes_a_record_of_every_copy_by_the_profile_lco(night, lco):
    """All that it does before it asks the archive's server."""
    os.environ.setdefault("FILESTORE_TYPE", "local")
    from ocs_ingester import ingester

    called = {"Light": "EXPOSE", "Acquisition": "GUIDE", "Bias": "BIAS", "Dark": "DARK", "Flat": "SKYFLAT", "Test": "EXPERIMENTAL"}
    types, outlines = Counter(), 0
    for copy in lco:
        header = fits.getheader(copy)
        with open(copy, "rb") as opened:
            record = ingester.validate_fits_and_create_archive_record(opened)
        assert record["basename"] == copy.stem and record["observation_date"] == header["DATE-OBS"]
        assert (record["site_id"], record["telescope_id"], record["instrument_id"]) == ("dem", "0m3a", header["INSTRUME"])
        assert record["proposal_id"] == header["PROGID"] and record["observation_day"] == header["NIGHT"]
        assert record["target_name"] == header.get("OBJECT", "")
        types[record["configuration_type"]] += 1
        if header.get("SOLVED"):
            corners = SkyCoord(record["area"]["coordinates"][0], unit="deg")
            wanted = SkyCoord(WCS(header).calc_footprint(), unit="deg")
            assert all(corners.separation(corner).arcsec.min() < header["PIXSCALE"] for corner in wanted), copy
            outlines += 1
    SAID["`ocs-ingester`"] = (version("ocs-ingester"), f"records of {len(lco)} copies by profile `lco`, {outlines} outlines on the sky")
    assert types == {name: len(night.of(kind)) for kind, name in called.items()}
    assert outlines > 10


def test_a_whole_night_by_the_profile_eso_is_whole_and_valid(night, starmesh, tmp_path):
    """ESO's validator is not public: its rules are those of `fits check`."""
    run(starmesh, "fits", "convert", *night.files, "--profile", "eso", "--out", tmp_path / "eso", "--set", "INSTRUME=STARMESH1", "--set", "PROGID=118.28AB.001")
    copies = sorted((tmp_path / "eso").iterdir())
    assert len(copies) == len(night.files)
    assert "missing" not in run(starmesh, "fits", "check", *copies, "--profile", "eso")
    assert run("fitsverify", *copies).count("Verification found 0 warning(s) and 0 error(s)") == len(copies)
    kinds = Counter((fits.getval(path, "ESO DPR CATG"), fits.getval(path, "ESO DPR TYPE")) for path in copies)
    assert {catg for catg, _ in kinds} <= {"SCIENCE", "ACQUISITION", "CALIB", "TEST"} and kinds["SCIENCE", "OBJECT"] == len(night.of("Light")), kinds
    SAID["`starmesh fits check --profile eso`"] = (
        run(starmesh, "--version").split()[-1], f"{len(copies)} copies of {len(night.files)} frames, nothing missing; `fitsverify`: no warning")


def test_solve_field_says_the_parity_of_the_header(night, tmp_path):
    solver = shutil.which("solve-field")
    assert solver, "solve-field is missing: apt-get install astrometry.net (scripts/setup does)"
    path = night.solved()
    header = night.headers[path]
    said = run(solver, "--no-plots", "--overwrite", "--dir", tmp_path, "--scale-units", "arcsecperpix", "--scale-low", header["PIXSCALE"] * 0.95,
               "--scale-high", header["PIXSCALE"] * 1.05, "--ra", header["RA"], "--dec", header["DEC"], "--radius", 2, "--cpulimit", 60, path)
    solved = next(tmp_path.glob("*.new"), None)
    SAID["`solve-field`"] = (run("dpkg-query", "-W", "-f", "${Version}", "astrometry.net"), "the same place and parity as the header")
    assert solved, said
    cd = WCS(fits.getheader(solved)).wcs.cd
    assert header["MIRRORED"] == bool(np.linalg.det(cd) > 0)


def test_source_extractor_takes_gain_saturation_and_coordinates(series, tmp_path):
    number, counted, medians = debian("source-extractor", "source-extractor"), [], []
    for path, header in zip(series.paths, series.headers):
        found, noted = source_extractor(path, tmp_path)
        assert (noted["Gain"], noted["Satur_Level"]) == (pytest.approx(header["GAIN"]), header["SATURATE"])
        assert noted["Pixel_Scale"] == pytest.approx(header["PIXSCALE"], rel=1e-4)
        stars = found[found["FLUX_RADIUS"] > HOT_BELOW * header["FWHM"]]
        assert len(stars) == pytest.approx(header["NSTARS"], rel=0.1, abs=3), path
        counted.append(len(stars))
        # version 2.25 leaves out the terms of SIP, so the linear part is compared
        ra, dec = WCS(header).wcs_pix2world(stars["X_IMAGE"], stars["Y_IMAGE"], 1)
        theirs = SkyCoord(stars["ALPHA_J2000"], stars["DELTA_J2000"], unit="deg")
        assert theirs.separation(SkyCoord(ra, dec, unit="deg")).arcsec.max() < 0.001
        medians.append(np.median(from_catalogue(series, stars)))
        # its errors are those of the header's gain: photons of the star, and what the pixels of the sky scatter
        clean = stars[(stars["FLAGS"] == 0) & (stars["FLUX_APER"] > 0)]
        error = np.sqrt(clean["FLUX_APER"] / header["GAIN"] + np.pi * 2.5**2 * noted["Background_StDev"] ** 2)
        assert np.median(clean["FLUXERR_APER"] / error) == pytest.approx(1.0, abs=0.02)
    SAID["`source-extractor`"] = (number, f"gain, saturation and scale of the header; {min(counted)} to {max(counted)} stars in "
                                          f"{len(counted)} frames, {np.median(medians):.2f} pix from the catalogue")
    assert np.median(medians) < 0.05 and max(medians) < JUMPED_PX, medians


def test_source_extractor_flags_every_saturated_star(series, tmp_path):
    """A star of which a pixel is at the end of the file's range."""
    clipped, missed = 0, 0
    for path in series.paths:
        found, _ = source_extractor(path, tmp_path)
        pixels = fits.getdata(path)
        for star in found:
            if pixels[star["YMIN_IMAGE"] - 1:star["YMAX_IMAGE"], star["XMIN_IMAGE"] - 1:star["XMAX_IMAGE"]].max() == 65535:
                clipped += 1
                missed += not star["FLAGS"] & 4
    assert missed == 0, f"{missed} of {clipped}"


def test_swarp_adds_the_frames_of_a_target(series, tmp_path):
    number, first, last = debian("SWarp", "swarp"), series.first, series.headers[-1]
    (tmp_path / "frames").write_text("".join(f"{path}\n" for path in series.paths))
    run("SWarp", "@frames", "-COMBINE_TYPE", "WEIGHTED", "-COPY_KEYWORDS", "OBJECT,FILTER", "-VERBOSE_TYPE", "QUIET", "-NTHREADS", "1", cwd=tmp_path)
    added = fits.getheader(tmp_path / "coadd.fits")
    # what it makes of all headers; frames with a noisier sky weigh less, also in these two
    assert added["GAIN"] == pytest.approx(sum(header["GAIN"] for header in series.headers), rel=0.1)
    assert added["SATURATE"] == pytest.approx(first["SATURATE"], rel=0.1)
    assert added["EXPTIME"] == pytest.approx(sum(header["EXPTIME"] for header in series.headers))
    assert (added["MJD-OBS"], added["MJD-END"]) == (pytest.approx(first["MJD-OBS"], abs=1e-7), pytest.approx(last["MJD-END"], abs=1e-7))
    assert (added["OBJECT"], added["FILTER"], added["RADESYS"]) == (first["OBJECT"], first["FILTER"], "ICRS")
    x, y = places(added, first["RA"], first["DEC"])
    assert max(abs(x - added["NAXIS1"] / 2), abs(y - added["NAXIS2"] / 2)) * first["PIXSCALE"] < 120, "the target is in the middle"
    _, of_one = source_extractor(series.paths[0], tmp_path)
    found, of_all = source_extractor(tmp_path / "coadd.fits", tmp_path)
    off = from_catalogue(series, found)
    assert np.median(off) < 0.05 and off.max() < JUMPED_PX, "frames lie on each other, and where the sky is"
    assert of_all["Background_StDev"] < 1.5 * of_one["Background_StDev"] / np.sqrt(len(series.paths)), "noise falls with the number of frames"
    SAID["`swarp`"] = (number, f"{len(series.paths)} frames of one target, {added['EXPTIME']:.0f} s, {np.median(off):.2f} pix from the catalogue")


def test_siril_calibrates_registers_and_stacks(night, series, tmp_path):
    """The steps of its own script for monochrome cameras, on a calibrated night."""
    number, first, last = debian("siril-cli", "siril"), series.first, series.headers[-1]
    like = {"Bias": ("NAXIS1", "NAXIS2"), "Dark": ("NAXIS1", "NAXIS2", "EXPTIME"), "Flat": ("NAXIS1", "NAXIS2", "FILTER")}
    frames = {kind: [path for path in night.of(kind) if all(night.headers[path][keyword] == first[keyword] for keyword in keywords)]
              for kind, keywords in like.items()} | {"Light": series.paths}
    result = siril.result(frames, tmp_path)
    stack = fits.getheader(result)
    assert stack["STACKCNT"] == len(series.paths) and stack["LIVETIME"] == sum(header["EXPTIME"] for header in series.headers)
    for keyword in ("FOCALLEN", "XPIXSZ", "YPIXSZ", "XBINNING", "ROWORDER", "INSTRUME", "TELESCOP", "OBSERVER", "OBJECT", "FILTER", "EXPTIME"):
        assert stack[keyword] == first[keyword], keyword
    assert stack["CVF"] == pytest.approx(first["EGAIN"]) and stack["CCD-TEMP"] == pytest.approx(first["CCD-TEMP"], abs=0.1)
    assert (stack["EXPSTART"], stack["EXPEND"]) == (pytest.approx(first["JD-OBS"], abs=1e-6), pytest.approx(last["JD-END"], abs=1e-6))
    found, _ = source_extractor(result, tmp_path)
    # by pixels: version 1.0.6 lays all frames on the first one, and gives the stack the coordinates of the last one
    x, y = places(first, series.places.ra.deg, series.places.dec.deg)
    off = np.hypot(x[:, None] + 1 - found["X_IMAGE"], y[:, None] + 1 - found["Y_IMAGE"]).min(axis=1)
    assert np.median(off) < JUMPED_PX, "the first frame has its stars where its solution says, and the others lie on it"
    assert (found["FLUX_RADIUS"] < HOT_BELOW * first["FWHM"]).sum() < 0.1 * len(found), "darks take the hot pixels away"
    SAID["`siril`"] = (number, f"{len(series.paths)} light frames calibrated by {len(frames['Bias'])} bias frames, {len(frames['Dark'])} darks and "
                               f"{len(frames['Flat'])} flats, registered and stacked; focal length, pixels and row order are known")


def test_photutils_measures_stars_with_the_errors_of_the_header(night, series):
    from photutils.aperture import ApertureStats, SkyCircularAnnulus, SkyCircularAperture
    from photutils.utils import calc_total_error

    bias = np.median([fits.getdata(path) for path in night.of("Bias") if night.headers[path]["NAXIS1"] == series.first["NAXIS1"]], axis=0)
    fluxes, errors = [], []
    for path, header in zip(series.paths, series.headers):
        px, wcs, pixels = header["PIXSCALE"] * u.arcsec, WCS(header), fits.getdata(path) - bias
        ring = SkyCircularAnnulus(series.places, 5 * header["FWHM"] * px, 8 * header["FWHM"] * px)
        sky = ApertureStats(pixels, ring.to_pixel(wcs)).median
        of_sky = np.sqrt(np.median(sky) / header["GAIN"] + (header["RDNOISE"] / header["GAIN"]) ** 2)
        error = calc_total_error(pixels - np.median(sky), np.full(pixels.shape, of_sky), header["GAIN"])
        star = ApertureStats(pixels, SkyCircularAperture(series.places, 2 * header["FWHM"] * px).to_pixel(wcs), error=error, local_bkg=sky)
        fluxes.append(star.sum / header["EXPTIME"])
        errors.append(star.sum_err / header["EXPTIME"])
    flux, error = np.array(fluxes), np.array(errors)
    # a star against the mean of all takes clouds and air away; what is left is noise, and the errors say how much of it
    curves = flux / flux.mean(axis=0)
    curves /= curves.mean(axis=1, keepdims=True)
    ratio = np.median(curves.std(axis=0, ddof=1) / np.median(error / flux, axis=0))
    zero_points = np.array([[header["MAGZPT"]] for header in series.headers])
    off = np.median(series.mag + 2.5 * np.log10(flux) - zero_points)
    SAID["`photutils`"] = (version("photutils"), f"{len(series.mag)} stars in {len(flux)} frames scatter by {ratio:.2f} of the errors that GAIN and "
                                                 f"RDNOISE give; by MAGZPT they are {abs(off):.2f} mag from the catalogue")
    assert 0.7 < ratio < 1.4
    assert abs(off) < 0.1


def test_astroalign_finds_how_two_frames_lie(night, series):
    import astroalign

    pointed = [path for path in night.of("Acquisition") if night.headers[path]["OBJECT"] == series.first["OBJECT"]]
    one = next(path for path in pointed if night.headers[path].get("SOLVED"))
    transform, (there, _) = astroalign.find_transform(fits.getdata(one).astype(float), fits.getdata(series.paths[-1]).astype(float))
    ra, dec = WCS(night.headers[one]).all_pix2world(*there.T, 0)
    off = np.hypot(*(transform(there).T - places(series.headers[-1], ra, dec)))
    apart = np.hypot(*transform.translation)
    SAID["`astroalign`"] = (version("astroalign"), f"two frames {apart:.0f} pix apart, by {len(there)} stars: as their plate solutions say, to "
                                                   f"{np.median(off):.2f} pix")
    assert len(there) >= 10 and np.median(off) < JUMPED_PX


QUIET = ("-CHECKPLOT_DEV", "NULL", "-CHECKPLOT_TYPE", "NONE", "-NTHREADS", "1", "-VERBOSE_TYPE", "QUIET", "-WRITE_XML", "Y")


def test_scamp_finds_nothing_to_correct(series, catalogues, tmp_path):
    """It matches the stars with the catalogue by their pattern, and says how far the header's solution is off."""
    number, scale, headers = debian("scamp", "scamp"), series.first["PIXSCALE"], series.headers[::3]
    ra, dec, mag = series.catalogue
    error = np.full(len(ra), 0.05 / 3600)
    stars = Table({"X_WORLD": ra, "Y_WORLD": dec, "ERRA_WORLD": error, "ERRB_WORLD": error, "MAG": mag, "MAGERR": np.full(len(ra), 0.02)})
    fits.HDUList([fits.PrimaryHDU(), fits.BinTableHDU(stars, name="LDAC_OBJECTS")]).writeto(tmp_path / "stars.cat")
    run("scamp", *catalogues, "-ASTREF_CATALOG", "FILE", "-ASTREFCAT_NAME", tmp_path / "stars.cat", "-MATCH_RESOL", scale / 2, *QUIET,
        "-FWHM_THRESHOLDS", f"{2 * HOT_BELOW * series.first['FWHM']},100", "-XML_NAME", tmp_path / "scamp.xml", cwd=tmp_path)
    fields = table_of(tmp_path / "scamp.xml", "Fields")
    assert list(fields["Observation_Date"]) == pytest.approx([Time(header["DATE-AVG"]).jyear for header in headers], abs=1e-8)
    assert list(fields["Exposure_Time"]) == pytest.approx([header["EXPTIME"] for header in headers])
    assert list(fields["AirMass"]) == pytest.approx([header["AIRMASS"] for header in headers], abs=0.006), "it has two digits"
    # a mirrored solution has less than this, a true one 20 and more
    assert min(fields["AS_Contrast"].min(), fields["XY_Contrast"].min()) > 5
    off = np.hypot(fields["DX"], fields["DY"]) * 3600 / scale
    assert np.median(off) < 0.05 and off.max() < JUMPED_PX, off
    scale_off, turned = np.abs(fields["DPixelScale"] - 1).max(), np.abs(fields["DPosAngle"]).max()
    SAID["`scamp`"] = (number, f"{len(off)} frames, matched with the catalogue: to be moved by {np.median(off):.3f} pix, their scale is off by "
                               f"{1e6 * scale_off:.0f} millionths at most, and they are turned by {turned:.4f} deg")
    assert scale_off < 1e-4 and turned < 0.01


def test_psfex_finds_the_fwhm_of_the_header(series, catalogues, tmp_path):
    number, headers = debian("psfex", "psfex"), series.headers[::3]
    run("psfex", *catalogues, *QUIET, "-CHECKIMAGE_TYPE", "NONE", "-PSF_DIR", tmp_path, "-XML_NAME", tmp_path / "psfex.xml", cwd=tmp_path)
    fields = table_of(tmp_path / "psfex.xml", "PSF_Fields")
    assert list(fields["PixelScale_WCS_Mean"]) == pytest.approx([header["PIXSCALE"] for header in headers], rel=1e-3)
    ratio = np.median(fields["FWHM_Mean"] / [header["FWHM"] for header in headers])
    accepted, chi2 = fields["NStars_Accepted_Total"], np.median(fields["Chi2_Mean"])
    SAID["`psfex`"] = (number, f"a model of {np.median(accepted):.0f} stars in each of {len(fields)} frames, chi2 {chi2:.2f}; its FWHM is {ratio:.2f} of "
                               "the header's")
    assert np.median(accepted) >= 10 and chi2 == pytest.approx(1.0, abs=0.2)
    assert ratio == pytest.approx(1.0, abs=0.05)


def test_wcstools_goes_from_pixels_to_the_sky_and_back(series, tmp_path):
    number, medians, listed = debian("xy2sky", "wcstools"), [], tmp_path / "places"

    def answers(places, *command) -> np.ndarray:
        np.savetxt(listed, places, "%.8f")
        return np.array([[float(word) for word in re.findall(r"-?\d+\.\d+", line)] for line in run(*command, f"@{listed}").splitlines()])
    for path in series.paths:
        found, _ = source_extractor(path, tmp_path)
        pixels = np.column_stack([found["X_IMAGE"], found["Y_IMAGE"]])
        sky = answers(pixels, "xy2sky", "-d", "-n", 8, path)[:, :2]
        assert np.abs(answers(sky, "sky2xy", "-j", "-n", 4, path)[:, 2:] - pixels).max() < 0.001, "there and back"
        medians.append(np.median(from_catalogue(series, {"ALPHA_J2000": sky[:, 0], "DELTA_J2000": sky[:, 1]})))
    SAID["`wcstools`"] = (number, f"`xy2sky` and `sky2xy`, {len(medians)} frames: stars are {np.median(medians):.2f} pix from the catalogue")
    assert np.median(medians) < 0.05 and max(medians) < JUMPED_PX, medians


def test_gnuastro_finds_stars_and_the_noise_that_gain_gives(night, series, tmp_path):
    number, medians, ratios = debian("astnoisechisel", "gnuastro"), [], []
    made = [tmp_path / name for name in ("sky.fits", "clumps.fits", "found.fits", "difference.fits")]

    def level(path) -> float:
        return float(run("aststatistics", "-q", "-h0", "--sigclip-median", path))

    def noise(one, other) -> float:
        """Of the difference, adu: what the pixels have for themselves falls out."""
        run("astarithmetic", "-q", "-g0", one, "float32", other, "float32", "-", "-o", made[3])
        return float(run("aststatistics", "-q", "-h1", "--sigclip-std", made[3]))
    for path, header in zip(series.paths[::3], series.headers[::3]):
        run("astnoisechisel", "-q", "-h0", path, "-o", made[0])
        run("astsegment", "-q", made[0], "-o", made[1])
        run("astmkcatalog", "-q", "--clumpscat", "--ids", "--ra", "--dec", "--halfmaxsum", made[1], "-o", made[2])
        found = fits.getdata(made[2], 2, memmap=False)
        assert found.columns["HALF_MAX_SUM"].unit == "adu", "by BUNIT"
        medians.append(np.median(from_catalogue(series, {"ALPHA_J2000": found["RA"], "DELTA_J2000": found["DEC"]})))
    bias = [path for path in night.of("Bias") if night.headers[path]["NAXIS1"] == series.first["NAXIS1"]][:2]
    gain, read, zero = series.first["GAIN"], series.first["RDNOISE"], level(bias[0])
    read_noise = noise(*bias) / np.sqrt(2) * gain
    for at in range(0, len(series.paths) - 1, 3):
        levels = [level(path) for path in series.paths[at:at + 2]]
        assert levels[0] == pytest.approx(series.headers[at]["BKGLEVEL"], abs=0.5 * series.headers[at]["BKGNOISE"])
        photons = sum((sky - zero) / gain + (read / gain) ** 2 for sky in levels)
        ratios.append(noise(*series.paths[at:at + 2]) / np.sqrt(photons))
    SAID["`gnuastro`"] = (number, f"stars are {np.median(medians):.2f} pix from the catalogue; the sky has {np.median(ratios):.2f} of the noise that GAIN and "
                                  f"RDNOISE give, two bias frames have {read_noise:.1f} electrons, RDNOISE says {read:.1f}")
    assert np.median(medians) < 0.1 and max(medians) < JUMPED_PX, medians
    assert read_noise == pytest.approx(read, rel=0.03)
    assert np.median(ratios) == pytest.approx(1.0, abs=0.1)


def test_sep_finds_sky_and_stars_as_the_header_says(series):
    import sep

    offs, zero_points, ra, dec = [], [], series.places.ra.deg, series.places.dec.deg
    for path, header in zip(series.paths, series.headers):
        pixels = fits.getdata(path).astype(np.float32)
        sky = sep.Background(pixels)
        assert sky.globalback == pytest.approx(header["BKGLEVEL"], abs=0.5 * header["BKGNOISE"])
        assert sky.globalrms == pytest.approx(header["BKGNOISE"], rel=0.15)
        light = pixels - sky
        found = sep.extract(light, 5, err=sky.globalrms)
        x, y, _ = sep.winpos(light, found["x"], found["y"], header["FWHM"] / 2.355)
        apart = np.hypot(*(wanted[:, None] - seen for wanted, seen in zip(places(header, ra, dec), (x, y))))
        star = apart.argmin(axis=1)
        offs.append(np.median(apart.min(axis=1)))
        flux, _, _ = sep.sum_circle(light, x[star], y[star], 2 * header["FWHM"])
        zero_points.append(np.median(series.mag + 2.5 * np.log10(flux / header["EXPTIME"])) - header["MAGZPT"])
    off = np.median(zero_points)
    SAID["`sep`"] = (version("sep"), f"sky and noise of {len(offs)} frames as in the header; {len(ra)} stars are {np.median(offs):.2f} pix from the catalogue, "
                                     f"and by MAGZPT {abs(off):.2f} mag")
    assert np.median(offs) < 0.05 and max(offs) < JUMPED_PX, offs
    assert abs(off) < 0.1


def test_reproject_adds_frames_with_north_up(night, series):
    """An acquisition frame, which lies elsewhere, and each third frame."""
    import sep
    from reproject import reproject_interp
    from reproject.mosaicking import find_optimal_celestial_wcs, reproject_and_coadd

    pointed = [path for path in night.of("Acquisition") if night.headers[path]["OBJECT"] == series.first["OBJECT"]]
    paths = [next(path for path in pointed if night.headers[path].get("SOLVED")), *series.paths[::3]]
    headers = [night.headers[path] for path in paths]
    frames = [((fits.getdata(path) - header["BKGLEVEL"]) / header["EXPTIME"], WCS(header)) for path, header in zip(paths, headers)]
    grid, shape = find_optimal_celestial_wcs(frames)
    added, covered = reproject_and_coadd(frames, grid, shape_out=shape, reproject_function=reproject_interp)
    x, y = grid.all_world2pix(series.places.ra.deg, series.places.dec.deg, 0)
    seen_x, seen_y, _ = sep.winpos(np.nan_to_num(added).astype(np.float32), x, y, series.first["FWHM"] / 2.355)
    off = np.hypot(seen_x - x, seen_y - y)
    SAID["`reproject`"] = (version("reproject"), f"{len(paths)} frames, one of them an acquisition frame, added with north up: stars are "
                                                 f"{np.median(off):.2f} pix from the catalogue")
    assert covered.max() == len(paths), "they overlap"
    assert np.median(off) < 0.05 and off.max() < JUMPED_PX, off


def test_prose_makes_a_light_curve_with_no_definition_of_the_telescope(night, series, tmp_path):
    python = pathlib.Path(os.environ.get("STARMESH_PROSE", PROJECT / "target/venv-prose/bin/python"))
    assert python.exists(), f"{python} is missing: scripts/setup proof makes it, with Python 3.9 to 3.11"
    star = series.mag.argmin()
    said = run(python, "-B", "-W", "ignore", PROJECT / "tests/foreign/prose_curve.py", night.folder / "images",
               series.places[star].ra.deg, series.places[star].dec.deg, series.first["OBJECT"], env=os.environ | {"HOME": str(tmp_path)})
    made = json.loads(said.splitlines()[-1])
    lights = [path for path in night.of("Light") if night.headers[path]["OBJECT"] == series.first["OBJECT"]]
    headers, files = [night.headers[path] for path in lights], made["files"]
    assert files["images"] == [path.name for path in lights], "acquisition frames are not among them"
    for kind, name in (("Bias", "bias"), ("Dark", "darks"), ("Flat", "flats")):
        keywords = ("NAXIS1", "NAXIS2", *(["FILTER"] if kind == "Flat" else []))
        wanted = [path.name for path in night.of(kind) if all(night.headers[path][keyword] == series.first[keyword] for keyword in keywords)]
        assert sorted(files[name]) == wanted, kind
    assert made["telescope"] == series.first["TELESCOP"] and made["off_px"] < 0.3, "the star is where the header says"
    assert made["sources"] == pytest.approx(headers[0]["NSTARS"], rel=0.15), "darks take the hot pixels away"
    # its own time is the start of the exposure; what its documents do with AIRMASS gives the middle from BJD_TDB
    assert made["jd"] == pytest.approx([header["JD-OBS"] for header in headers], abs=1e-6)
    assert made["bjd"] == [header["BJD_TDB"] for header in headers]
    noise = np.std([flux for _, flux in made["points"]], ddof=1)
    photons = 10 ** (0.4 * (series.first["MAGZPT"] - series.mag[star])) * series.first["EXPTIME"] * series.first["GAIN"]
    SAID["`prose`"] = (made["version"], f"a light curve of {len(headers)} frames by their {len(files['bias'])} bias frames, {len(files['darks'])} "
                                        f"darks and {len(files['flats'])} flats: {1086 * noise:.1f} mmag, photons alone {1086 * photons ** -0.5:.1f}")
    assert len(made["points"]) == len(headers) and noise < 2 * photons ** -0.5


def examples() -> list[str]:
    text = (PROJECT / "docs/operator/database.md").read_text()
    return re.findall(r"```python\n(.*?)```", text, re.S)


def test_the_examples_of_the_database_run_as_they_are_printed(night, tmp_path):
    """The second one goes on where the first one ends."""
    pandas, duckdb = examples()
    script = tmp_path / "weather.py"
    script.write_text(pandas + duckdb)
    import sys

    printed = run(sys.executable, script, night.folder / "data/archive.db")
    lights = [path for path in night.of("Light") if "FWHM" in night.headers[path] and night.headers[path].get("SOLVED")]
    assert len(re.findall(r"^\d+ +20\d\d-", printed, re.M)) >= len(lights) > 0, printed
    assert "fwhm_zenith_arcsec" in printed and "guide_rms_arcsec" in printed
    for name in ("pandas", "duckdb"):
        SAID[f"`{name}`"] = (version(name), "the example of [database.md](database.md)")


def test_what_each_tool_said_is_in_the_document(night):
    """Last in this file: the table is made of what the tests above noted. Versions and counts change; the tools do not."""
    rows = [f"| {tool} | {number} | {said} |\n" for tool, (number, said) in sorted(SAID.items())]
    table = "| tool | version | what it said of the demo's night |\n|---|---|---|\n" + "".join(rows)
    before, rest = DOCUMENT.read_text().split(BEGIN)
    block, after = rest.split(END)
    if os.environ.get("UPDATE_DOCS") == "1":
        DOCUMENT.write_text(before + BEGIN + table + END + after)
        return
    tools = lambda text: re.findall(r"^\| (`[^|]+`) \|", text, re.M)
    assert tools(block) == tools(table), "run UPDATE_DOCS=1 pytest tests/foreign/test_tools.py"
