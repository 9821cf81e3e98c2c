"""Nights of imported sites, in a network namespace of their own: `imported_site.py twins|template STARMESH OLD FOLDER`.

There the addresses that the old files name are free and multicast meets nobody else, so nothing is edited. Standard library only;
what happened is printed as one JSON object.
"""

import datetime
import json
import math
import os
import pathlib
import signal
import subprocess
import sys
import time
import urllib.parse
import urllib.request

PORTS = {"twins": [11111, 11112], "template": [11111]}
LATITUDE_DEG, ELEVATION_M = -24.6, 2500.0


def get(port: int, path: str):
    with urllib.request.urlopen(f"http://127.0.0.1:{port}/{path}", timeout=5) as answer:
        return json.load(answer)


def device(port: int, path: str):
    return get(port, f"api/v1/{path}?ClientID=9&ClientTransactionID=1")["Value"]


def connect(port: int, kind: str):
    """As the predecessor leaves its devices: connected."""
    form = urllib.parse.urlencode({"Connected": "true", "ClientID": 9, "ClientTransactionID": 1}).encode()
    request = urllib.request.Request(f"http://127.0.0.1:{port}/api/v1/{kind}/0/connected", data=form, method="PUT")
    assert json.load(urllib.request.urlopen(request, timeout=5))["ErrorNumber"] == 0


def change(port: int, thing: str, **values):
    request = urllib.request.Request(f"http://127.0.0.1:{port}/simulator/v1/world/{thing}", data=json.dumps(values).encode(),
                                     method="PUT", headers={"Content-Type": "application/json"})
    urllib.request.urlopen(request, timeout=5).close()


def wait(what: str, holds, limit_s: float):
    until = time.monotonic() + limit_s
    while not holds():
        if time.monotonic() > until:
            raise SystemExit(f"{what}: not within {limit_s} s")
        time.sleep(0.2)


def sun_place(at: datetime.datetime) -> tuple[float, float]:
    """Declination and right ascension of the Sun, deg, to 0.02 deg (Astronomical Almanac, page C5)."""
    days = at.timestamp() / 86400 - 10957.5
    mean, anomaly = 280.460 + 0.9856474 * days, math.radians(357.528 + 0.9856003 * days)
    longitude = math.radians(mean + 1.915 * math.sin(anomaly) + 0.020 * math.sin(2 * anomaly))
    tilt = math.radians(23.439 - 4e-7 * days)
    ra = math.atan2(math.cos(tilt) * math.sin(longitude), math.cos(longitude))
    return math.degrees(math.asin(math.sin(tilt) * math.sin(longitude))), math.degrees(ra)


def sidereal_deg(at: datetime.datetime, longitude_deg: float) -> float:
    return (280.46062 + 360.98564737 * (at.timestamp() / 86400 - 10957.5) + longitude_deg) % 360


def dusk_longitude(at: datetime.datetime, sun_altitude_deg: float) -> float:
    """Where on this latitude the Sun sets through this altitude now."""
    dec, ra = map(math.radians, sun_place(at))
    latitude, altitude = math.radians(LATITUDE_DEG), math.radians(sun_altitude_deg)
    cosine = (math.sin(altitude) - math.sin(latitude) * math.sin(dec)) / (math.cos(latitude) * math.cos(dec))
    west = math.degrees(math.acos(cosine))  # hour angle, positive towards the west: the Sun sets
    return (math.degrees(ra) + west - sidereal_deg(at, 0.0) + 180) % 360 - 180


class Scenario:
    """Processes of one site, each ended at the end."""

    def __init__(self, starmesh: str, folder: pathlib.Path):
        self.starmesh, self.folder = starmesh, folder
        self.simulators: list[subprocess.Popen] = []
        # the shutter on its way, or closed, over mounts that were not parked
        self.met: list[dict] = []
        self.ups: list[subprocess.Popen] = []

    def spawn(self, name: str, *words: str) -> subprocess.Popen:
        with open(self.folder / f"{name}.log", "w") as log:
            return subprocess.Popen([self.starmesh, *words], stdin=subprocess.DEVNULL, stdout=log, stderr=log)

    def simulate(self, port: int, *words: str):
        self.simulators.append(self.spawn(f"simulator-{port}", "simulator", "--bind", f"127.0.0.1:{port}", *words))

        def answers():
            try:
                return device(port, "telescope/0/connected") is not None
            except OSError:
                return False
        wait("the simulator answers", answers, 30)

    def run_starmesh(self, *words: str) -> str:
        done = subprocess.run([self.starmesh, *words], capture_output=True, text=True, timeout=60)
        if done.returncode != 0:
            raise SystemExit(f"{' '.join(words)}: {done.stdout}{done.stderr}")
        return done.stdout

    def begin(self, *telescopes: str):
        """Turns the robotic switches on, as soon as the telescopes are on the bus."""
        def are_there():
            done = subprocess.run([self.starmesh, "status"], capture_output=True, text=True, timeout=60)
            return all(telescope in done.stdout for telescope in telescopes)
        wait("the telescopes are on the bus", are_there, 60)
        for telescope in telescopes:
            self.run_starmesh("order", telescope, "start")

    def up(self, telescope: str, file: pathlib.Path):
        self.ups.append(self.spawn(f"up-{telescope}", "up", str(file)))

    def fits(self) -> int:
        return len(list(self.folder.rglob("images/**/*.fits")))

    def posture(self, ports: list[int]) -> dict:
        """The shutter of the first simulator, and whether each mount is parked."""
        return {"shutter": device(ports[0], "dome/0/shutterstatus"), "parked": [device(port, "telescope/0/atpark") for port in ports]}

    def wait_for_the_end(self, frames: int, ports: list[int]):
        """Until so many frames are on disk, and everything is closed and parked."""
        closed = {"shutter": 1, "parked": [True] * len(ports)}

        def ended() -> bool:
            posture = self.posture(ports)
            # asked before the mounts are, so a shutter that moves over a mount on its way is seen
            if posture["shutter"] in (1, 3) and posture != closed | {"shutter": posture["shutter"]}:
                self.met.append(posture)
            return self.fits() >= frames and posture == closed
        wait("closed and parked after the schedule", ended, 150)

    def end(self) -> list[int]:
        codes = []
        for process in self.ups:
            process.send_signal(signal.SIGINT)
        for process in self.ups:
            codes.append(process.wait(timeout=60))
        return codes

    def kill(self):
        for process in self.ups + self.simulators:
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
        for process in self.ups + self.simulators:
            try:
                process.wait(timeout=20)
            except subprocess.TimeoutExpired:
                process.kill()


def rows(folder: pathlib.Path, name: str, start: datetime.datetime, length_s: float, rows: list[tuple[str, str, dict]]):
    """A schedule as the predecessor writes it."""
    end = (start + datetime.timedelta(seconds=length_s)).strftime("%Y-%m-%d %H:%M:%S")
    lines = ["// one short night"]
    for index, (camera, action, value) in enumerate(rows):
        begin = (start + datetime.timedelta(milliseconds=10 * index)).strftime("%Y-%m-%d %H:%M:%S.%f")
        lines.append(json.dumps({"device_name": camera, "action_type": action, "action_value": value, "start_time": begin,
                                 "end_time": end, "completed": False, "status": "pending"}))
    file = folder / "schedules" / f"{name}.jsonl"
    file.parent.mkdir(exist_ok=True)
    file.write_text("\n".join(lines) + "\n")


def twins(scenario: Scenario, old: pathlib.Path) -> dict:
    """Two telescopes under one roof at dusk, in real time: both simulators stand where the devices are."""
    now = datetime.datetime.now(datetime.timezone.utc)
    longitude = dusk_longitude(now, -4.5)
    for port in PORTS["twins"]:
        scenario.simulate(port, "--start", now.isoformat().replace("+00:00", "Z"), "--latitude-deg", str(LATITUDE_DEG), "--longitude-deg",
                          f"{longitude:.4f}", "--size-px", "256", "--roof", "--shutter-s", "2", "--slew-deg-per-s", "60")
        for kind in ["telescope", "observingconditions"]:
            connect(port, kind)
    field = {"ra": (sidereal_deg(now, longitude) - 20) % 360, "dec": -30.0, "exptime": 1.0, "n": 2, "filter": "V"}
    rows(old, "twins", now, 900, [
        ("north_cam", "open", {}),
        ("north_cam", "object", field | {"object": "North Field", "metadata": {"ID": 4711}}),
        ("north_cam", "flats", {"filter": ["V"], "n": [2]}),
        ("north_cam", "calibration", {"exptime": [0, 0.5], "n": [2, 1]}),
        ("north_cam", "close", {}),
        ("south_cam", "object", field | {"object": "South Field", "guidng": True, "metadata": {"ID": 4712}}),
        ("south_cam", "calibration", {"exptime": [0], "n": [2]}),
        ("south_cam", "complete_headers", {}),
        ("south_cam", "close", {}),
    ])
    printed = scenario.run_starmesh("import-astra", str(old), "--out", str(scenario.folder / "new"))
    files = {name: scenario.folder / "new" / name / "observatory.toml" for name in ["north-mount", "south-mount", "shared"]}
    for name, file in files.items():
        scenario.run_starmesh("check", str(file))
        scenario.up(name, file)
    scenario.begin("twins/north-mount", "twins/south-mount")
    wait("the roof opens", lambda: device(11111, "dome/0/shutterstatus") == 0, 60)
    scenario.wait_for_the_end(11, PORTS["twins"])
    return {"printed": printed, "status": scenario.run_starmesh("status"), "codes": scenario.end(), "met": scenario.met,
            **scenario.posture(PORTS["twins"])}


def template(scenario: Scenario, old: pathlib.Path) -> dict:
    """The predecessor's own template on a simulator whose sky goes fast: its limits want up to five hours of fair weather."""
    start = datetime.datetime(2026, 11, 21, 18, 0, tzinfo=datetime.timezone.utc)  # before noon at longitude -70
    port = PORTS["template"][0]
    scenario.simulate(port, "--start", start.isoformat().replace("+00:00", "Z"), "--speed", "600", "--size-px", "256",
                      "--shutter-s", "30")
    for kind in ["telescope", "observingconditions"]:
        connect(port, kind)
    # the template asks for a colder sky than the simulator's
    change(port, "weather", SkyTemperature=-45.0)
    name, camera = "template", "camera_template"
    dusk = datetime.datetime(2026, 11, 22, 0, 30, tzinfo=datetime.timezone.utc)
    field = {"ra": (sidereal_deg(dusk, -70.4) + 30) % 360, "dec": -30.0, "exptime": 60.0, "n": 3, "filter": "V", "object": "A Field"}
    rows(old, name, start, 14 * 3600, [
        (camera, "open", {}),
        (camera, "object", field | {"metadata": {"ID": 17}}),
        (camera, "calibration", {"exptime": [0, 10], "n": [2, 2]}),
        (camera, "complete_headers", {}),
        (camera, "close", {}),
    ])
    printed = scenario.run_starmesh("import-astra", str(old), "--out", str(scenario.folder / "new"), "--simulator", f"127.0.0.1:{port}")
    file = scenario.folder / "new" / "observatory.toml"
    checked = scenario.run_starmesh("check", str(file))
    scenario.up("template", file)
    scenario.begin("template/telescope-template")
    wait("the dome opens", lambda: device(port, "dome/0/shutterstatus") == 0, 120)
    scenario.wait_for_the_end(7, [port])
    return {"printed": printed, "checked": checked, "status": scenario.run_starmesh("status"), "codes": scenario.end(),
            "met": scenario.met, **scenario.posture([port])}


def main(name: str, starmesh: str, old: str, folder: str):
    for words in ["link set lo up", "link set lo multicast on", "route add 224.0.0.0/4 dev lo"]:
        subprocess.run(["ip", *words.split()], check=True)
    # the home folder's own files of the predecessor are none of this
    os.environ["HOME"] = folder
    scenario = Scenario(starmesh, pathlib.Path(folder))
    try:
        print(json.dumps({"twins": twins, "template": template}[name](scenario, pathlib.Path(old))))
    finally:
        scenario.kill()


if __name__ == "__main__":
    main(*sys.argv[1:])
