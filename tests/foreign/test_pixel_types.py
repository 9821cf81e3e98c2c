"""Every type of pixel that an Alpaca camera may send, from its answer to the FITS file, plain and compressed.

Hardware: PyPI alpaca-simulators; in front of them a server that passes everything on, and answers `imagearray` itself.
Judges: astropy, fitsverify, and funpack of Debian's libcfitsio-bin.
"""

import http.client
import http.server
import json
import shutil
import struct
import subprocess
import threading

import numpy as np
import pytest
from astropy.io import fits
from bus_subscriber import BusSubscriber
from ports import free_port
from site_under_test import PREFIX, Record, Site, observing

WIDTH, HEIGHT = 96, 64
# name, numbers of ASCOM's ImageArrayElementTypes (the camera's own, as sent; 0: JSON), numpy's type, planes, BITPIX in the file
CASES = [
    ("byte", 2, 6, np.uint8, 1, 16),
    ("int16", 1, 1, np.int16, 1, 32),
    ("uint16", 2, 8, np.uint16, 1, 16),
    ("int32", 2, 2, np.int32, 1, 32),
    ("uint32", 9, 9, np.uint32, 1, -64),
    ("single", 4, 4, np.float32, 1, -64),
    ("double", 3, 3, np.float64, 1, -64),
    ("int64", 7, 7, np.int64, 1, -64),
    ("uint64", 5, 5, np.uint64, 1, -64),
    ("uint16 colour", 2, 8, np.uint16, 3, 16),
    ("int32 colour", 2, 2, np.int32, 3, 32),
    ("double colour", 3, 3, np.float64, 3, -64),
    ("int32 JSON", 2, 0, np.int32, 1, 32),
    ("double JSON", 3, 0, np.float64, 1, -64),
    ("double colour JSON", 3, 0, np.float64, 3, -64),
]


def pixels(kind, planes: int, seed: int) -> np.ndarray:
    """Numbers over the whole range of a type, its ends among them; 64 bits as far as a double holds every whole number."""
    random = np.random.default_rng(seed)
    shape = (planes, HEIGHT, WIDTH)
    if np.issubdtype(kind, np.floating):
        image = (random.normal(0.0, 1e3, shape) * 10.0 ** random.integers(-20, 20, shape)).astype(kind)
        ends = [np.finfo(kind).max, np.finfo(kind).min, 1 / 3]
    else:
        limits = np.iinfo(kind)
        ends = [max(limits.min, -(2**53)), min(limits.max, 2**53), 0]
        image = random.integers(ends[0], ends[1], shape, dtype=kind, endpoint=True)
    image.reshape(-1)[: len(ends)] = ends
    return image


IMAGES = [pixels(kind, planes, seed) for seed, (_, _, _, kind, planes, _) in enumerate(CASES)]
IMAGES[5].reshape(-1)[3] = IMAGES[6].reshape(-1)[3] = np.nan
# what compressed tiles would not give back, so that the file stays plain
STAYS_PLAIN = 6
IMAGES[STAYS_PLAIN].reshape(-1)[4:8] = [np.inf, -np.inf, -0.0, 5e-324]


def answer(number: int, transaction: int) -> tuple[str, bytes]:
    """What the camera answers for its image of this number: ASCOM's order is column, row, plane."""
    _, own, sent, _, planes, _ = CASES[number]
    columns = np.ascontiguousarray(np.moveaxis(IMAGES[number], (0, 1, 2), (2, 1, 0)))
    if sent == 0:
        value = (columns[:, :, 0] if planes == 1 else columns).tolist()
        body = {"Type": own, "Rank": 2 if planes == 1 else 3, "Value": value, "ClientTransactionID": transaction,
                "ServerTransactionID": 1, "ErrorNumber": 0, "ErrorMessage": ""}
        return "application/json", json.dumps(body).encode()
    rank, third = (2, 0) if planes == 1 else (3, planes)
    header = struct.pack("<11i", 1, 0, transaction, 1, 44, own, sent, rank, WIDTH, HEIGHT, third)
    return "application/imagebytes", header + columns.astype(columns.dtype.newbyteorder("<")).tobytes()


class Camera(http.server.BaseHTTPRequestHandler):
    """Passes everything on to the simulators, but the images."""

    protocol_version = "HTTP/1.1"
    simulators: int
    sent = 0

    def do_GET(self):
        name = self.path.lower().partition("?")
        if name[0].endswith("/camera/0/imagearray"):
            transaction = int(name[2].partition("clienttransactionid=")[2].partition("&")[0] or 0)
            kind, body = answer(type(self).sent % len(CASES), transaction)
            type(self).sent += 1
            return self.reply(200, kind, body)
        return self.pass_on(None)

    def do_PUT(self):
        self.pass_on(self.rfile.read(int(self.headers.get("Content-Length", 0))))

    def pass_on(self, body):
        connection = http.client.HTTPConnection("127.0.0.1", self.simulators, timeout=30)
        headers = {key: value for key, value in self.headers.items() if key.lower() in ("content-type", "accept")}
        connection.request(self.command, self.path, body, headers)
        answered = connection.getresponse()
        self.reply(answered.status, answered.headers.get("Content-Type", "application/json"), answered.read())
        connection.close()

    def reply(self, status: int, kind: str, body: bytes):
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_):
        pass


class NightRecord(Record):
    files: list
    compressed: bool


@pytest.fixture(scope="module", params=[False, True], ids=["plain", "compressed"])
def night(request, starmesh, catalogue, tmp_path_factory):
    """One frame for each type, in the order of CASES."""
    folder = tmp_path_factory.mktemp("types")
    camera = type("OfThisNight", (Camera,), {"sent": 0})
    port = free_port()
    compress = f"[archive]\ncompress = {str(request.param).lower()}\n"
    site = Site(starmesh, folder, catalogue, config=compress)
    camera.simulators = site.alpaca
    server = http.server.ThreadingHTTPServer(("127.0.0.1", port), camera)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    config = folder / "observatory.toml"
    text = config.read_text()
    before, name, after = text.partition('name = "camera_1"')
    config.write_text(before + name + after.replace(f'server = "127.0.0.1:{site.alpaca}"', f'server = "127.0.0.1:{port}"', 1))
    record = NightRecord()
    record.site, record.compressed = site, request.param
    with observing(record):
        site.put("safetymonitor/0/issafe", IsSafe="true")
        area = {"subframe_width": WIDTH, "subframe_height": HEIGHT}
        site.schedule([("calibration", {"exptime": [0], "n": [len(CASES)]} | area)], seconds=300)
        site.start_nodes()
        record.subscriber = BusSubscriber(site.endpoint)

        def complete(_) -> bool:
            stored = [payload for key, payload in record.subscriber.received if key == f"{PREFIX}/archive/stored"]
            return len({payload["frame"] for payload in stored if payload["header_complete"]}) == len(CASES)

        record.subscriber.wait_for("the headers of all frames are complete", complete, 120)
    server.shutdown()
    found = sorted((folder / "images").rglob("*.fits*"), key=lambda path: fits.getheader(path, -1)["DATE-OBS"])
    assert len(found) == len(CASES) and camera.sent == len(CASES), (found, camera.sent)
    assert [number for number, path in enumerate(found) if not is_tiled(path)] == ([STAYS_PLAIN] if record.compressed else list(range(len(CASES))))
    record.files = found
    yield record
    server.server_close()


def is_tiled(path) -> bool:
    return path.name.endswith(".fits.fz")


def same(image: np.ndarray, sent: np.ndarray) -> bool:
    flat = sent[0] if sent.shape[0] == 1 else sent
    return image.shape == flat.shape and np.array_equal(image.astype(np.longdouble), flat.astype(np.longdouble), equal_nan=True)


@pytest.mark.parametrize("number", range(len(CASES)), ids=[case[0] for case in CASES])
def test_astropy_reads_every_value_that_the_camera_sent(night, number, recwarn):
    with fits.open(night.files[number], checksum=True) as hdus:
        hdu = hdus[1 if is_tiled(night.files[number]) else 0]
        assert same(hdu.data, IMAGES[number])
        assert hdu.header["IMAGETYP"] == "Bias Frame" and "MJD-OBS" in hdu.header
    header = fits.open(night.files[number], disable_image_compression=True)[-1].header
    bitpix = header["ZBITPIX" if is_tiled(night.files[number]) else "BITPIX"]
    assert bitpix == CASES[number][5] and ("BZERO" in header) == (bitpix == 16)
    if is_tiled(night.files[number]):
        assert header["ZCMPTYPE"] == ("GZIP_2" if bitpix < 0 else "RICE_1") and {"ZHECKSUM", "ZDATASUM"} <= set(header)
    assert not [w for w in recwarn if "checksum" in str(w.message).lower() or "datasum" in str(w.message).lower()]


def test_fitsverify_finds_neither_errors_nor_warnings(night):
    verdict = subprocess.run(["fitsverify", *map(str, night.files)], capture_output=True, text=True)
    assert verdict.returncode == 0, verdict.stdout
    assert verdict.stdout.count("Verification found 0 warning(s) and 0 error(s)") == len(CASES), verdict.stdout


def test_funpack_and_our_own_copy_restore_the_same_file_with_right_sums(night, starmesh, tmp_path, recwarn):
    command = [starmesh, "fits", "convert", *map(str, night.files), "--profile", "astra", "--out", str(tmp_path)]
    made = subprocess.run(command, capture_output=True, text=True)
    assert made.returncode == 0, made.stderr
    assert shutil.which("funpack"), "funpack is missing: apt-get install libcfitsio-bin (scripts/setup does)"
    for number, path in enumerate(night.files):
        copy = tmp_path / path.name.removesuffix(".fz")
        if is_tiled(path):
            restored = tmp_path / f"{number}.restored.fits"
            subprocess.run(["funpack", "-O", str(restored), str(path)], check=True)
            assert restored.read_bytes() == copy.read_bytes(), CASES[number][0]
        else:
            assert path.read_bytes() == copy.read_bytes()
        with fits.open(copy, checksum=True) as hdus:
            assert len(hdus) == 1 and same(hdus[0].data, IMAGES[number])
            assert {"CHECKSUM", "DATASUM"} <= set(hdus[0].header) and "ZIMAGE" not in hdus[0].header
    assert not [w for w in recwarn if "checksum" in str(w.message).lower() or "datasum" in str(w.message).lower()]


@pytest.mark.parametrize("profile", ["astra", "eso"])
def test_profiles_check_and_copy_files_of_every_type(night, starmesh, tmp_path, profile):
    given = {"astra": [], "eso": ["--set", "INSTRUME=SPECULOOS1", "--set", "PROGID=112.25XK.001"]}[profile]
    command = [starmesh, "fits", "convert", *map(str, night.files), "--profile", profile, "--out", str(tmp_path), *given]
    made = subprocess.run(command, capture_output=True, text=True)
    assert made.returncode == 0, made.stderr
    copies = sorted(tmp_path.iterdir(), key=lambda path: fits.getheader(path)["DATE-OBS"])
    for number, copy in enumerate(copies):
        assert copy.suffix == ".fits" and same(fits.getdata(copy), IMAGES[number]), copy
    ours = night.files if profile == "astra" else copies
    checked = subprocess.run([starmesh, "fits", "check", *map(str, ours), "--profile", profile], capture_output=True, text=True)
    assert checked.returncode == 0, checked.stdout
    verdict = subprocess.run(["fitsverify", *map(str, copies)], capture_output=True, text=True)
    assert verdict.stdout.count("Verification found 0 warning(s) and 0 error(s)") == len(CASES), verdict.stdout


def test_measuring_reads_flat_and_colour_files(night, starmesh):
    for number in [2, 9]:
        measured = subprocess.run([starmesh, "measure", str(night.files[number])], capture_output=True, text=True)
        assert measured.returncode == 0, measured.stdout + measured.stderr
