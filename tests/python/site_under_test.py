"""A site whose hardware is PyPI's alpaca-simulators, run by the four Starmesh nodes as four processes."""

import datetime
import json
import pathlib
import re
import signal
import socket
import subprocess
import sys
import time
import urllib.parse
import urllib.request

import alpaca_simulators

LATITUDE, LONGITUDE, ELEVATION = 48.0, 8.0, 1000.0  # alpaca-simulators' own site
SITE, TELESCOPE = "black-forest", "alpha"
PREFIX = f"starmesh/v1/{SITE}/{TELESCOPE}"
KINDS = ["telescope", "camera", "filterwheel", "focuser", "dome", "safetymonitor", "observingconditions",
         "covercalibrator", "switch", "rotator"]


def free_port() -> int:
    with socket.socket() as s:
        s.bind(("127.0.0.1", 0))
        return s.getsockname()[1]


class Site:
    """The simulators and the nodes, with everything they wrote in one folder."""

    def __init__(self, starmesh: str, folder: pathlib.Path, catalogue: pathlib.Path):
        self.starmesh, self.folder = starmesh, folder
        self.alpaca, self.bus, self.web = free_port(), free_port(), free_port()
        self.processes: dict[str, subprocess.Popen] = {}
        self._start_simulators(catalogue)
        (folder / "observatory.toml").write_text(self.config())

    def config(self) -> str:
        blocks = [f"""
[observatory]
site = "{SITE}"
telescope = "{TELESCOPE}"
latitude_deg = {LATITUDE}
longitude_deg = {LONGITUDE}
elevation_m = {ELEVATION}

[bus]
multicast = false

[safety]
sun_altitude_max_deg = 90.0

[schedule]
robotic = true

[web]
listen = "127.0.0.1:{self.web}"
"""]
        extra = {
            "camera": "temperature_c = -15.0",
            "safetymonitor": "dwell_min = 0.1",
            "observingconditions": 'limit = [{ parameter = "Humidity", upper = 95.0, dwell_min = 0.1 }]',
        }
        for kind in KINDS:
            blocks.append(f'[[{kind}]]\nname = "{kind}_1"\nserver = "127.0.0.1:{self.alpaca}"\nnumber = 0\n{extra.get(kind, "")}\n')
        return "\n".join(blocks)

    def _start_simulators(self, catalogue: pathlib.Path):
        template = pathlib.Path(alpaca_simulators.__file__).parent / "config" / "template.yaml"
        text = template.read_text()
        text, count = re.subn(r"^tap_source: null.*$", f"tap_source: {catalogue}", text, flags=re.M)
        assert count == 1, "alpaca-simulators' template has no line `tap_source: null`"
        config = self.folder / "simulators.yaml"
        config.write_text(text)
        command = [str(pathlib.Path(sys.executable).with_name("alpaca-simulators")),
                   "--port", str(self.alpaca), "--config", str(config)]
        with open(self.folder / "simulators.log", "w") as log:
            self.processes["simulators"] = subprocess.Popen(command, stdout=log, stderr=log)
        until = time.monotonic() + 60
        while True:
            try:
                self.get("safetymonitor/0/issafe")
                return
            except OSError:
                assert time.monotonic() < until, "alpaca-simulators did not come up within 60 s"
                time.sleep(0.2)

    def get(self, path: str):
        with urllib.request.urlopen(f"http://127.0.0.1:{self.alpaca}/api/v1/{path}", timeout=5) as answer:
            return json.load(answer)["Value"]

    def put(self, path: str, **values):
        data = urllib.parse.urlencode(values).encode()
        request = urllib.request.Request(f"http://127.0.0.1:{self.alpaca}/api/v1/{path}", data=data, method="PUT")
        with urllib.request.urlopen(request, timeout=5) as answer:
            body = json.load(answer)
        assert body.get("ErrorNumber", 0) == 0, body

    def schedule(self, rows: list[tuple[str, dict]], seconds: float):
        """Writes rows that start one after another from now on and may run for so long."""
        start = datetime.datetime.now(datetime.timezone.utc)
        end = start + datetime.timedelta(seconds=seconds)
        lines = ["// written by tests/python/site_under_test.py"]
        for index, (action, value) in enumerate(rows):
            at = start + datetime.timedelta(milliseconds=index)
            lines.append(json.dumps({"device_name": "camera_1", "action_type": action, "action_value": value,
                                     "start_time": at.strftime("%Y-%m-%d %H:%M:%S.%f"), "end_time": end.isoformat()}))
        (self.folder / "schedule.jsonl").write_text("\n".join(lines) + "\n")

    def start_nodes(self):
        """The observatory node listens on the private endpoint; the others join there and gossip does the rest."""
        for role in ["observatory", "device", "archive", "web"]:
            self.start_node(role)

    def start_node(self, role: str):
        where = ["--listen", self.endpoint] if role == "observatory" else ["--connect", self.endpoint]
        command = [self.starmesh, "node", role, "--config", str(self.folder / "observatory.toml"), *where]
        with open(self.folder / f"{role}.log", "a") as log:
            self.processes[role] = subprocess.Popen(command, stdout=log, stderr=log)

    @property
    def endpoint(self) -> str:
        return f"tcp/127.0.0.1:{self.bus}"

    def fits(self) -> list[pathlib.Path]:
        return sorted((self.folder / "images").rglob("*.fits"))

    def logs(self) -> str:
        return "\n".join(f"--- {p.name}\n" + "\n".join(p.read_text(errors="replace").splitlines()[-25:])
                         for p in sorted(self.folder.glob("*.log")))

    def stop(self) -> dict[str, int]:
        """Ends every process that was started, nodes first; returns their exit codes."""
        codes = {}
        for name in sorted(self.processes, key=lambda n: n == "simulators"):
            process = self.processes[name]
            process.send_signal(signal.SIGTERM)
            try:
                codes[name] = process.wait(timeout=30)
            except subprocess.TimeoutExpired:
                process.kill()
                codes[name] = process.wait()
        return codes
