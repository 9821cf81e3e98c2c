"""The network of docs/deploy.md, literally: its three files and its command lines, on its addresses.

The addresses exist in a network namespace of the test's own, in which this file runs again as a program.
"""

import json
import os
import pathlib
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
import urllib.request


PAGE = pathlib.Path(__file__).resolve().parents[2] / "docs" / "deploy.md"
HOSTS = {"10.0.0.5": "shared", "10.0.0.11": "callisto", "10.0.0.12": "europa"}
ROLES = ("device", "observatory", "archive", "web")


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)


def files() -> dict[str, str]:
    """The configuration files of the page, by name."""
    named = ((re.match(r"# (\S+\.toml)\n", text), text) for text in blocks("toml"))
    return {name[1]: text for name, text in named if name}


def commands(host: str) -> list[str]:
    """What is to be typed on a host."""
    found = [text for text in blocks("sh") if text.startswith(f"# on {host}\n")]
    assert len(found) == 1, f"docs/deploy.md has {len(found)} blocks of commands for {host}"
    return found[0].splitlines()[1:]


def status_command() -> str:
    (found,) = [text.strip() for text in blocks("sh") if text.startswith("starmesh status")]
    return found


def test_the_network_of_the_document_runs_as_it_is_written(starmesh, tmp_path):
    assert shutil.which("ip"), "iproute2 is missing: apt-get install iproute2 (scripts/setup does)"
    assert set(files()) == {f"{name}.toml" for name in HOSTS.values()}
    script = pathlib.Path(__file__).with_name("deploy_network.sh")
    command = ["unshare", "--net", "bash", str(script), sys.executable, "-B", __file__, starmesh, str(tmp_path)]
    # a proxy that is not there: nothing inside an observatory may ask it
    environment = {**os.environ, "http_proxy": "http://127.0.0.1:9", "HTTP_PROXY": "http://127.0.0.1:9"}
    done = subprocess.run(command, capture_output=True, text=True, timeout=240, env=environment)
    logs = "\n".join(f"--- {log.name}\n{log.read_text()[-4000:]}" for log in sorted(tmp_path.glob("*.log")))
    assert done.returncode == 0, f"{done.stdout}\n{done.stderr}\n{logs}"


class Network:
    """All processes of the three hosts; each host has a folder of its own."""

    def __init__(self, starmesh: str, folder: pathlib.Path):
        self.starmesh, self.folder, self.processes, self.ups = starmesh, folder, [], []

    def start(self):
        for host, name in HOSTS.items():
            here = self.folder / name
            here.mkdir()
            (here / f"{name}.toml").write_text(files()[f"{name}.toml"])
            for line in commands(host):
                process = self.type(line, here, f"{name}-{line.split()[1]}.log")
                if " up " in line:
                    self.ups.append(process)

    def type(self, line: str, here: pathlib.Path, log: str) -> subprocess.Popen:
        words = shlex.split(line)
        assert words[0] == "starmesh", line
        out = (self.folder / log).open("w")
        process = subprocess.Popen([self.starmesh, *words[1:]], cwd=here, stdout=out, stderr=out)
        self.processes.append(process)
        return process

    def end(self):
        for process in self.ups:
            process.send_signal(signal.SIGINT)
        for process in self.ups:
            try:
                process.wait(60)
            except subprocess.TimeoutExpired:
                process.kill()
        for process in self.processes:
            if process.poll() is None:
                process.terminate()
                process.wait(20)

    def log(self, name: str) -> str:
        return (self.folder / f"{name}-up.log").read_text()


def page(port: int) -> dict:
    """The network as one host's page shows it."""
    opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
    with opener.open(f"http://127.0.0.1:{port}/api/v1/network", timeout=5) as answer:
        return json.load(answer)


def until(what: str, limit_s: float, holds):
    """Waits for a level; fails with what was seen last."""
    end, last = time.monotonic() + limit_s, None
    while time.monotonic() < end:
        try:
            last = holds()
            if last is True:
                return
        except OSError as error:
            last = error
        time.sleep(0.5)
    raise AssertionError(f"{what}: not within {limit_s} s; the last look: {last}")


def all_meet():
    """Each of the three pages shows both telescopes fresh, all nodes, and the shared devices."""
    for port in (8080, 8081, 8082):
        seen = page(port)
        fresh = {t["telescope_id"]: t["quality"] for t in seen["telescopes"]}
        if fresh != {"callisto": "fresh", "europa": "fresh"}:
            return f"page {port}: {fresh}"
        for telescope in seen["telescopes"] + seen["shared"]:
            roles = sorted(node["role"] for node in telescope["nodes"] if node["quality"] == "fresh")
            wanted = sorted(set(ROLES) - ({"observatory"} if telescope["shared"] else set()))
            if sorted(set(roles)) != wanted:
                return f"page {port}: {telescope['telescope_id']} has {roles}"
            if telescope["device_count"]["lost"] or not telescope["device_count"]["known"]:
                return f"page {port}: {telescope['telescope_id']} has {telescope['device_count']}"
    return True


def monitor_is_received():
    """Each telescope hears the shared monitor: its verdict names it neither missing nor stale."""
    for port, name in ((8081, "callisto"), (8082, "europa")):
        opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
        with opener.open(f"http://127.0.0.1:{port}/api/v1/telescopes/paranal/{name}", timeout=5) as answer:
            state = json.load(answer)["states"].get(f"paranal/{name}/observatory/safety/state", {}).get("body", {})
        inputs = {i["input"]: i for i in state.get("inputs", [])}
        for wanted in ("site-monitor", "mast"):
            received = [i for input, i in inputs.items() if wanted in input and i.get("age_s") is not None]
            if not any(i["age_s"] < 15 for i in received):
                return f"{name} does not hear {wanted}: {json.dumps(state)[:600]}"
    return True


def audited(folder: pathlib.Path) -> dict[str, int]:
    """How many records each node has in its own file."""
    return {str(file.relative_to(folder)): len(file.read_text().splitlines()) for file in folder.glob("*/data/audit-*.jsonl")}


def look(starmesh: str):
    """Somebody reads everything, three times over."""
    for _ in range(3):
        tail = subprocess.Popen([starmesh, "tail", "--connect", "tcp/10.0.0.5:7447", "--no-multicast"],
                                stdout=subprocess.PIPE, text=True)
        time.sleep(4)
        tail.terminate()
        printed, _ = tail.communicate(timeout=10)
        for name in HOSTS.values():
            assert f"paranal/{name}/" in printed, f"`starmesh tail` shows nothing of {name}"


def run(starmesh: str, folder: pathlib.Path):
    network = Network(starmesh, folder)
    try:
        network.start()
        until("all nodes of three hosts meet", 90, all_meet)
        until("both telescopes hear the shared monitor and station", 60, monitor_is_received)
        before = audited(folder)
        assert len(before) >= 3, before
        look(starmesh)
        assert audited(folder) == before, "a look was noted as an order"
        closed = subprocess.run([starmesh, "order", "paranal/callisto", "close", "--connect", "tcp/10.0.0.12:7447",
                                 "--no-multicast"], capture_output=True, text=True, timeout=60)
        assert closed.returncode == 0, closed.stderr
        assert closed.stdout.startswith("accepted") and closed.stdout.splitlines()[-1] == "verified closed"
        # noting an order never waits for a disk
        until("the order is noted", 20, lambda: sum(audited(folder).values()) > sum(before.values()))
        words = shlex.split(status_command())
        printed = subprocess.run([starmesh, *words[1:]], capture_output=True, text=True, timeout=30, check=True).stdout
        assert "paranal/callisto" in printed and "paranal/europa" in printed, printed
        for name in HOSTS.values():
            log = network.log(name)
            assert "next start" not in log, f"a node of {name} ended by itself:\n{log}"
            noise = [line for line in log.splitlines() if re.search(r"zenoh|expr|locator|wire", line)]
            assert not noise, f"{name} prints what no operator can act on:\n" + "\n".join(noise)
    finally:
        network.end()


if __name__ == "__main__":
    run(sys.argv[1], pathlib.Path(sys.argv[2]))
