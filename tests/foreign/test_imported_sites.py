"""Sites of the predecessor, imported and run as they are: the programs that a user types, on simulators in the devices' place."""

import json
import pathlib
import shutil
import subprocess
import sys
import zipfile

import pytest
from astropy.io import fits
from shared import PROJECT

# read for its templates where the tests run; no part of it becomes part of this project
PREDECESSOR = "astra==1.2.0"


def night(name: str, starmesh: str, old: pathlib.Path, folder: pathlib.Path) -> dict:
    assert shutil.which("ip"), "iproute2 is missing: apt-get install iproute2 (scripts/setup does)"
    script = pathlib.Path(__file__).with_name("imported_site.py")
    done = subprocess.run(["unshare", "--net", sys.executable, "-B", str(script), name, starmesh, str(old), str(folder)],
                          capture_output=True, text=True, timeout=400)
    if done.returncode != 0:
        logs = "\n".join(f"--- {p.name}\n" + "\n".join(p.read_text(errors="replace").splitlines()[-30:])
                         for p in sorted(folder.glob("*.log")))
        pytest.fail(f"{done.stdout}{done.stderr}\n{logs}")
    return json.loads(done.stdout)


def frames(folder: pathlib.Path) -> dict[str, dict]:
    """Headers by path below the folder of images."""
    found = {}
    for images in folder.rglob("images"):
        for path in images.rglob("*.fits"):
            found[str(path.relative_to(images))] = dict(fits.getheader(path))
    return found


def of_type(headers: dict[str, dict], camera: str, kind: str) -> list[tuple[str, dict]]:
    return [(path, header) for path, header in headers.items() if header["IMAGETYP"] == kind and camera in path]


def test_two_telescopes_under_one_roof_observe_with_the_imported_files(starmesh, tmp_path):
    old = tmp_path / "old"
    shutil.copytree(PROJECT / "tests/data/old_site", old)
    outcome = night("twins", starmesh, old, tmp_path)
    assert outcome["shutter"] == 1 and outcome["parked"] == [True, True] and outcome["codes"] == [0, 0, 0], outcome
    assert outcome["met"] == [], "a shared roof too waits for the park"
    assert '"guidng", which Astra passed over too' in outcome["printed"], outcome["printed"]
    headers = frames(tmp_path / "new")
    for camera, name, number in [("north_cam", "North Field", 4711), ("south_cam", "South Field", 4712)]:
        lights = of_type(headers, camera, "Light Frame")
        # the site's own template
        assert sorted(path.split("/", 1)[1] for path, _ in lights) == [f"{camera}/{name}_V_{n:03d}.fits" for n in range(2)]
        for path, header in lights:
            assert (header["ORIGIN"], header["NTELS"], header["PROPID"]) == ("Twin Hill", 2, number), path
            # telemetry of the camera, of its focuser and, for both, of what they share
            assert abs(header["CCD-TEMP"] - 5) <= 2 and header["FOCUSPOS"] == 10000, path
            assert header["DOMESTAT"] == 0 and 0 < header["HUMIDITY"] < 85, path
            assert header["ALTITUDE"] > 30 and header["AIRMASS"] > 1 and header["LAT-OBS"] == pytest.approx(-24.6), path
        assert len(of_type(headers, camera, "Bias Frame")) == 2
    flats = [(path, header) for path, header in of_type(headers, "north_cam", "Flat Frame") if "REFUSED" not in header]
    assert len(flats) == 2 and all(abs(header["BKGLEVEL"] - 20000) <= 12000 for _, header in flats), flats
    assert len(of_type(headers, "north_cam", "Dark Frame")) == 1


@pytest.fixture(scope="module")
def templates(tmp_path_factory) -> dict[str, str]:
    """The predecessor's template files, out of its package: 0.6 MB, without what it depends on."""
    folder = tmp_path_factory.mktemp("predecessor")
    subprocess.run([sys.executable, "-m", "pip", "download", "-q", "--disable-pip-version-check", "--no-deps", "-d", str(folder), PREDECESSOR],
                   check=True, timeout=120)
    [wheel] = folder.glob("*.whl")
    with zipfile.ZipFile(wheel) as package:
        return {name: package.read(f"astra/config/templates/observatory_{name}").decode()
                for name in ["config.yml", "fits_header_config.csv"]}


def test_the_predecessors_own_templates_observe_on_the_simulator(starmesh, templates, tmp_path):
    old = tmp_path / "old"
    config = old / "observatory_config"
    config.mkdir(parents=True)
    for name, text in templates.items():
        # as the predecessor installs them for an observatory of this name
        (config / f"template_{name}").write_text(text.replace("observatoryname", "template"))
    outcome = night("template", starmesh, old, tmp_path)
    assert outcome["shutter"] == 1 and outcome["parked"] == [True] and outcome["codes"] == [0], outcome
    # its pulse lengths were never measured at this site, and it is said
    assert "were never measured" in outcome["printed"], outcome["printed"]
    headers = frames(tmp_path / "new")
    lights = of_type(headers, "camera_template", "Light Frame")
    assert len(lights) == 3 and all(header["OBJECT"] == "A Field" and header["ID"] == 17 for _, header in lights), lights
    rows = [line.split(",")[0].strip('"') for line in templates["fits_header_config.csv"].splitlines()[1:]]
    asked = {row for row in rows if row}
    # BLANK would turn pixels of 0 ADU into undefined ones; the simulated mount has no side of its pier until it has slewed
    for path, header in lights:
        missing = asked - set(header) - {"BLANK", "BSCALE", "BZERO"}
        assert not missing, (path, missing)
    assert len(of_type(headers, "camera_template", "Bias Frame")) == len(of_type(headers, "camera_template", "Dark Frame")) == 2
