"""The shell lines of docs/operator/import.md, one after the other, in a network namespace of their own:
`import_document.py SECTION STARMESH DOCUMENT HOME`.

HOME has the predecessor's files where the document has them, and no schedule yet. Standard library only; what happened is printed as one JSON
object.
"""

import datetime
import json
import os
import pathlib
import re
import signal
import subprocess
import sys
import time
import urllib.request

from imported_site import connect, get, rows, sidereal_deg, wait

PORT = 11111
CAMERA = "camera_template"
LIMIT_S = 420


def lines_of(document: pathlib.Path, section: str) -> list[str]:
    """The shell lines of a section; comments go."""
    [text] = [part for part in re.split(r"^#+ ", document.read_text(), flags=re.M) if part.startswith(section)]
    blocks = re.findall(r"^```sh\n(.*?)^```", text, flags=re.M | re.S)
    return [line.split("  #")[0].strip() for block in blocks for line in block.splitlines() if line.strip()]


def write_night(assets: pathlib.Path, second_filter: str):
    """A night with what the predecessor does in one, at the place of the simulator, and with a filter of its wheel."""
    dusk = datetime.datetime(2026, 11, 22, 0, 30, tzinfo=datetime.timezone.utc)
    field = {"ra": (sidereal_deg(dusk, -70.4) + 40) % 360, "dec": -30.0, "exptime": 20.0, "n": 3, "filter": "V"}
    rows(assets, "template", dusk, 8 * 3600, [
        (CAMERA, "cool_camera", {}),
        (CAMERA, "open", {}),
        (CAMERA, "autofocus", {"exptime": 4, "filter": "V", "search_range": 3000, "search_range_is_relative": True, "n_steps": [9, 7],
                               "n_exposures": [1, 1]}),
        (CAMERA, "calibrate_guiding", {"filter": "V", "exptime": 4.0, "pulse_time": 5000, "number_of_cycles": 5}),
        (CAMERA, "pointing_model", {"n": 5, "exptime": 4.0, "filter": "V"}),
        (CAMERA, "object", field | {"object": "A Field", "pointing": True, "guiding": True, "metadata": {"ID": 17}}),
        (CAMERA, "object", field | {"object": "Another", "filter": second_filter, "guiding": None}),
        (CAMERA, "close", {}),
        (CAMERA, "calibration", {"exptime": [0, 10], "n": [2, 2]}),
        (CAMERA, "complete_headers", {}),
    ])


class Shell:
    """A terminal: lines that go on are ended with Ctrl-C."""

    def __init__(self, home: pathlib.Path, telescope: str):
        self.home, self.telescope, self.going, self.printed = home, telescope, [], []

    def type(self, line: str):
        if not (line.endswith("&") or line.startswith("starmesh up")):
            done = subprocess.run(["bash", "-c", line], cwd=self.home, capture_output=True, text=True, timeout=120)
            self.printed.append(done.stdout + done.stderr)
            if done.returncode != 0:
                raise SystemExit(f"{line}: {done.stdout}{done.stderr}")
            return
        with open(self.home / f"{len(self.going)}.log", "w") as log:
            words = ["bash", "-c", "exec " + line.rstrip("& ")]
            self.going.append(subprocess.Popen(words, cwd=self.home, stdin=subprocess.DEVNULL, stdout=log, stderr=log))
        if " simulator" in line:
            def answers():
                try:
                    return get(PORT, "simulator/v1/faults") == {}
                except OSError:
                    return False
            wait("the simulator answers", answers, 30)
        if line.startswith("starmesh up"):
            def shows():
                try:
                    return find(state(self.telescope), "rows") is not None
                except OSError:
                    return False
            # a person types the next line once the page shows the telescope
            wait("the page shows the rows", shows, 60)

    def end(self) -> list[int]:
        """Ctrl-C, for the newest first."""
        codes = []
        for process in reversed(self.going):
            process.send_signal(signal.SIGINT)
            codes.append(process.wait(timeout=60))
        return codes


def state(telescope: str) -> dict:
    with urllib.request.urlopen(f"http://127.0.0.1:8080/api/v1/telescopes/{telescope}", timeout=5) as answer:
        return json.load(answer)


def follow(telescope: str) -> list[dict]:
    """The rows of the schedule, once all of them have ended."""
    until = time.monotonic() + LIMIT_S
    rows: list[dict] = []
    while time.monotonic() < until:
        try:
            found = find(state(telescope), "rows")
            rows = found if found is not None else rows
        except OSError:
            pass
        if rows and all(row["status"] in ("finished", "failed", "skipped") for row in rows):
            break
        time.sleep(0.5)
    return rows


def find(value, key: str):
    """The first list of this name with rows in it, wherever it stands."""
    if isinstance(value, dict):
        if isinstance(value.get(key), list) and value[key] and "status" in value[key][0]:
            return value[key]
        value = list(value.values())
    if isinstance(value, list):
        for each in value:
            if (found := find(each, key)) is not None:
                return found
    return None


def closings() -> list[str]:
    """What was asked of the dome, in order."""
    puts = get(PORT, "simulator/v1/log")["puts"]
    return [put["member"] for put in puts if put["device"] == "dome" and put["member"] in ("openshutter", "park", "closeshutter")]


def opened() -> float:
    """How far the dome is open: 0 is closed, 1 is open."""
    return get(PORT, "simulator/v1/world")["dome"]["open"]


def main(section: str, starmesh: str, document: str, home: str):
    for words in ["link set lo up", "link set lo multicast on", "route add 224.0.0.0/4 dev lo"]:
        subprocess.run(["ip", *words.split()], check=True)
    folder = pathlib.Path(home)
    os.environ["HOME"], os.environ["PATH"] = home, f"{pathlib.Path(starmesh).parent}:{os.environ['PATH']}"
    telescope = "template/telescope-template"
    shell = Shell(folder, telescope)
    try:
        # the trial gives the simulator the site's own filters
        write_night(folder / "Documents/Astra", "zYJ" if section == "Trying it first" else "V")
        if section == "Coming from Astra":
            # in the place of the site's devices, which the predecessor leaves connected
            shell.type("starmesh simulator &")
            connect(PORT, "telescope")
            connect(PORT, "observingconditions")
        for line in lines_of(pathlib.Path(document), section):
            shell.type(line.replace("SITE/TELESCOPE", telescope))
        if section == "Coming from Astra":
            rows = find(state(telescope), "rows")
            print(json.dumps({"rows": len(rows), "printed": shell.printed, "codes": shell.end()}))
            return
        ended = follow(telescope)
        wait("the dome is closed", lambda: opened() == 0, 60)
        outcome = {"rows": [(row["action"], row["status"], row.get("detail", "")) for row in ended], "printed": shell.printed,
                   "dome": closings()}
        print(json.dumps(outcome | {"codes": shell.end()}))
    finally:
        # the newest first: the nodes close at a simulator that still answers
        for process in reversed(shell.going):
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
                try:
                    process.wait(timeout=60)
                except subprocess.TimeoutExpired:
                    process.kill()


if __name__ == "__main__":
    main(*sys.argv[1:])
