"""The files and the database of the demo's night, as they are, by the programs that people use; and what each said, in docs/operator/files.md.

`UPDATE_DOCS=1` writes the table there again.
"""

import os
import pathlib
import re
import shutil
import sqlite3
import subprocess
import warnings
from importlib.metadata import version

import numpy as np
import pytest
from astropy import units as u
from astropy.io import fits
from astropy.nddata import CCDData
from astropy.time import Time
from astropy.wcs import WCS
from ports import free_port
from shared import PROJECT

DOCUMENT = PROJECT / "docs/operator/files.md"
BEGIN, END = "<!-- tools: begin -->\n", "<!-- tools: end -->"
NAME = re.compile(r"\d{8}T\d{6}-\d{3}_[A-Za-z0-9+-]+_(light|acquisition|bias|dark|flat|test)(_[A-Za-z0-9+-]+){1,3}\.fits")
SAID: dict[str, tuple[str, str]] = {}


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


@pytest.fixture(scope="module")
def night(starmesh, tmp_path_factory) -> Night:
    """Where a kept night is given (`STARMESH_NIGHT`), that one."""
    if given := os.environ.get("STARMESH_NIGHT"):
        return Night(pathlib.Path(given))
    folder = tmp_path_factory.mktemp("demo") / "night"
    subprocess.run([starmesh, "demo", "--speed", "600", "--size-px", "1024", "--port", str(free_port()), "--keep", str(folder)],
                   capture_output=True, timeout=600, check=False)
    return Night(folder)


def run(*command) -> str:
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return done.stdout


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


def test_ocs_archive_takes_the_names_and_a_whole_night_by_the_profile_lco(night, starmesh, tmp_path):
    os.environ.setdefault("FILESTORE_TYPE", "local")
    from ocs_archive.input.file import File
    from ocs_archive.input.filefactory import FileFactory

    out = tmp_path / "lco"
    run(starmesh, "fits", "convert", *night.files, "--profile", "lco", "--out", out, "--set", "SITEID=dem", "--set", "TELID=0m3a")
    copies = sorted(out.iterdir())
    for path in [*night.files, *copies]:
        with open(path, "rb") as opened:
            file = File(opened, path.name)
            assert (file.basename, file.extension) == (path.stem, ".fits"), path
            FileFactory.get_datafile_class_for_extension(file.extension)(file, required_headers=[])
    SAID["`ocs-archive`"] = (version("ocs-archive"), f"{len(copies)} copies of {len(night.files)} frames by profile `lco`")
    assert len(copies) == len(night.files)


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
