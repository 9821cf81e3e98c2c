"""Frames of a short night, and the copies that archives get of them, judged by programs that we did not write.

Hardware: PyPI alpaca-simulators. Judges: fitsverify, astropy, and LCO's own ocs-archive and ocs-ingester (PyPI), offline.
"""

import os
import random
import resource
import shutil
import signal
import subprocess
import time

import numpy as np
import pytest
from astropy import units as u
from astropy.coordinates import AltAz, EarthLocation, SkyCoord, get_body
from astropy.io import fits
from astropy.time import Time
from bus_subscriber import BusSubscriber
from site_under_test import ELEVATION, LATITUDE, LONGITUDE, PREFIX, SITE, TELESCOPE, Record, Site, dense_field, observing

# ocs-archive reads these when it is imported; a store of files is the one that works without a network
os.environ.setdefault("FILESTORE_TYPE", "local")

HERE = EarthLocation.from_geodetic(LONGITUDE, LATITUDE, ELEVATION)
PROGRAMME = "LCO2026B-001"
INSTRUMENT = f"{SITE}-{TELESCOPE}-camera_1"
# what an archive calls this site, and no frame of ours knows
GIVEN = {"astra": [], "lco": ["--set", "SITEID=bfr", "--set", "TELID=1m0a"], "eso": ["--set", "INSTRUME=SPECULOOS1"]}


class NightRecord(Record):
    copies: dict[str, dict]


@pytest.fixture(scope="module")
def night(starmesh, catalogue, tmp_path_factory):
    """Three frames of a field, a dark and a bias; and the copies of all of them, by profile."""
    site = Site(starmesh, tmp_path_factory.mktemp("night"), catalogue)
    record = NightRecord()
    record.site = site
    with observing(record):
        site.put("safetymonitor/0/issafe", IsSafe="true")
        now = Time.now()
        now.delta_ut1_utc = 0.0
        near = dense_field(now.sidereal_time("mean", HERE.lon).deg - 15)
        field = {"object": "Field Ä", "ra": near, "dec": 50.0, "exptime": 2.0, "n": 3, "filter": site.get("filterwheel/0/names")[1]}
        rows = [("open", {}), ("object", field), ("calibration", {"exptime": [0, 1.0], "n": [1, 1]})]
        site.schedule(rows, seconds=300, programme=PROGRAMME)
        site.start_nodes()
        record.subscriber = BusSubscriber(site.endpoint)

        def complete(_) -> bool:
            stored = [payload for key, payload in record.subscriber.received if key == f"{PREFIX}/archive/stored"]
            return len({payload["frame"] for payload in stored if payload["header_complete"]}) == 5

        record.subscriber.wait_for("the headers of five frames are complete", complete, 120)
    record.copies = {}
    for profile, given in GIVEN.items():
        out = site.folder / profile
        command = [starmesh, "fits", "convert", *map(str, site.fits()), "--profile", profile, "--out", str(out), *given]
        made = subprocess.run(command, capture_output=True, text=True)
        assert made.returncode == 0, made.stderr
        pairs = [line.rsplit(" -> ", 1) for line in made.stdout.splitlines()]
        record.copies[profile] = {out / copy: original for original, copy in pairs}
    yield record


def test_every_frame_has_a_copy_by_every_profile(night):
    assert len(night.site.fits()) == 5
    for profile, copies in night.copies.items():
        on_disk = sorted(path.name for path in (night.site.folder / profile).iterdir())
        assert on_disk == sorted(path.name for path in copies) and len(on_disk) == 5, (profile, on_disk)
    assert {path.read_bytes() for path in night.copies["astra"]} == {path.read_bytes() for path in night.site.fits()}


@pytest.mark.parametrize("profile", GIVEN)
def test_our_own_check_and_fitsverify_find_nothing(night, starmesh, profile):
    assert shutil.which("fitsverify"), "fitsverify is missing: apt-get install fitsverify (scripts/setup does)"
    files = [str(path) for path in night.copies[profile]]
    checked = subprocess.run([starmesh, "fits", "check", *files, "--profile", profile], capture_output=True, text=True)
    assert checked.returncode == 0, checked.stdout
    verdict = subprocess.run(["fitsverify", *files], capture_output=True, text=True)
    assert verdict.returncode == 0, verdict.stdout
    assert verdict.stdout.count("Verification found 0 warning(s) and 0 error(s)") == len(files), verdict.stdout


@pytest.mark.parametrize("profile", GIVEN)
def test_pixels_are_the_same_and_sums_are_right(night, profile, recwarn):
    for copy, original in night.copies[profile].items():
        with fits.open(copy, checksum=True) as copied, fits.open(original) as ours:
            assert "CHECKSUM" in copied[0].header and "DATASUM" in copied[0].header
            assert copied[0].header["DATASUM"] == ours[0].header["DATASUM"]
            assert copied[0].data.dtype == ours[0].data.dtype == np.uint16
            assert np.array_equal(copied[0].data, ours[0].data)
            assert np.ptp(ours[0].data) > 0, "the frame shows something"
    assert not [w for w in recwarn if "checksum" in str(w.message).lower() or "datasum" in str(w.message).lower()]


def convert(starmesh, night, out, **options):
    files = [str(path) for path in night.site.fits()]
    command = [starmesh, "fits", "convert", *files, "--profile", "lco", "--out", str(out), *GIVEN["lco"]]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **options)


def contents(folder) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def test_a_kill_at_any_moment_leaves_whole_copies_or_none(night, starmesh, tmp_path):
    """Thirty kills while copies are made; what has the name of a copy is that copy, and the last run makes the rest."""
    whole = contents(night.site.folder / "lco")
    began = time.monotonic()
    convert(starmesh, night, tmp_path / "first").communicate()
    takes_s = time.monotonic() - began
    out, killed, instants = tmp_path / "out", 0, random.Random(20261121)
    for _ in range(30):
        shutil.rmtree(out, ignore_errors=True)
        process = convert(starmesh, night, out)
        time.sleep(instants.uniform(0.0, takes_s))
        process.kill()
        process.communicate()
        killed += process.returncode == -signal.SIGKILL
        for name, content in contents(out).items() if out.exists() else []:
            assert name.startswith(".") or content == whole[name], f"{name} is not whole"
    assert killed >= 10, "the kills came too late to show anything"
    process = convert(starmesh, night, out)
    _, error = process.communicate()
    assert process.returncode == 0, error
    assert {name: content for name, content in contents(out).items() if not name.startswith(".")} == whole


def test_four_converters_at_once_make_each_copy_once(night, starmesh, tmp_path):
    processes = [convert(starmesh, night, tmp_path) for _ in range(4)]
    answers = [process.communicate() for process in processes]
    assert [process.returncode for process in processes] == [0] * 4, answers
    assert sum(out.count("(was there already)") for out, _ in answers) == 15, "each copy is made by one of them"
    assert contents(tmp_path) == contents(night.site.folder / "lco")


def test_a_disk_that_takes_no_more_leaves_nothing_behind(night, starmesh, tmp_path):
    """A limit on the size of files stands for the full disk: the system refuses the bytes beyond it."""
    def limited():
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (500_000, 500_000))

    process = convert(starmesh, night, tmp_path, preexec_fn=limited)
    _, error = process.communicate()
    assert process.returncode == 1 and error.count("cannot write") == 5 and "5 of 5 files were not converted" in error, error
    assert contents(tmp_path) == {}


def test_ocs_archive_and_the_ingester_accept_the_profile_lco(night, tmp_path):
    from ocs_archive.input.file import File
    from ocs_archive.input.filefactory import FileFactory
    from ocs_archive.input.lcofitsfile import LcoFitsFile
    from ocs_archive.storage.filesystemstore import FileSystemStore
    from ocs_ingester import ingester

    types, outlines = [], 0
    for copy in night.copies["lco"]:
        header = fits.getheader(copy)
        with open(copy, "rb") as opened:
            record = ingester.validate_fits_and_create_archive_record(opened)
            assert record["basename"] == copy.name.removesuffix(".fits"), "a dot in a name would end it"
            assert (record["site_id"], record["telescope_id"], record["instrument_id"]) == ("bfr", "1m0a", INSTRUMENT)
            assert record["proposal_id"] == PROGRAMME
            assert record["reduction_level"] == 0
            assert record["observation_date"] == header["DATE-OBS"]
            assert record["observation_day"] == header["NIGHT"]
            assert isinstance(record["observation_id"], int) and record["observation_id"] % 10_000 in (1, 2), "row of the schedule"
            types.append(record["configuration_type"])
            if header.get("SOLVED"):
                corners = SkyCoord(record["area"]["coordinates"][0], unit="deg")
                target = SkyCoord(header["RA"], header["DEC"], unit=("hourangle", "deg"))
                assert corners.separation(target).deg.max() < 0.2, "the outline is around the target"
                outlines += 1
            for reader in (FileFactory.get_datafile_class_for_extension(".fits"), LcoFitsFile):
                data = reader(File(opened))
                stored = FileSystemStore(str(tmp_path)).store_file(data)
                path = tmp_path / "bfr" / INSTRUMENT / header["NIGHT"] / "raw" / copy.name
                assert path.read_bytes() == copy.read_bytes() and len(stored["md5"]) == 32
    assert sorted(types) == ["BIAS", "DARK", "EXPOSE", "EXPOSE", "EXPOSE"] and outlines >= 1


@pytest.mark.parametrize(("kind", "given", "proposal", "is_public"), [
    ("Bias Frame", None, "calibrate", True),
    ("Bias Frame", "N/A", "calibrate", True),
    ("Dark Frame", "calib", "calib", True),
    ("Flat Frame", PROGRAMME, PROGRAMME, True),
    ("Light Frame", PROGRAMME, PROGRAMME, False),
    ("Light Frame", "calib", "calib", True),
    ("Light Frame", None, None, None),
    ("Light Frame", "UNKNOWN", None, None),
])
def test_the_ingester_has_the_proposal_of_each_copy_and_makes_public_what_our_check_says(starmesh, tmp_path, kind, given, proposal, is_public):
    """Without a night: calibration frames are public at once, and so are frames of the sky of which the check warns."""
    from ocs_ingester import ingester

    file, out = tmp_path / "a.fits", tmp_path / "lco"
    frame = fits.PrimaryHDU(np.zeros((3, 4), np.uint16))
    frame.header.update({"IMAGETYP": kind, "DATE-OBS": "2026-11-21T03:12:41.006789", "EXPTIME": 1.0, "INSTRUME": INSTRUMENT, "OBSERVAT": SITE,
                         "TELESCOP": TELESCOPE, "NIGHT": "20261120", "SCHEDROW": 7} | ({"PROPID": given} if given else {}))
    frame.writeto(file, checksum=True)
    made = subprocess.run([starmesh, "fits", "convert", file, "--profile", "lco", "--out", out], capture_output=True, text=True)
    if proposal is None:
        assert made.returncode == 1 and "PROPID is missing" in made.stderr, made.stderr
        return
    assert made.returncode == 0, made.stderr
    [copy] = out.iterdir()
    with open(copy, "rb") as opened:
        record = ingester.validate_fits_and_create_archive_record(opened)
    assert record["proposal_id"] == proposal and (record["public_date"] == record["observation_date"]) == is_public
    checked = subprocess.run([starmesh, "fits", "check", copy, "--profile", "lco"], capture_output=True, text=True)
    assert checked.returncode == 0, checked.stdout
    for said in (made.stderr, checked.stdout):
        assert ("becomes public at once" in said) == (is_public and kind == "Light Frame"), said


def test_ocs_archive_refuses_our_files_as_they_are(night):
    """So that the test above can fail."""
    from ocs_ingester import ingester
    from ocs_ingester.exceptions import DoNotRetryError

    with open(night.site.fits()[0], "rb") as opened, pytest.raises(DoNotRetryError):
        ingester.validate_fits_and_create_archive_record(opened)


def test_the_profile_eso_has_what_its_validator_asks_for(night):
    kinds = []
    for copy in night.copies["eso"]:
        header = fits.getheader(copy)
        start = Time(header["DATE-OBS"], scale="utc")
        assert copy.name == f"SPECULOOS1.{header['DATE-OBS'][:23].replace(':', '_')}.fits"
        assert header["ESO OBS PROG ID"] == PROGRAMME and header["ESO INS NAME"] == "SPECULOOS1"
        assert abs(header["UTC"] - (start.mjd % 1) * 86400) < 1e-3
        assert abs(header["MJD-END"] - start.mjd - header["EXPTIME"] / 86400) < 1e-8
        assert header["BUNIT"] == "adu" and header["ORIGIN"] == SITE
        assert not {"HISTORY", "COMMENT", "EPOCH", "RADECSYS"} & set(header)
        world = [keyword for keyword in header if keyword.startswith(("CTYPE", "CRVAL", "CRPIX", "CD", "PC", "RADESYS", "EQUINOX"))]
        if header["ESO DPR CATG"] == "CALIB":
            assert header["CTYPE1"] == "PIXEL" and header["PC1_1"] == header["CDELT2"] == 1
        if "CTYPE1" in header:
            assert all(list(header).index("WCSAXES") < list(header).index(keyword) for keyword in world)
            assert not ({"CD1_1", "PC1_1"} <= set(header))
        kinds.append((header["ESO DPR CATG"], header["ESO DPR TYPE"], header["ESO DPR TECH"]))
    assert sorted(kinds) == [("CALIB", "BIAS", "IMAGE"), ("CALIB", "DARK", "IMAGE")] + 3 * [("SCIENCE", "OBJECT", "IMAGE")]


def test_values_of_the_middle_of_the_exposure_agree_with_astropy(night):
    seen = 0
    for path in night.site.fits():
        header = fits.getheader(path)
        assert (header["OBSERVAT"], header["TELESCOP"], header["PROGID"]) == (SITE, f"{SITE}-{TELESCOPE}", PROGRAMME)
        middle = Time(header["DATE-OBS"], scale="utc") + header["EXPTIME"] / 2 * u.s
        middle.delta_ut1_utc = 0.0
        assert abs(header["MJD-AVG"] - middle.mjd) < 1e-8, path
        assert abs((Time(header["DATE-AVG"], scale="utc") - middle).sec) < 2e-6, path
        sky = AltAz(obstime=middle, location=HERE, pressure=0 * u.hPa)
        sun, moon = (get_body(body, middle, HERE) for body in ("sun", "moon"))
        assert abs(header["SUNALT"] - sun.transform_to(sky).alt.deg) < 0.002, path
        assert abs(header["MOONALT"] - moon.transform_to(sky).alt.deg) < 0.005, path
        if header["IMAGETYP"] != "Light Frame":
            continue
        target = SkyCoord(header["RA"] * u.deg, header["DEC"] * u.deg).transform_to(sky)
        assert abs(header["MOONDIST"] - target.separation(moon.transform_to(sky)).deg) < 0.02, path
        assert 0 <= header["MOONFRAC"] <= 1
        c = np.sin(target.alt.rad)
        young = (1.002432 * c**2 + 0.148386 * c + 0.0096467) / (c**3 + 0.149864 * c**2 + 0.0102963 * c + 0.000303978)
        assert abs(header["AIRMMID"] - young) < 1e-4, path
        assert any("GUIDERMS" in line for line in header["HISTORY"]), "the frames are not guided, and HISTORY says so"
        seen += 1
    assert seen == 3
