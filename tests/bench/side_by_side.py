#!/usr/bin/env python3
"""Measures Starmesh and its predecessor on the same simulators; see README.md beside this file. Standard library only."""

import contextlib
import http.client
import os
import pathlib
import random
import signal
import statistics
import sys
import tempfile
import time

from loopback import wait
from run import cpu_s, pss_mib
from systems import BINARY, Site, install, predecessor, session, starmesh, write_catalogue

SETTLE_S = 15.0
FOLDER = pathlib.Path(tempfile.gettempdir()) / f"starmesh-side-by-side-{os.getpid()}"


@contextlib.contextmanager
def started(program, **exposures):
    """A site whose program answers and does what it was given to do."""
    with contextlib.ExitStack() as ends:
        site = Site(program, FOLDER, ends)
        site.exposures = exposures
        site.start()
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
            site.set_safe(True)
            wait("it exposes", lambda: site.get("dome/0/shutterstatus") == 0 and site.get("camera/0/camerastate") == 2, 180, 0.5)
            time.sleep(6 + 5 * chance.random())
            began_s = site.set_safe(False)
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
    write_catalogue(FOLDER)
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
