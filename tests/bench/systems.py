"""Starmesh and its predecessor, each started on PyPI simulators of its own, which note when each PUT arrives.

Standard library only; `systems.py serve PORT FOLDER` is the simulators, run by the virtual environment's Python.
"""

import contextlib
import datetime
import json
import os
import pathlib
import random
import re
import signal
import sqlite3
import subprocess
import sys
import tempfile
import time
import urllib.parse
import urllib.request

from loopback import fetch, free_port, wait

PROJECT = pathlib.Path(__file__).resolve().parents[2]
BINARY = pathlib.Path(os.environ.get("STARMESH_BIN", PROJECT / "target" / "release" / "starmesh")).resolve()
VENV = pathlib.Path(os.environ.get("STARMESH_BENCH_VENV", PROJECT / "target" / "bench-venv")).resolve()
KINDS = ["telescope", "focuser", "camera", "dome", "filterwheel", "observingconditions", "safetymonitor"]
LONGITUDE_DEG = 8.0  # of the simulators' site
# 30 degrees east of the meridian now, by the days since J2000: high for hours, and no meridian flip
TARGET_RA_DEG = (280.46062 + 360.98564737 * (time.time() / 86400 - 10957.5) + LONGITUDE_DEG + 30.0) % 360
TARGET_DEC_DEG = 50.0
DWELL_MIN = 0.1  # safe again after so long, for both
LIMITS = {"Humidity": 70.0, "RainRate": 0.1, "WindSpeed": 10.0}  # unsafe above, for both

PERIODIC = ["telescope", "dome", "observingconditions"]  # the safety monitor's period is 1 s in both by default
ERROR_TREE_S = 40.0  # it waits for 30 s, closes, and ends its watchdog
RAIN_ROW = "RAINRATE,float,false,ObservingConditions,RainRate,[mm/h] Rain rate\n"  # it polls what its header table names


def serve(port: str, folder: str):
    """The simulators, with the arrival time of every PUT in a file; runs in the virtual environment."""
    os.environ["ASTRA_SIMULATORS_CONFIG"] = f"{folder}/simulators.yaml"
    import uvicorn
    from alpaca_simulators.main import app
    arrivals = open(f"{folder}/arrivals.log", "a", buffering=1)

    async def stamped(scope, receive, send):
        if scope["type"] == "http" and scope["method"] == "PUT":
            arrivals.write(f"{time.time():.4f} {scope['path']}\n")
        await app(scope, receive, send)

    uvicorn.run(stamped, host="127.0.0.1", port=int(port), timeout_keep_alive=300, log_level="warning")


def install():
    """The virtual environment with the predecessor and the simulators, if it is missing."""
    if (VENV / "bin" / "astra").exists():
        return
    print(f"installing the predecessor and the simulators into {VENV} ...", file=sys.stderr, flush=True)
    subprocess.run([sys.executable, "-m", "venv", str(VENV)], check=True)
    subprocess.run([str(VENV / "bin" / "pip"), "install", "-q", "astra==1.2.0", "alpaca-simulators==1.3.2"], check=True)


def packaged(path: str) -> str:
    """A text file of a package in the virtual environment."""
    return next(VENV.glob(f"lib/python3*/site-packages/{path}")).read_text()


def write_catalogue(folder: pathlib.Path):
    """Stars around the target, for the sky of the simulated camera."""
    chance = random.Random(5)
    with contextlib.closing(sqlite3.connect(folder / "stars.db")) as database, database:
        database.execute("CREATE TABLE gaia_sources (ra REAL, dec REAL, pmra REAL, pmdec REAL, phot_g_mean_mag REAL)")
        database.executemany("INSERT INTO gaia_sources VALUES (?, ?, 0, 0, ?)", [
            ((TARGET_RA_DEG + chance.uniform(-0.35, 0.35)) % 360, TARGET_DEC_DEG + chance.uniform(-0.25, 0.25),
             chance.uniform(11.0, 17.0)) for _ in range(1600)])


def session(leader: int) -> list[int]:
    """Processes of a session."""
    found = []
    for entry in pathlib.Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            if int((entry / "stat").read_text().rsplit(")", 1)[1].split()[3]) == leader:
                found.append(int(entry.name))
    return found


def end(process: subprocess.Popen):
    """Asks a process to end; what is left of its session after a minute, or after an interrupt, is killed."""
    try:
        process.send_signal(signal.SIGINT)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(timeout=60)
    finally:
        kill(process)


def kill(process: subprocess.Popen):
    """Ends a process and all of its session at once."""
    for _ in range(2):  # what was being started meanwhile too
        for pid in session(process.pid):
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        process.wait()


class Site:
    """The simulators and one of the programs, each in a session of its own; what they share is in `folder`."""

    exposures: dict = {}
    period_s: float | None = None  # of mount, dome and weather; None: each program's defaults
    ending = staticmethod(end)

    def __init__(self, program, folder: pathlib.Path, ends: contextlib.ExitStack):
        self.program, self.ends, self.shared = program, ends, folder
        self.folder = pathlib.Path(tempfile.mkdtemp(prefix=f"{program.__name__}-", dir=folder))
        # where the program writes; the predecessor in one home for all its starts, caches included
        self.home = folder / "home"
        self.disk = self.home if program is predecessor else self.folder
        self.alpaca, self.port = free_port(), free_port()

    def server(self, kind: str) -> str:
        """Where the program finds its devices of a kind."""
        return f"127.0.0.1:{self.alpaca}"

    def start(self):
        self.start_simulators()
        self.program(self)

    def start_simulators(self):
        text = packaged("alpaca_simulators/config/template.yaml")
        (self.folder / "simulators.yaml").write_text(text.replace("tap_source: null", f"tap_source: {self.shared}/stars.db"))
        self.spawn([str(VENV / "bin" / "python"), __file__, "serve", str(self.alpaca), str(self.folder)])
        wait("the simulators answer", lambda: self.get("safetymonitor/0/issafe"))

    def spawn(self, command: list[str], **environment: str):
        self.began_s = time.monotonic()
        with open(self.folder / f"{pathlib.Path(command[0]).name}.log", "w") as log:
            process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, cwd=self.folder,
                                       env={**os.environ, **environment}, start_new_session=True)
        self.ends.callback(self.ending, process)
        self.leader = process.pid

    def wait_for_answer(self, path: str):
        wait("the first answer", lambda: fetch(f"http://127.0.0.1:{self.port}{path}"), 300, 0.01)
        self.first_answer_s = time.monotonic() - self.began_s

    def get(self, path: str):
        return fetch(f"http://127.0.0.1:{self.alpaca}/api/v1/{path}")["Value"]

    def set_value(self, path: str, **form) -> float:
        """Sets what a simulator will say; the time at which that arrived."""
        request = urllib.request.Request(f"http://127.0.0.1:{self.alpaca}/api/v1/{path}",
                                         data=urllib.parse.urlencode(form).encode(), method="PUT")
        urllib.request.urlopen(request, timeout=5).close()
        return self.puts(path.rsplit("/", 1)[-1])[-1]

    def set_safe(self, is_safe: bool) -> float:
        return self.set_value("safetymonitor/0/issafe", IsSafe=is_safe)

    def puts(self, member: str, since_s: float = 0.0) -> list[float]:
        """Wall times at which a PUT arrived at the simulators."""
        lines = [line.split() for line in (self.folder / "arrivals.log").read_text().splitlines()]
        return [float(at_s) for at_s, path in lines if path.endswith(f"/{member}") and float(at_s) >= since_s]


def schedule(exposures: dict) -> str:
    """To open the dome and expose on the target from now on, in the format of both programs."""
    actions = [("open", {}), ("object", {"object": "Bench", "ra": TARGET_RA_DEG, "dec": TARGET_DEC_DEG, **exposures})]
    at = [time.strftime("%Y-%m-%d %H:%M:%S", time.gmtime(time.time() + seconds)) for seconds in (0, 1, 14400)]
    return "".join(json.dumps({"device_name": "camera_sim", "action_type": action, "action_value": value,
                               "start_time": begin, "end_time": at[2]}) + "\n" for (action, value), begin in zip(actions, at))


def starmesh(site: Site):
    """Starts it with its schedule, if there is something to expose."""
    # no rule about the Sun or the size of a disk: the predecessor has none
    blocks = [f'[observatory]\nsite = "bench"\ntelescope = "sim"\nlatitude_deg = 48.0\nlongitude_deg = {LONGITUDE_DEG}\n'
              f'elevation_m = 1000.0\n[folders]\ndata = "{site.disk}/data"\nimages = "{site.disk}/images"\n'
              f'[bus]\nmulticast = false\n[safety]\nsun_altitude_max_deg = 90.0\ndisk_free_min_gb = 0.002\n'
              f'[schedule]\nrobotic = {str(bool(site.exposures)).lower()}\n[web]\nlisten = "127.0.0.1:{site.port}"\nrequests_per_s = 10000\n']
    limits = ", ".join(f'{{ parameter = "{name}", upper = {upper}, dwell_min = {DWELL_MIN} }}' for name, upper in LIMITS.items())
    extra = {"camera": "temperature_c = -20.0", "safetymonitor": f"dwell_min = {DWELL_MIN}",
             "observingconditions": f"limit = [{limits}]"}
    for kind in KINDS:
        period = f"period_s = {site.period_s}\n" if site.period_s and kind in PERIODIC else ""
        blocks.append(f'[[{kind}]]\nname = "{kind}_sim"\nserver = "{site.server(kind)}"\n{period}{extra.get(kind, "")}\n')
    (site.folder / "observatory.toml").write_text("".join(blocks))
    (site.folder / "schedule.jsonl").write_text(schedule(site.exposures) if site.exposures else "// nothing\n")
    site.spawn([str(BINARY), "up", str(site.folder / "observatory.toml")])
    site.wait_for_answer("/healthz")


def predecessor_config(site: Site) -> str:
    """Its template, with servers, limits and dwell as the other program has them, and a dome that need not wait for the mount."""
    text, kind = "", ""
    for line in packaged("astra/config/templates/observatory_config.yml").replace("observatoryname", "sim").splitlines():
        if section := re.match(r"(\w+):", line):
            kind = section[1].lower()
        text += line.replace("localhost:11111", site.server(kind)) + "\n"
        if site.period_s and kind in PERIODIC and "device_number" in line:
            text += f"    polling_interval: {site.period_s}\n"
    if site.period_s:
        text = re.sub(r"^ +polling_interval: 5\b.*\n", "", text, flags=re.M)
    limits = "".join(f"      {name}:\n        - upper: {upper}\n          max_safe_duration: {DWELL_MIN}\n"
                     for name, upper in LIMITS.items())
    text = re.sub(r"^( +closing_limits:\n)(?: .*\n)+", lambda found: found[1] + limits, text, flags=re.M)
    text = text.replace("close_dome_on_telescope_error: false", "close_dome_on_telescope_error: true")
    return re.sub(r"^(SafetyMonitor:\n(?: .*\n)*? +max_safe_duration:) [\d.]+", rf"\1 {DWELL_MIN}", text, flags=re.M)


def predecessor(site: Site):
    """Starts it; then gives it its schedule and turns its robotic switch."""
    assets, url = site.disk / "assets", f"http://127.0.0.1:{site.port}/api"
    configs, file = assets / "observatory_config", assets / "schedules/sim.jsonl"
    for folder in [site.home / ".astra", configs, file.parent]:
        folder.mkdir(parents=True, exist_ok=True)
    file.unlink(missing_ok=True)
    (site.home / ".astra/astra_config.yml").write_text(f"folder_assets: {assets}\ngaia_db: ''\nobservatory_name: sim\n")
    (configs / "sim_config.yml").write_text(predecessor_config(site))
    table = packaged("astra/config/templates/observatory_fits_header_config.csv").replace(",ORIGIN,", ",SIM,")
    (configs / "sim_fits_header_config.csv").write_text(table.replace("observatoryname", "sim").rstrip("\n") + "\n" + RAIN_ROW)
    site.spawn([str(VENV / "bin" / "astra"), "--port", str(site.port)], HOME=str(site.home))
    site.wait_for_answer("/api/heartbeat")
    try:
        wait("weather is safe", lambda: is_well(url), 20, 0.5)
    except SystemExit:
        # in a race at its start its watchdog meets an IsSafe without a time and ends: its operator starts it again
        time.sleep(ERROR_TREE_S)
        restart_watchdog(url)
    begin_night(site)


def is_well(url: str) -> bool:
    """Its watchdog runs, finds no error, and calls the sky safe."""
    status = fetch(f"{url}/heartbeat")["data"]
    age = datetime.datetime.now(datetime.UTC) - datetime.datetime.fromisoformat(status["datetime"] + "+00:00")
    return status["error_free"] and status["weather_safe"] and age.total_seconds() < 5


def restart_watchdog(url: str):
    """As its operator does after an error; it forgets all errors."""
    urllib.request.urlopen(urllib.request.Request(f"{url}/startwatchdog", method="POST"), timeout=10).close()
    wait("weather is safe again", lambda: is_well(url), 60, 0.5)


def begin_night(site: Site):
    """Gives it its schedule, if there is something to expose, and turns its robotic switch."""
    if site.exposures:
        (site.disk / "assets/schedules/sim.jsonl").write_text(schedule(site.exposures))
        time.sleep(3)
        switch = urllib.request.Request(f"http://127.0.0.1:{site.port}/api/roboticswitch", method="POST")  # a toggle
        wait("the robotic switch is on", lambda: fetch(switch)["data"], 10, 2)


if __name__ == "__main__" and sys.argv[1:2] == ["serve"]:
    serve(*sys.argv[2:])
