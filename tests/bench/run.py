#!/usr/bin/env python3
"""Measures release builds and prints a table; see README.md beside this file. Standard library only."""

import contextlib
import datetime
import http.client
import json
import os
import pathlib
import random
import re
import signal
import statistics
import subprocess
import sys
import tempfile
import time
import urllib.request

from loopback import fetch, free_port, put, wait

PROJECT = pathlib.Path(__file__).resolve().parents[2]
BINARY = pathlib.Path(os.environ.get("STARMESH_BIN", PROJECT / "target" / "release" / "starmesh"))
READOUT_S = 1.0  # of the simulator's camera
ROLES = ["device", "observatory", "archive", "web"]
ROWS: list[tuple[str, str, str]] = []


class Telescope:
    """A simulated observatory and the four nodes as release processes on a private bus."""

    def __init__(self, speed: float = 1.0, rows=(), size_px: int = 1024, robotic: bool = False):
        self.folder = pathlib.Path(tempfile.mkdtemp(prefix="starmesh-bench-"))
        self.alpaca, self.bus, self.web = free_port(), free_port(), free_port()
        self.processes: dict[str, subprocess.Popen] = {}
        start = "2026-11-21T02:30:00Z"
        self.spawn("simulator", ["simulator", "--bind", f"127.0.0.1:{self.alpaca}", "--speed", str(speed),
                                 "--size-px", str(size_px), "--start", start])
        clock = wait("the simulator answers", lambda: fetch(f"http://127.0.0.1:{self.alpaca}/simulator/v1/clock"))
        blocks = [f"""[observatory]
site = "bench"
telescope = "alpha"
latitude_deg = -24.6272
longitude_deg = -70.4042
elevation_m = 2635
[bus]
multicast = false
[clock]
simulator = "http://127.0.0.1:{self.alpaca}"
[schedule]
robotic = {str(robotic).lower()}
[web]
listen = "127.0.0.1:{self.web}"
requests_per_s = 10000
"""]
        extra = {"safetymonitor": "dwell_min = 0.02", "camera": "temperature_c = 5.0\ntemperature_tolerance_c = 30.0"}
        for kind in ["telescope", "camera", "filterwheel", "focuser", "dome", "safetymonitor", "observingconditions",
                     "covercalibrator", "switch", "rotator"]:
            blocks.append(f'[[{kind}]]\nname = "{kind}"\nserver = "127.0.0.1:{self.alpaca}"\n{extra.get(kind, "")}\n')
        (self.folder / "observatory.toml").write_text("".join(blocks))
        utc = clock["utc"]
        lines = [json.dumps({"device_name": "camera", "action_type": action, "action_value": value, "start_time": utc,
                             "end_time": "2026-11-21T12:00:00Z"}) for action, value in rows]
        (self.folder / "schedule.jsonl").write_text("\n".join(lines or ["// nothing"]) + "\n")

    def spawn(self, name: str, arguments: list[str]):
        with open(self.folder / f"{name}.log", "a") as log:
            self.processes[name] = subprocess.Popen([str(BINARY), *arguments], stdout=log, stderr=log)

    def start_nodes(self):
        endpoint = f"tcp/127.0.0.1:{self.bus}"
        for role in ["observatory", "device", "archive", "web"]:
            where = ["--listen", endpoint] if role == "observatory" else ["--connect", endpoint]
            self.spawn(role, ["node", role, "--config", str(self.folder / "observatory.toml"), *where])
        wait("the page answers", lambda: urllib.request.urlopen(f"http://127.0.0.1:{self.web}/healthz", timeout=2).status == 200)

    def device(self, path: str):
        return fetch(f"http://127.0.0.1:{self.alpaca}/api/v1/{path}")["Value"]

    def unsafe(self, is_unsafe: bool):
        put(f"http://127.0.0.1:{self.alpaca}/simulator/v1/world/safety", {"unsafe": is_unsafe})

    def puts(self, member: str, since_s: float) -> list[float]:
        """Wall times at which a PUT arrived at the simulator, which runs on this machine."""
        puts = fetch(f"http://127.0.0.1:{self.alpaca}/simulator/v1/log")["puts"]
        times = [datetime.datetime.fromisoformat(e["wall_utc"]).timestamp() for e in puts if e["member"] == member]
        return [t for t in times if t >= since_s]

    def stop(self):
        for name, process in sorted(self.processes.items(), key=lambda item: item[0] == "simulator"):
            process.send_signal(signal.SIGINT if name == "simulator" else signal.SIGTERM)
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(timeout=20)
            if process.poll() is None:
                process.kill()
                process.wait()


@contextlib.contextmanager
def telescope(**options):
    rig = Telescope(**options)
    try:
        rig.start_nodes()
        yield rig
    finally:
        rig.stop()


def cpu_s(pid: int) -> float:
    fields = pathlib.Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def pss_mib(pid: int) -> float:
    text = pathlib.Path(f"/proc/{pid}/smaps_rollup").read_text()
    return int(re.search(r"^Pss:\s+(\d+) kB", text, re.M).group(1)) / 1024


def greatest_mib(pid: int) -> float:
    """The most that was resident at any moment."""
    status = pathlib.Path(f"/proc/{pid}/status").read_text()
    return int(re.search(r"^VmHWM:\s+(\d+) kB", status, re.M).group(1)) / 1024


def idle():
    """Four processes, ten devices, default periods, nothing to do."""
    seconds = float(os.environ.get("IDLE_S", "120"))
    with telescope() as rig:
        time.sleep(15)
        before = {role: cpu_s(rig.processes[role].pid) for role in ROLES}
        time.sleep(seconds)
        used = {role: (cpu_s(rig.processes[role].pid) - before[role]) * 60 / seconds for role in ROLES}
        memory = {role: pss_mib(rig.processes[role].pid) for role in ROLES}
    split = ", ".join(f"{role} {used[role]:.2f}" for role in ROLES)
    ROWS.append(("idle CPU, s/min", f"{sum(used.values()):.2f} ({split})", "<= 0.7; predecessor 2.2"))
    split = ", ".join(f"{role} {memory[role]:.0f}" for role in ROLES)
    ROWS.append(("idle PSS, MiB", f"{sum(memory.values()):.0f} ({split})", "<= 120; predecessor 1567"))


def wire():
    """IsSafe = false to closeshutter at the simulator; random phase against the poll."""
    count = int(os.environ.get("WIRE_N", "100"))
    random.seed(5)
    took = []
    # a row that goes on opens the dome again after each closing
    watching = ("object", {"object": "Anything", "alt": 70.0, "az": 90.0, "exptime": 120.0})
    with telescope(speed=60.0, rows=[("open", {}), watching], size_px=256, robotic=True) as rig:
        for _ in range(count):
            rig.unsafe(False)
            wait("the dome opens", lambda: rig.device("dome/0/shutterstatus") == 0, 60)
            time.sleep(1.5 + random.random())
            began_s = time.time()
            rig.unsafe(True)
            took.append(wait("closeshutter arrives", lambda: rig.puts("closeshutter", began_s), 20, 0.02)[0] - began_s)
            wait("the dome is closed", lambda: rig.device("dome/0/shutterstatus") == 1, 30)
    took.sort()
    within = sum(t <= 1.25 for t in took)
    ROWS.append(("IsSafe=false to closeshutter, s",
                 f"min {took[0]:.2f}, median {statistics.median(took):.2f}, max {took[-1]:.2f}; {within} of {count} within 1.25",
                 "99 of 100 within 1.25; predecessor 1.19 / 1.72 / 2.09"))


def dead():
    """Start to start of 1 s exposures, less exposure and readout."""
    count = int(os.environ.get("DEAD_N", "40"))
    rows = [("open", {}), ("calibration", {"exptime": [1.0], "n": [count]})]
    with telescope(rows=rows, robotic=True) as rig:
        def starts():
            found = rig.puts("startexposure", 0)
            return found if len(found) >= count else None

        times = wait("all exposures are taken", starts, 60 + 4 * count, 0.5)
    gaps = sorted((b - a - 1.0 - READOUT_S) * 1000 for a, b in zip(times, times[1:]))
    ROWS.append(("dead time between 1 s exposures, ms beyond readout",
                 f"min {gaps[0]:.0f}, median {statistics.median(gaps):.0f}, max {gaps[-1]:.0f}", "<= 50; predecessor about 110"))


def page():
    """`starmesh demo` to the page answering."""
    took = []
    for _ in range(5):
        port, folder = free_port(), tempfile.mkdtemp(prefix="starmesh-bench-")
        began = time.monotonic()
        demo = subprocess.Popen([str(BINARY), "demo", "--port", str(port), "--keep", folder, "--speed", "10"],
                                stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        wait("the page answers", lambda: urllib.request.urlopen(f"http://127.0.0.1:{port}/", timeout=2).status == 200, 30, 0.01)
        took.append(time.monotonic() - began)
        demo.send_signal(signal.SIGINT)
        demo.wait(timeout=60)
    ROWS.append(("command to page answering, s", f"median {statistics.median(took):.2f}, max {max(took):.2f}", "<= 2; predecessor 14"))


def heartbeat():
    """Keep-alive requests, one after another."""
    with telescope() as rig:
        time.sleep(8)
        connection = http.client.HTTPConnection("127.0.0.1", rig.web, timeout=5)
        took = []
        for _ in range(2000):
            began = time.perf_counter()
            connection.request("GET", "/api/heartbeat")
            body = connection.getresponse().read()
            took.append((time.perf_counter() - began) * 1000)
            time.sleep(0.002)
        assert json.loads(body)["status"] == "success"
    took.sort()
    ROWS.append(("/api/heartbeat keep-alive, ms",
                 f"median {statistics.median(took):.2f}, p99 {took[int(len(took) * 0.99)]:.2f} ({len(body)} bytes)",
                 "p99 <= 2; predecessor 6.8"))


def headers():
    """100 headers completed, as `cargo bench` of the archive measures them."""
    done = subprocess.run(["cargo", "bench", "--workspace", "--bench", "headers"], cwd=PROJECT, capture_output=True, text=True)
    line = next((line for line in done.stdout.splitlines() if line.startswith("headers:")), None)
    if line is None:
        raise SystemExit(f"bench: no figure from cargo bench\n{done.stdout}\n{done.stderr[-3000:]}")
    ROWS.append(("100 headers completed", line.removeprefix("headers:").strip(), "<= 3.5 ms each; predecessor 35"))


def main():
    known = {f.__name__: f for f in (idle, wire, dead, page, heartbeat, headers)}
    asked = sys.argv[1:] or list(known)
    if unknown := [name for name in asked if name not in known]:
        raise SystemExit(f"bench: {', '.join(unknown)}: expected some of {', '.join(known)}")
    if not BINARY.exists():
        raise SystemExit(f"bench: {BINARY} is missing: cargo build --release --workspace")
    print("| work | Starmesh | to reach |\n|---|---|---|", flush=True)
    shown = 0
    for name in asked:
        print(f"measuring {name} ...", file=sys.stderr, flush=True)
        known[name]()
        for row in ROWS[shown:]:
            print("| " + " | ".join(row) + " |", flush=True)
        shown = len(ROWS)


if __name__ == "__main__":
    main()
