"""A site whose hardware is PyPI's alpaca-simulators, run by the four Starmesh nodes as four processes."""

import contextlib
import datetime
import json
import os
import pathlib
import signal
import subprocess
import sys
import time
import urllib.parse
import urllib.request

import alpaca_simulators
import yaml
from bus_subscriber import BusSubscriber
from ports import free_port

LATITUDE, LONGITUDE, ELEVATION = 48.0, 8.0, 1000.0  # alpaca-simulators' own site
SITE, TELESCOPE = "black-forest", "alpha"
PREFIX = f"starmesh/v1/{SITE}/{TELESCOPE}"
KINDS = ["telescope", "camera", "filterwheel", "focuser", "dome", "safetymonitor", "observingconditions",
         "covercalibrator", "switch", "rotator"]


def dense_field(near_ra_deg: float) -> float:
    """Right ascension in degrees of the nearest of make_catalogue.py's dense fields at declination 50, at most an hour away."""
    return (near_ra_deg % 360) // 30 * 30.0 + 15.0


def overridden(template: dict, changed: dict) -> dict:
    """A template with some of its values changed; what it does not have cannot be changed."""
    for key, value in changed.items():
        assert key in template, f"alpaca-simulators' template has no {key!r} among {sorted(map(str, template))}"
        template[key] = overridden(template[key], value) if isinstance(value, dict) else value
    return template


class Site:
    """The simulators and the nodes, with everything they wrote in one folder."""

    def __init__(self, starmesh: str, folder: pathlib.Path, catalogue: pathlib.Path, simulators: dict | None = None,
                 config: str = "", longitude: float = LONGITUDE, blocks: dict[str, str] | None = None):
        """`simulators` overrides the simulators' own template; `config` is added to observatory.toml, `blocks` to its blocks by kind."""
        self.starmesh, self.folder, self.more = starmesh, folder, config
        self.longitude, self.blocks = longitude, blocks or {}
        self.alpaca, self.bus, self.web = free_port(), free_port(), free_port()
        self.processes: dict[str, subprocess.Popen] = {}
        self.catalogue = catalogue
        self._start_simulators({"tap_source": str(catalogue)} | (simulators or {}))
        (folder / "observatory.toml").write_text(self.config())

    def config(self) -> str:
        blocks = [f"""
[observatory]
site = "{SITE}"
telescope = "{TELESCOPE}"
latitude_deg = {LATITUDE}
longitude_deg = {self.longitude}
elevation_m = {ELEVATION}

[bus]
multicast = false

[safety]
sun_altitude_max_deg = 90.0

[imaging]
catalogue = "{self.catalogue}"

[schedule]
robotic = true

[web]
listen = "127.0.0.1:{self.web}"
"""]
        extra = {
            "camera": "temperature_c = -15.0",
            # nothing here needs to come to rest
            "focuser": "settle_s = 0.0",
            "telescope": "settle_s = 0.0",
            "safetymonitor": "dwell_min = 0.1",
            "observingconditions": 'limit = [{ parameter = "Humidity", upper = 95.0, dwell_min = 0.1 }]',
        }
        for kind in KINDS:
            more = f'{extra.get(kind, "")}\n{self.blocks.get(kind, "")}'
            blocks.append(f'[[{kind}]]\nname = "{kind}_1"\nserver = "127.0.0.1:{self.alpaca}"\nnumber = 0\n{more}\n')
        return "\n".join([*blocks, self.more])

    def _start_simulators(self, changed: dict):
        template = pathlib.Path(alpaca_simulators.__file__).parent / "config" / "template.yaml"
        config = self.folder / "simulators.yaml"
        config.write_text(yaml.safe_dump(overridden(yaml.safe_load(template.read_text()), changed)))
        command = [str(pathlib.Path(sys.executable).with_name("alpaca-simulators")),
                   "--port", str(self.alpaca), "--config", str(config)]
        # where their Sun stands must not ask the network, as in conftest.py
        settings = self.folder / "astropy" / "astropy.cfg"
        settings.parent.mkdir()
        settings.write_text("[utils.iers.iers]\nauto_download = False\nauto_max_age = 100000.0\niers_degraded_accuracy = ignore\n")
        environment = {**os.environ, "XDG_CONFIG_HOME": str(self.folder)}
        with open(self.folder / "simulators.log", "w") as log:
            self.processes["simulators"] = subprocess.Popen(command, stdout=log, stderr=log, env=environment)
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

    def schedule(self, rows: list[tuple[str, dict]], seconds: float, **fields: str):
        """Writes rows that start one after another from now on and may run for so long; each has the further fields."""
        start = datetime.datetime.now(datetime.timezone.utc)
        end = start + datetime.timedelta(seconds=seconds)
        lines = ["// written by tests/foreign/site_under_test.py"]
        for index, (action, value) in enumerate(rows):
            at = start + datetime.timedelta(milliseconds=index)
            lines.append(json.dumps({"device_name": "camera_1", "action_type": action, "action_value": value,
                                     "start_time": at.strftime("%Y-%m-%d %H:%M:%S.%f"), "end_time": end.isoformat(), **fields}))
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


class Record:
    """What is left of a night for the tests of a file."""

    site: Site
    subscriber: BusSubscriber
    exit_codes: dict[str, int]


@contextlib.contextmanager
def observing(record: Record):
    """Ends what `record.site` has started, whatever happened; where something did, shows the last words of all nodes."""
    try:
        yield
    except BaseException:
        print(record.site.logs())
        raise
    finally:
        if hasattr(record, "subscriber"):
            record.subscriber.close()
        record.exit_codes = record.site.stop()
