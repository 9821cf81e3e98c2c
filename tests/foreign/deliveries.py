"""What the tests of deliveries share: a night of the demo, sites that hand it over, and destinations."""

import contextlib
import hashlib
import http.client
import http.server
import json
import os
import pathlib
import re
import shutil
import signal
import sqlite3
import subprocess
import sys
import threading
import time

import boto3
import pytest
from astropy.io import fits
from ports import free_port
from shared import PROJECT

DOCUMENT = PROJECT / "docs/operator/delivery.md"
VENV = pathlib.Path(sys.executable).parent
SECRET = "a-secret-that-nobody-may-read"


def blocks(kind: str) -> list[str]:
    return re.findall(rf"^```{kind}\n(.*?)^```$", DOCUMENT.read_text(), flags=re.M | re.S)


def block(kind: str, word: str) -> str:
    found = [text for text in blocks(kind) if word in text]
    assert found, f"delivery.md has no block of {kind} with {word}"
    return found[0]


@contextlib.contextmanager
def opened(database: pathlib.Path):
    """A connection that is closed at the end, which `with` of sqlite3 alone does not do; what was changed is kept."""
    with contextlib.closing(sqlite3.connect(database)) as connection, connection:
        yield connection


class Site:
    """A copy of the night's folder, whose configuration is extended as the document says."""

    def __init__(self, starmesh: str, night: pathlib.Path, folder: pathlib.Path):
        self.starmesh, self.folder = starmesh, folder
        for name in ("observatory.toml", "schedule.jsonl"):
            shutil.copy(night / name, folder / name)
        shutil.copytree(night / "data", folder / "data", ignore=shutil.ignore_patterns("spool-*"))
        self.images = night / "images"
        self.add(f'[folders]\nimages = "{self.images}"\n')
        self.read_frames()

    def read_frames(self):
        with opened(self.folder / "data/archive.db") as database:
            self.frames = dict(database.execute("SELECT file, frame_id FROM images"))

    def own_images(self):
        """From now on it has files of its own, of which no header counts as complete, as after a night without telemetry."""
        images = self.folder / "images"
        shutil.copytree(self.images, images)
        toml = self.folder / "observatory.toml"
        toml.write_text(toml.read_text().replace(str(self.images), str(images)))
        with opened(self.folder / "data/archive.db") as database:
            database.execute("UPDATE images SET complete_hdr = 0")
        self.images = images

    def add(self, text: str):
        with open(self.folder / "observatory.toml", "a") as file:
            file.write("\n" + text)

    def run(self, *words: str, **options) -> subprocess.CompletedProcess:
        environment = os.environ | options.pop("env", {})
        return subprocess.run([self.starmesh, *words], cwd=self.folder, capture_output=True, text=True, timeout=180,
                              env=environment, **options)

    def type(self, text: str):
        """Types lines of the document; each must succeed."""
        for line in text.splitlines():
            done = subprocess.run(line.replace("starmesh ", f"{self.starmesh} ", 1) if line.startswith("starmesh ") else line,
                                  shell=True, cwd=self.folder, capture_output=True, text=True, timeout=180)
            assert done.returncode == 0, f"{line}\n{done.stdout}\n{done.stderr}"

    def deliver(self, name: str) -> subprocess.CompletedProcess:
        return self.run("night", "deliver", "last", "--to", name)


@pytest.fixture(scope="module")
def night(starmesh, tmp_path_factory) -> pathlib.Path:
    folder = tmp_path_factory.mktemp("demo") / "night"
    subprocess.run([starmesh, "demo", "--speed", "600", "--size-px", "256", "--port", str(free_port()), "--keep", str(folder)],
                   capture_output=True, timeout=400, check=False)
    with opened(folder / "data/archive.db") as database:
        frames, complete = database.execute("SELECT count(*), total(complete_hdr) FROM images").fetchone()
    assert frames > 20 and complete == frames, f"{complete} of {frames} headers are complete"
    return folder


@pytest.fixture
def site(starmesh, night, tmp_path) -> Site:
    folder = tmp_path / "site"
    folder.mkdir()
    return Site(starmesh, night, folder)


@contextlib.contextmanager
def tmpfs(folder: pathlib.Path, options: str):
    """A file system of its own; mounting needs root, as in the tests of networks."""
    folder.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(folder)], check=True)
    try:
        yield folder
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)


@contextlib.contextmanager
def process(*words: str, **options):
    options = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL} | options
    child = subprocess.Popen(words, start_new_session=True, **options)
    try:
        yield child
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(child.pid, signal.SIGKILL)
        child.wait()


def until(condition, seconds: float = 60.0, every_s: float = 0.1):
    end = time.monotonic() + seconds
    while not (found := condition()):
        assert time.monotonic() < end, f"not within {seconds} s"
        time.sleep(every_s)
    return found


def answers(port: int) -> bool:
    try:
        connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
        connection.request("GET", "/")
        return connection.getresponse().status > 0
    except OSError:
        return False


class Store:
    """moto, and a proxy before it that can be slow, lie, and forget."""

    def __init__(self, server: int):
        self.server, self.mode = server, "honest"
        store = self

        class Proxy(http.server.BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def forward(self):
                body = self.rfile.read(int(self.headers.get("Content-Length") or 0))
                if self.command == "PUT" and self.path.endswith((".fits", ".parquet")):
                    if store.mode == "slow":
                        time.sleep(0.02)
                    elif store.mode == "lies":
                        body = body[:5000] + bytes([body[5000] ^ 1]) + body[5001:]
                    elif store.mode == "forgets":
                        return self.answer(200, [("ETag", '"0123"')], b"")
                connection = http.client.HTTPConnection("127.0.0.1", store.server, timeout=60)
                connection.request(self.command, self.path, body, dict(self.headers))
                answer = connection.getresponse()
                self.answer(answer.status, answer.getheaders(), answer.read())

            def answer(self, status, headers, body):
                self.send_response_only(status)
                for name, value in headers:
                    if name.lower() not in ("transfer-encoding", "content-length", "connection"):
                        self.send_header(name, value)
                self.send_header("Content-Length", str(len(body)))
                self.end_headers()
                if self.command != "HEAD":
                    self.wfile.write(body)

            do_GET = do_PUT = do_HEAD = do_POST = do_DELETE = forward

            def log_message(self, *_):
                pass

        self.proxy = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Proxy)
        threading.Thread(target=self.proxy.serve_forever, daemon=True).start()

    def client(self):
        """A client that we did not write."""
        return boto3.client("s3", endpoint_url=f"http://127.0.0.1:{self.server}", region_name="us-east-1",
                            aws_access_key_id="reader", aws_secret_access_key="reader")

    def count(self) -> int:
        return self.client().list_objects_v2(Bucket="nights").get("KeyCount", 0)

    def objects(self, bucket: str = "nights") -> dict[str, bytes]:
        client = self.client()
        listed = client.list_objects_v2(Bucket=bucket).get("Contents", [])
        return {entry["Key"]: client.get_object(Bucket=bucket, Key=entry["Key"])["Body"].read() for entry in listed}


@pytest.fixture
def store():
    port = free_port()
    with process(str(VENV / "moto_server"), "-H", "127.0.0.1", "-p", str(port)):
        until(lambda: answers(port))
        store = Store(port)
        store.client().create_bucket(Bucket="nights")
        yield store
        store.proxy.shutdown()


def add_store(site: Site, store: Store):
    site.add(block("toml", "bucket").replace("https://s3.example.org", f"http://127.0.0.1:{store.proxy.server_port}"))
    (site.folder / "store.secret").write_text(SECRET + "\n")


def files(folder: pathlib.Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def is_whole(site: Site, held: dict[str, bytes]):
    """Every frame is there exactly once, as the archive has it, with one manifest that lists it."""
    manifests = [name for name in held if name.endswith(".json")]
    assert len(manifests) == 1, held.keys()
    manifest = json.loads(held[manifests[0]])
    prefix = f"{manifest['site']}/{manifest['telescope']}/"
    assert set(held) == {prefix + file for file in site.frames} | set(manifests)
    assert {file["name"]: file["frame_id"] for file in manifest["files"]} == {prefix + f: i for f, i in site.frames.items()}
    for file in manifest["files"]:
        content = held[file["name"]]
        assert hashlib.sha256(content).hexdigest() == file["sha256"] and len(content) == file["bytes"]
        assert content == (site.images / file["name"].removeprefix(prefix)).read_bytes()


def frames_below(folder: pathlib.Path) -> int:
    """Unlike `rglob`, this does not mind a folder that goes away meanwhile."""
    return sum(".fits" in name for _, _, names in os.walk(folder) for name in names)


def manifests_below(folder: pathlib.Path) -> list[str]:
    return [name for _, _, names in os.walk(folder) for name in names if name.endswith(".json")]


def add_copies(site: Site, there: pathlib.Path):
    there.mkdir(exist_ok=True)
    site.add(block("toml", 'profile = "lco"').replace("/mnt/lco", str(there)))


def are_whole_copies(site: Site, there: pathlib.Path, programme: str = "DEMO.2026"):
    """Every frame is there exactly once as a copy of profile lco, and the manifest leads from it to the archive's file."""
    held = {name: content for name, content in files(there).items() if ".starmesh-part" not in name}
    (name,) = [name for name in held if name.endswith(".json")]
    manifest = json.loads(held[name])
    assert manifest["profile"] == "lco" and set(held) == {file["name"] for file in manifest["files"]} | {name}
    assert {file["archive_file"]: file["frame_id"] for file in manifest["files"]} == site.frames
    for file in manifest["files"]:
        assert hashlib.sha256(held[file["name"]]).hexdigest() == file["sha256"]
        assert hashlib.sha256((site.images / file["archive_file"]).read_bytes()).hexdigest() == file["archive_sha256"]
        with fits.open(there / file["name"], checksum=True) as copy:
            assert copy[0].header["FRAMEID"] == file["frame_id"] and copy[0].header["PROPID"] == programme
    done = site.run("fits", "check", "--profile", "lco", *[str(there / file["name"]) for file in manifest["files"]])
    assert done.returncode == 0, done.stdout
    is_clean(site)


def is_clean(site: Site):
    """The database is whole, and no copy of a killed try is left in the data folder."""
    with opened(site.folder / "data/archive.db") as database:
        assert database.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
        assert database.execute("SELECT count(*), total(complete_hdr) FROM images").fetchone() == (len(site.frames),) * 2
    left = [path for path in (site.folder / "data").glob("delivery-*/**/send-*")]
    assert not left, left
