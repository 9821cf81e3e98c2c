"""The one night that decides: simulator and all nodes as the processes that a user starts, from a user's files, with one shower.

It waits for states, and a slow machine only makes it longer. The shower and the night end when the test says so. How other nights fare is
measured by `scripts/proof`.
"""

import contextlib
import json
import os
import pathlib
import re
import signal
import sqlite3
import subprocess
import sys
import time
import urllib.parse
import urllib.request
import warnings

from astropy.io import fits
from astropy.time import Time

# only a hang takes so long
CEILING_S = 300.0
FRAMES_BEFORE, FRAMES_AFTER, SIDE_PX, EXPOSURE_S = 4, 8, 256, 10.0
# from half an hour after nautical dusk until dawn: 47 minutes at this speed, longer than all that is waited for together
START, END, SPEED = "2026-11-22 00:40:00", "2026-11-22 08:30:00", 10

# every device of an observatory; the age of a permit is as long as it may be
CONFIG = """
[observatory]
site = "paranal"
telescope = "alpha"
latitude_deg = -24.6272
longitude_deg = -70.4042
elevation_m = 2635

[bus]
multicast = false

[clock]
simulator = "http://{server}"

[schedule]
robotic = true

[web]
listen = "127.0.0.1:0"
"""
DEVICES = {
    "telescope": "",
    "camera": "temperature_c = -10.0",
    "filterwheel": "",
    "focuser": "",
    "dome": "permit_valid_s = 30.0",
    "safetymonitor": "dwell_min = 0.5",
    "observingconditions": 'limit = [{ parameter = "RainRate", upper = 0.0, dwell_min = 0.5 }]',
    "covercalibrator": "",
    "switch": "",
    "rotator": "",
}
# more frames than the night has time for: the row is under way when the shower begins, and when it ends
ROWS = [("open", {}), ("object", {"object": "Field", "ra": 45.0, "dec": -50.0, "exptime": EXPOSURE_S, "n": 1000, "filter": "V"})]


def test_a_night_with_a_shower_ends_closed_with_every_frame_in_one_whole_file(starmesh, tmp_path):
    with Night(starmesh, tmp_path) as night:
        night.begin()
        night.wait("the page and all its scripts load", lambda: night.page() and len(scripts_of(night.page())) > 5)
        night.wait("the dome is open", lambda: night.dome_open() == 1.0)
        night.wait("frames are stored", lambda: len(night.files()) >= FRAMES_BEFORE)

        night.wait("it rains", lambda: night.rain(True))
        night.wait("the dome is closed, by the rain", lambda: night.dome_open() == 0.0 and night.is_unsafe_by("RainRate"))
        before = len(night.files())
        night.wait("it is dry", lambda: night.rain(False))
        night.wait("the dome is open after the shower", lambda: night.dome_open() == 1.0)
        # one frame may have been under way when the dome closed
        night.wait("frames are stored after the shower", lambda: len(night.files()) > before + FRAMES_AFTER)
        night.wait("the heartbeat answers", lambda: night.ask("api/heartbeat")["data"]["weather_safe"])

        # an observatory node that answers later than 3 s is asked again, as by a person
        night.wait("an order closes", lambda: night.order("close") == ("done", "verified closed"))
        assert night.dome_open() == 0.0
        night.wait("every header is complete", lambda: night.headers_missing() == 0)
        assert night.stop() == 0, night.logs()
        assert night.dome_open() == 0.0
    every_file_is_whole_and_each_exposure_is_in_one(night)


def scripts_of(page: str) -> set[str]:
    """The scripts that the page and its scripts name, each of which was fetched."""
    _, html, _ = fetched(page)
    wanted, seen = [urllib.parse.urljoin(page, script) for script in re.findall(r'<script[^>]+src="([^"]+)"', html)], set()
    while wanted:
        url = wanted.pop()
        if url in seen:
            continue
        status, text, kind = fetched(url)
        assert status == 200 and "javascript" in kind and text, (url, status, kind)
        seen.add(url)
        wanted += [urllib.parse.urljoin(url, name) for name in re.findall(r'^import .*from "([^"]+)"', text, re.M)]
    return seen


def every_file_is_whole_and_each_exposure_is_in_one(night: "Night"):
    ids = []
    for path in night.files():
        with warnings.catch_warnings():
            # a sum that is wrong is a warning of astropy
            warnings.simplefilter("error")
            with fits.open(path, checksum=True, memmap=False) as hdus:
                hdus.verify("exception")
                header, pixels = hdus[0].header.copy(), hdus[0].data
                assert len(hdus) == 1, path
        assert header["NAXIS"] == 2 and pixels.shape == (SIDE_PX, SIDE_PX), (path, header["NAXIS"], pixels.shape)
        assert pixels.min() < pixels.max(), path
        assert {"CHECKSUM", "DATASUM"} <= set(header), path
        assert (header["IMAGETYP"], header["OBJECT"], header["EXPTIME"]) == ("Light Frame", "Field", EXPOSURE_S), path
        assert Time(START) < Time(header["DATE-OBS"], scale="utc") < Time(END), path
        ids.append(header["FRAMEID"])
    assert len(ids) >= FRAMES_BEFORE + FRAMES_AFTER and sorted(ids) == sorted(set(ids)) == night.stored(), ids


def fetched(url: str, method: str = "GET", body: dict | None = None, **headers: str) -> tuple[int, str, str]:
    """Status, text and type of what a server of this host answers."""
    opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
    data = None if body is None else json.dumps(body).encode()
    headers = {name.replace("_", "-"): value for name, value in headers.items()} | ({"Content-Type": "application/json"} if data else {})
    with opener.open(urllib.request.Request(url, data, headers, method=method), timeout=CEILING_S) as answer:
        return answer.status, answer.read().decode(), answer.headers.get("Content-Type", "")


class Night:
    """A folder with a user's files, the simulator, and `starmesh up`."""

    def __init__(self, starmesh: str, folder: pathlib.Path):
        self.starmesh, self.folder = starmesh, folder
        self.processes: list[subprocess.Popen] = []

    def __enter__(self):
        # What it starts has sessions of its own, and would outlive a test command that somebody ends.
        signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
        return self

    def begin(self):
        self.start("simulator", "simulator", "--bind", "127.0.0.1:0", "--start", f"{START.replace(' ', 'T')}Z", "--speed", str(SPEED),
                   "--size-px", str(SIDE_PX), "--pixel-um", "108", "--optics-fwhm-arcsec", "60", "--shutter-s", "20")
        self.wait("the simulator answers", lambda: self.said("simulator", r"simulated observatory at http://([\d.:]+)/"))
        self.server = self.said("simulator", r"simulated observatory at http://([\d.:]+)/")
        blocks = [f'[[{kind}]]\nname = "{kind}"\nserver = "{self.server}"\n{more}\n' for kind, more in DEVICES.items()]
        (self.folder / "observatory.toml").write_text("\n".join([CONFIG.format(server=self.server), *blocks]))
        lines = [json.dumps({"device_name": "camera", "action_type": action, "action_value": value, "start_time": START, "end_time": END})
                 for action, value in ROWS]
        (self.folder / "schedule.jsonl").write_text("\n".join(lines) + "\n")
        self.up = self.start("up", "up", str(self.folder / "observatory.toml"))

    def __exit__(self, *_):
        for process in reversed(self.processes):
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
                with contextlib.suppress(subprocess.TimeoutExpired):
                    process.wait(timeout=CEILING_S)
            # a device node outlives an `up` that was killed: it is of the same session
            for left in processes_of(process.pid):
                with contextlib.suppress(ProcessLookupError):
                    os.kill(left, signal.SIGKILL)
            process.wait()

    def start(self, name: str, *words: str) -> subprocess.Popen:
        with open(self.folder / f"{name}.log", "w") as log:
            self.processes.append(subprocess.Popen([self.starmesh, *words], cwd=self.folder, stdin=subprocess.DEVNULL, stdout=log, stderr=log,
                                                   start_new_session=True))
        return self.processes[-1]

    def stop(self) -> int:
        """Ctrl-C; the exit code of `starmesh up`."""
        self.up.send_signal(signal.SIGINT)
        return self.up.wait(timeout=2 * CEILING_S)

    def said(self, name: str, pattern: str) -> str:
        """The words in the output of a process that a pattern has in brackets; nothing where it was not said yet."""
        found = re.findall(pattern, (self.folder / f"{name}.log").read_text(errors="replace"))
        return found[-1] if found else ""

    def page(self) -> str:
        return self.said("up", r"page: (http://[\d.:]+/)")

    def dome_open(self) -> float:
        """The truth: 0 is closed, 1 is open."""
        return json.loads(fetched(f"http://{self.server}/simulator/v1/world")[1])["dome"]["open"]

    def rain(self, on: bool) -> bool:
        return fetched(f"http://{self.server}/simulator/v1/world/rain", "PUT", {"on": on})[0] == 200

    def ask(self, path: str) -> dict:
        """What the page's server answers."""
        return json.loads(fetched(self.page() + path)[1])

    def is_unsafe_by(self, word: str) -> bool:
        """Does the verdict name it as a reason?"""
        verdict = self.ask("api/v1/telescopes/paranal/alpha/safety")["body"]
        return verdict["verdict"] == "unsafe" and word in json.dumps(verdict["reasons"])

    def order(self, command: str) -> tuple[str, str]:
        """Gives an order at the page, and returns how it ended."""
        body = {"command": command, "reason": "the end of the night", "operator": "ana"}
        url = f"{self.page()}api/v1/telescopes/paranal/alpha/commands"
        given = json.loads(fetched(url, "POST", body, Idempotency_Key=str(time.time_ns()))[1])
        while given["state"] in ("sent", "accepted"):
            time.sleep(0.1)
            given = self.ask(f"api/v1/commands/{given['id']}")
        return given["state"], given.get("detail", "")

    def images(self, what: str) -> list[tuple]:
        """What the archive's database has of the frames."""
        with contextlib.closing(sqlite3.connect(f"file:{self.folder}/data/archive.db?mode=ro", uri=True, timeout=CEILING_S)) as database:
            return database.execute(f"SELECT {what} FROM images").fetchall()

    def headers_missing(self) -> int:
        return sum(not complete for complete, in self.images("complete_hdr"))

    def stored(self) -> list[str]:
        return sorted(name for name, in self.images("frame_id"))

    def files(self) -> list[pathlib.Path]:
        return sorted((self.folder / "images").rglob("*.fits"))

    def wait(self, what: str, holds):
        until = time.monotonic() + CEILING_S
        while True:
            # a server that has not begun refuses, and a state that nobody has published is no answer
            with contextlib.suppress(OSError, KeyError, TypeError):
                if holds():
                    return
            ended = [process.args[1] for process in self.processes if process.poll() is not None]
            assert not ended and time.monotonic() < until, f"{what}: not within {CEILING_S:.0f} s; ended: {ended}\n{self.logs()}"
            time.sleep(0.1)

    def logs(self) -> str:
        return "\n".join(f"--- {path.name}\n{path.read_text(errors='replace')[-6000:]}" for path in sorted(self.folder.glob("*.log")))


def processes_of(session: int) -> list[int]:
    """The processes of a session."""
    found = []
    for entry in pathlib.Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            if os.getsid(int(entry.name)) == session:
                found.append(int(entry.name))
    return found
