#!/usr/bin/env python3
"""Measures Starmesh and its predecessor on the same simulators; see README.md beside this file. Standard library only."""

import contextlib
import http.client
import json
import os
import pathlib
import random
import re
import signal
import sqlite3
import statistics
import subprocess
import sys
import tempfile
import time
import urllib.request

from run import BINARY, PROJECT, cpu_s, fetch, free_port, pss_mib, wait

VENV = PROJECT / "target" / "bench-venv"
KINDS = ["telescope", "focuser", "camera", "dome", "filterwheel", "observingconditions", "safetymonitor"]
LONGITUDE_DEG = 8.0  # of the simulators' site
# 30 degrees east of the meridian now, by the days since J2000: high for hours, and no meridian flip
TARGET_RA_DEG = (280.46062 + 360.98564737 * (time.time() / 86400 - 10957.5) + LONGITUDE_DEG + 30.0) % 360
TARGET_DEC_DEG = 50.0
DWELL_MIN = 0.1  # safe again after so long, for both
SETTLE_S = 15.0
FOLDER = pathlib.Path(tempfile.gettempdir()) / f"starmesh-side-by-side-{os.getpid()}"


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


def write_catalogue():
    """Stars around the target, for the sky of the simulated camera."""
    chance = random.Random(5)
    with contextlib.closing(sqlite3.connect(FOLDER / "stars.db")) as database, database:
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
    """Asks a process to end; what is left of its group after a minute, or after an interrupt, is killed."""
    try:
        process.send_signal(signal.SIGINT)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(timeout=60)
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


class Site:
    """The simulators and one of the programs, each in a session of its own."""

    def __init__(self, program, ends: contextlib.ExitStack):
        self.ends = ends
        self.folder = pathlib.Path(tempfile.mkdtemp(prefix=f"{program.__name__}-", dir=FOLDER))
        self.alpaca, self.port = free_port(), free_port()

    def start_simulators(self):
        text = packaged("alpaca_simulators/config/template.yaml").replace("tap_source: null", f"tap_source: {FOLDER}/stars.db")
        (self.folder / "simulators.yaml").write_text(text)
        self.spawn([str(VENV / "bin" / "python"), __file__, "serve", str(self.alpaca), str(self.folder)])
        wait("the simulators answer", lambda: self.get("safetymonitor/0/issafe"))

    def spawn(self, command: list[str], **environment: str):
        self.began_s = time.monotonic()
        with open(self.folder / f"{pathlib.Path(command[0]).name}.log", "w") as log:
            process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, cwd=self.folder,
                                       env={**os.environ, **environment}, start_new_session=True)
        self.ends.callback(end, process)
        self.leader = process.pid

    def wait_for_answer(self, path: str):
        wait("the first answer", lambda: fetch(f"http://127.0.0.1:{self.port}{path}"), 120, 0.01)
        self.first_answer_s = time.monotonic() - self.began_s

    def get(self, path: str):
        return fetch(f"http://127.0.0.1:{self.alpaca}/api/v1/{path}")["Value"]

    def say_safe(self, is_safe: bool) -> float:
        """Sets the safety monitor; the time at which that arrived."""
        request = urllib.request.Request(f"http://127.0.0.1:{self.alpaca}/api/v1/safetymonitor/0/issafe",
                                         data=f"IsSafe={is_safe}".encode(), method="PUT")
        urllib.request.urlopen(request, timeout=5).close()
        return self.puts("issafe")[-1]

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


def starmesh(site: Site, exposures: dict):
    """Starts it with its schedule, if there is something to expose."""
    blocks = [f'[observatory]\nsite = "bench"\ntelescope = "sim"\nlatitude_deg = 48.0\nlongitude_deg = {LONGITUDE_DEG}\n'
              f'elevation_m = 1000.0\n[bus]\nmulticast = false\n[schedule]\nrobotic = {str(bool(exposures)).lower()}\n'
              f'[web]\nlisten = "127.0.0.1:{site.port}"\n']
    extra = {"camera": "temperature_c = -20.0", "safetymonitor": f"dwell_min = {DWELL_MIN}",
             "observingconditions": 'limit = [{ parameter = "Humidity", upper = 70.0, dwell_min = 0.1 }]'}
    for kind in KINDS:
        blocks.append(f'[[{kind}]]\nname = "{kind}_sim"\nserver = "127.0.0.1:{site.alpaca}"\n{extra.get(kind, "")}\n')
    (site.folder / "observatory.toml").write_text("".join(blocks))
    (site.folder / "schedule.jsonl").write_text(schedule(exposures) if exposures else "// nothing\n")
    site.spawn([str(BINARY), "up", str(site.folder / "observatory.toml")])
    site.wait_for_answer("/healthz")


def predecessor(site: Site, exposures: dict):
    """Starts it in one home for all its starts, caches included; then gives it its schedule and turns its robotic switch."""
    home, url = FOLDER / "home", f"http://127.0.0.1:{site.port}/api"
    configs, file = home / "assets/observatory_config", home / "assets/schedules/sim.jsonl"
    for folder in [home / ".astra", configs, file.parent]:
        folder.mkdir(parents=True, exist_ok=True)
    file.unlink(missing_ok=True)
    (home / ".astra/astra_config.yml").write_text(f"folder_assets: {home}/assets\ngaia_db: ''\nobservatory_name: sim\n")
    for name in ["config.yml", "fits_header_config.csv"]:
        text = packaged(f"astra/config/templates/observatory_{name}").replace(",ORIGIN,", ",SIM,")
        text = text.replace("observatoryname", "sim").replace("localhost:11111", f"127.0.0.1:{site.alpaca}")
        text = re.sub(r"^(SafetyMonitor:\n(?: .*\n)*? +max_safe_duration:) [\d.]+", rf"\1 {DWELL_MIN}", text, flags=re.M)
        (configs / f"sim_{name}").write_text(text)
    site.spawn([str(VENV / "bin" / "astra"), "--port", str(site.port)], HOME=str(home))
    site.wait_for_answer("/api/heartbeat")
    wait("weather is safe", lambda: (said := fetch(f"{url}/heartbeat")["data"])["weather_safe"] and said["error_free"], 60, 0.5)
    if exposures:
        file.write_text(schedule(exposures))
        time.sleep(3)
        switch = urllib.request.Request(f"{url}/roboticswitch", method="POST")  # a toggle, off at the start
        wait("the robotic switch is on", lambda: fetch(switch)["data"], 10, 2)


@contextlib.contextmanager
def started(program, **exposures):
    """A site whose program answers and does what it was given to do."""
    with contextlib.ExitStack() as ends:
        site = Site(program, ends)
        site.start_simulators()
        program(site, exposures)
        yield site


def spread(values: list[float], form: str) -> str:
    return " / ".join(format(value, form) for value in (min(values), statistics.median(values), max(values)))


def idle(program) -> list[str]:
    """Robotic switch off, default periods, nothing to do; all processes."""
    seconds = float(os.environ.get("IDLE_S", "120"))
    with started(program) as site:
        time.sleep(SETTLE_S)
        before = {pid: cpu_s(pid) for pid in session(site.leader)}
        time.sleep(seconds)
        pids = session(site.leader)
        used_s = sum(cpu_s(pid) - before.get(pid, 0.0) for pid in pids)
        return [f"{used_s * 60 / seconds:.2f}", f"{sum(map(pss_mib, pids)):.0f} ({len(pids)} processes)"]


def start(program) -> list[str]:
    """Command to first answer; the first start, which fills caches, does not count."""
    took_s = []
    for _ in range(4):
        with started(program) as site:
            took_s.append(site.first_answer_s)
    return [spread(took_s[1:], ".2f")]


def heartbeat(program) -> list[str]:
    """Keep-alive requests 20 ms apart."""
    with started(program) as site:
        time.sleep(SETTLE_S)
        connection = http.client.HTTPConnection("127.0.0.1", site.port, timeout=5)
        took_ms = []
        for _ in range(300):
            began_s = time.perf_counter()
            connection.request("GET", "/api/heartbeat")
            body = connection.getresponse().read()
            took_ms.append((time.perf_counter() - began_s) * 1000)
            time.sleep(0.02)
    return [f"{statistics.median(took_ms):.2f} / {statistics.quantiles(took_ms, n=100)[98]:.2f} ({len(body)} bytes)"]


def wire(program) -> list[str]:
    """IsSafe = false to closeshutter, as both arrive at the simulators, while 10 s exposures are taken."""
    count, took_s, chance = int(os.environ.get("WIRE_N", "10")), [], random.Random(5)
    with started(program, exptime=10.0) as site:
        for _ in range(count):
            site.say_safe(True)
            wait("it exposes", lambda: site.get("dome/0/shutterstatus") == 0 and site.get("camera/0/camerastate") == 2, 180, 0.5)
            time.sleep(6 + 5 * chance.random())
            began_s = site.say_safe(False)
            took_s.append(wait("closeshutter arrives", lambda: site.puts("closeshutter", began_s))[0] - began_s)
            wait("the mount is parked", lambda: site.get("telescope/0/atpark") and site.get("dome/0/shutterstatus") == 1, 60, 0.5)
            time.sleep(5)
    return [spread(took_s, ".2f")]


def dead(program) -> list[str]:
    """Start to start of 1 s exposures, less the exposure."""
    count = int(os.environ.get("DEAD_N", "30"))
    with started(program, exptime=1.0, n=count) as site:
        at_s = wait("all are taken", lambda: (found := site.puts("startexposure"))[count - 1:] and found, 120 + 3 * count, 0.5)
    return [spread([(b - a - 1.0) * 1000 for a, b in zip(at_s, at_s[1:])], ".0f")]


WORKS = {
    idle: ["idle CPU, s/min", "idle PSS, MiB"],
    start: ["start to first answer, s, min / median / max"],
    heartbeat: ["`/api/heartbeat` keep-alive, ms, median / p99"],
    wire: ["IsSafe = false to `closeshutter`, s, min / median / max"],
    dead: ["start to start of 1 s exposures - 1 s, ms, min / median / max"],
}


def cells(work, program) -> list[str]:
    """Figures of one work of one program; after two failures the reason."""
    for _ in range(2):
        print(f"measuring {work.__name__} of {program.__name__} ...", file=sys.stderr, flush=True)
        try:
            return work(program)
        except (SystemExit, OSError, http.client.HTTPException) as failure:
            reason = f"not measured: {failure}"
            print(reason, file=sys.stderr, flush=True)
    return [reason] * len(WORKS[work])


def main():
    if sys.argv[1:2] == ["serve"]:
        return serve(*sys.argv[2:])
    known = {work.__name__: work for work in WORKS}
    asked = sys.argv[1:] or list(known)
    if unknown := [name for name in asked if name not in known]:
        raise SystemExit(f"bench: {', '.join(unknown)}: expected some of {', '.join(known)}")
    if not BINARY.exists():
        raise SystemExit(f"bench: {BINARY} is missing: cargo build --release --workspace")
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # so that all that was started is ended
    install()
    if "STARMESH_BENCH_ALONE" not in os.environ:
        # the predecessor listens on all addresses, so all run where there is no other than loopback
        alone = ["unshare", "--map-root-user", "--net", "sh", "-c", 'ip link set lo up && exec "$@"', "sh"]
        os.environ["STARMESH_BENCH_ALONE"] = "1"
        os.execvp(alone[0], [*alone, sys.executable, "-B", *sys.argv])
    FOLDER.mkdir()
    write_catalogue()
    print("| work | Starmesh | predecessor |\n|---|---|---|", flush=True)
    for name in asked:
        both = [cells(known[name], program) for program in (starmesh, predecessor)]
        for row in zip(WORKS[known[name]], *both):
            print("| " + " | ".join(row) + " |", flush=True)
    for frame in FOLDER.rglob("*.fits"):
        frame.unlink()
    print(f"configurations and logs: {FOLDER}", file=sys.stderr)


if __name__ == "__main__":
    main()
