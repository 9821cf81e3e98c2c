"""A simulated night with a transit of WASP-18, taken by the processes that a user starts. Standard library only."""

import contextlib
import datetime
import json
import pathlib
import signal
import statistics
import subprocess
import time
import urllib.request

from ports import free_port

OBJECT, RA_DEG, DEC_DEG = "WASP-18", 24.3543, -45.6779
DEPTH_MMAG = 18.0
DEPTH = 1 - 10 ** (-DEPTH_MMAG / 2500)
MID = datetime.datetime(2026, 11, 22, 1, 2, tzinfo=datetime.timezone.utc)
DURATION_MIN, INGRESS_MIN = 36.0, 5.0
START, SPEED, EXPOSURE_S = "2026-11-22T00:14:00Z", 100, 40.0
BEGIN, DAWN = "2026-11-22 00:15:00", "2026-11-22 09:00:00"

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
listen = "127.0.0.1:{web}"

[pointing]
# a pixel is 0.18 arcmin wide
threshold_arcmin = 0.5
"""
DEVICES = {"telescope": "", "camera": "temperature_c = -10", "filterwheel": "", "dome": "", "safetymonitor": "dwell_min = 1",
           "covercalibrator": ""}
# behind closed shutters: flats of the lamp in the cover, bias frames, and darks as long as the frames of the target
CALIBRATION = [("flats", {"filter": ["V"], "n": [7], "source": "panel"}), ("calibration", {"exptime": [0, EXPOSURE_S], "n": [7, 7]})]


class Transit:
    """The simulator and the nodes, with all that they write in one folder."""

    def __init__(self, starmesh: str, folder: pathlib.Path, after_mid_min: float = 38.0, calibration: bool = False):
        """The target is observed until so many minutes after the middle of its transit."""
        self.starmesh, self.folder = starmesh, folder
        self.server, self.processes = f"127.0.0.1:{free_port()}", []
        blocks = [f'[[{kind}]]\nname = "{kind}"\nserver = "{self.server}"\n{more}\n' for kind, more in DEVICES.items()]
        text = CONFIG.format(server=self.server, web=free_port())
        (folder / "observatory.toml").write_text("\n".join([text, *blocks]))
        field = {"object": OBJECT, "ra": RA_DEG, "dec": DEC_DEG, "exptime": EXPOSURE_S, "filter": "V", "pointing": True}
        end = MID + datetime.timedelta(minutes=after_mid_min)
        rows = [("open", {}, DAWN), ("object", field, f"{end:%Y-%m-%d %H:%M:%S}"), ("close", {}, DAWN)]
        rows += [(*row, DAWN) for row in CALIBRATION if calibration]
        lines = [json.dumps({"device_name": "camera", "action_type": action, "action_value": value, "start_time": BEGIN, "end_time": end})
                 for action, value, end in rows]
        (folder / "schedule.jsonl").write_text("\n".join(lines) + "\n")

    def spawn(self, *words: str):
        with open(self.folder / f"{words[0]}.log", "w") as log:
            self.processes.append(subprocess.Popen([self.starmesh, *words], stdin=subprocess.DEVNULL, stdout=log, stderr=log))

    def device(self, path: str):
        with urllib.request.urlopen(f"http://{self.server}/api/v1/{path}?ClientID=9&ClientTransactionID=1", timeout=5) as answer:
            return json.load(answer)["Value"]

    def run(self):
        """The whole night, to the frames that are measured."""
        transit = (f"ra={RA_DEG},dec={DEC_DEG},depth-mmag={DEPTH_MMAG},mid={MID:%Y-%m-%dT%H:%M:%SZ},"
                   f"duration-min={DURATION_MIN},ingress-min={INGRESS_MIN}")
        self.spawn("simulator", "--bind", self.server, "--start", START, "--speed", str(SPEED), "--size-px", "512", "--pixel-um", "54",
                   "--optics-fwhm-arcsec", "35", "--roof", "--shutter-s", "10", "--transit", transit)
        self.wait("the simulator answers", lambda: self.device("telescope/0/connected") is not None, 30)
        self.spawn("up", str(self.folder / "observatory.toml"))
        self.wait("the report is written when the night has ended", lambda: list((self.folder / "images/reports").glob("*.json")), 180)
        self.wait("every frame of the target is a point", lambda: self.curve()["frames_left_out"] == 0, 60)

    def wait(self, what: str, holds, limit_s: float):
        until = time.monotonic() + limit_s
        while True:
            with contextlib.suppress(OSError):
                if holds():
                    return
            if time.monotonic() > until or any(process.poll() is not None for process in self.processes):
                logs = "\n".join(path.read_text(errors="replace")[-4000:] for path in self.folder.glob("*.log"))
                raise AssertionError(f"{what}: not within {limit_s} s\n{logs}")
            time.sleep(0.3)

    def fits(self) -> list[pathlib.Path]:
        return sorted((self.folder / "images").rglob("*.fits"))

    def curve(self) -> dict:
        """The light curve of the night's report."""
        command = [self.starmesh, "night", "report", "last", "--json", "--config", str(self.folder / "observatory.toml")]
        curves = json.loads(subprocess.run(command, capture_output=True, text=True, timeout=60, check=True).stdout)["curves"]
        assert len(curves) == 1, curves
        return curves[0]

    def stop(self) -> list[int]:
        """Ends what it started, the nodes first; returns their exit codes."""
        codes = []
        for process in reversed(self.processes):
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
            try:
                codes.append(process.wait(timeout=60))
            except subprocess.TimeoutExpired:
                process.kill()
                codes.append(process.wait())
        return codes


def points(curve: dict) -> list[tuple[float, float]]:
    """Middle of the exposure, seconds since 1970, and flux."""
    return [(datetime.datetime.fromisoformat(point["mid_utc"]).timestamp(), point["flux"]) for point in curve["points"]]


class Fit:
    """A light curve against the transit that was simulated: levels by least squares, and what is left."""

    def __init__(self, points: list[tuple[float, float]]):
        """`points`: middle of the exposure (seconds since 1970) and flux."""
        inside, outside = [], []
        half_s, slope_s = DURATION_MIN * 30, INGRESS_MIN * 60
        for at, flux in points:
            off_s = abs(at - MID.timestamp())
            if off_s <= half_s - slope_s - EXPOSURE_S / 2:
                inside.append(flux)
            elif off_s >= half_s + EXPOSURE_S / 2:
                outside.append(flux)
        level = statistics.mean(outside)
        self.inside, self.outside = len(inside), len(outside)
        self.depth = 1 - statistics.mean(inside) / level
        self.scatter = statistics.stdev(outside) / level
        self.depth_error = self.scatter * (1 / len(inside) + 1 / len(outside)) ** 0.5

    def __repr__(self) -> str:
        return (f"depth {1e3 * self.depth:.2f} +- {1e3 * self.depth_error:.2f} thousandths of {self.inside} points inside, "
                f"scatter {1e3 * self.scatter:.2f} of {self.outside} outside")
