#!/usr/bin/env python3
"""Breaks one thing after another at Starmesh and at its predecessor, and prints both columns; see docs/reliability.md.

    predecessor.py                 all faults that both can take
    predecessor.py --only WORD     those whose name contains WORD
"""

import argparse
import contextlib
import http.client
import os
import pathlib
import queue
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
import traceback

from run import alone, run_all

STARTS = 3  # the predecessor's watchdog sometimes dies in a race at its start; see docs/reliability.md


class Runner:
    """Some sites of each system beside each other, since waiting is most of the work."""

    def __init__(self, folder: pathlib.Path, cases: dict, limit_s: float, heal_s: float):
        self.folder, self.cases, self.limit_s, self.heal_s = folder, cases, limit_s, heal_s
        self.outcomes: dict[tuple, object] = {}
        self.ends: list[contextlib.ExitStack] = []
        self.stop, self.lock = threading.Event(), threading.Lock()
        # one at a time: ten processes that import their libraries are all that two cores can carry
        self.starting = {name: threading.Lock() for name in ("starmesh", "predecessor")}

    def run(self, lanes: dict):
        threads = []
        for program, count in lanes.items():
            todo: queue.SimpleQueue = queue.SimpleQueue()
            for name in self.cases:
                todo.put(name)
            for number in range(count):
                threads.append(threading.Thread(target=self.lane, args=(program, number, todo), daemon=True))
        try:
            run_all(threads)
        except KeyboardInterrupt:
            self.stop.set()
        finally:
            for ends in self.ends:
                ends.pop_all().close()

    def lane(self, program, number: int, todo: queue.SimpleQueue):
        """Case after case on one site; after a night that did not go on, on a new one."""
        import systems
        folder = self.folder / f"{program.__name__}{number}"
        folder.mkdir()
        systems.write_catalogue(folder)
        ends, site = contextlib.ExitStack(), None
        self.ends.append(ends)
        while not self.stop.is_set():
            try:
                name = todo.get_nowait()
            except queue.Empty:
                return
            site, outcome = self.measure(program, folder, name, site, ends)
            self.note(program, name, outcome)
            if site and outcome.went_on_s is None and not site.restarted_by_hand():
                ends.pop_all().close()
                site = None

    def measure(self, program, folder, name: str, site, ends):
        import both
        outcome = None
        for _ in range(STARTS):
            if self.stop.is_set():
                break
            try:
                if site is None:
                    site = both.FaultSite(program, folder, ends)
                    with self.starting[program.__name__]:
                        site.start()
                return site, both.inject(self.cases[name], site, self.limit_s, self.heal_s)
            except (SystemExit, OSError, http.client.HTTPException) as failure:
                outcome = both.Outcome(not_run=str(failure))
            except Exception:
                outcome = both.Outcome(not_run=traceback.format_exc(limit=-2))
            self.report(f"again with a new site: {program.__name__}, {name}: {outcome.not_run}")
            if keep := os.environ.get("KEEP_LOGS"):
                shutil.copytree(site.folder, pathlib.Path(keep) / f"{site.folder.name}", ignore=shutil.ignore_patterns("disk"))
            ends.pop_all().close()
            site = None
        return None, outcome or both.Outcome(not_run="stopped")

    def note(self, program, name: str, outcome):
        self.outcomes[name, program.__name__] = outcome
        self.report(f"{time.strftime('%H:%M:%S')} {program.__name__:11} {name}: {outcome.not_run or cell(outcome, self.limit_s)}, "
                    f"{'closed' if outcome.closed else 'open'}, night {went_on(outcome)}")

    def report(self, words: str):
        with self.lock:
            print(words, file=sys.stderr, flush=True)


def cell(outcome, limit_s: float) -> str:
    if outcome.not_run:
        return "not run"
    return f"never in {limit_s:.0f}" if outcome.took_s is None else f"{outcome.took_s:.2f}"


def went_on(outcome) -> str:
    if outcome.not_run:
        return "-"
    if outcome.never_closed:
        return "never closed"
    return "no" if outcome.went_on_s is None else f"after {outcome.went_on_s:.0f} s"


def rows(cases, outcomes: dict, limit_s: float) -> list[str]:
    lines = ["| fault | first `closeshutter`, s: Starmesh | predecessor | ratio | ended closed: Starmesh | predecessor "
             "| healed, the night went on: Starmesh | predecessor |", "|---|--:|--:|--:|---|---|---|---|"]
    both = [(name, outcomes[name, "starmesh"], outcomes[name, "predecessor"]) for name in cases]
    for name, ours, theirs in both:
        ratio = f"{theirs.took_s / ours.took_s:.1f}" if ours.took_s and theirs.took_s else "-"
        closed = ["-" if o.not_run else "yes" if o.closed else "**no**" for o in (ours, theirs)]
        lines.append(f"| {name} | {cell(ours, limit_s)} | {cell(theirs, limit_s)} | {ratio} | {closed[0]} | {closed[1]} "
                     f"| {went_on(ours)} | {went_on(theirs)} |")
    def count(holds):
        return [f"{sum(bool(holds(pair[side])) for pair in both)} of {sum(not pair[side].not_run for pair in both)}"
                for side in (1, 2)]
    began, closed = count(lambda o: o.took_s is not None), count(lambda o: o.closed)
    nights = count(lambda o: o.went_on_s is not None and not o.never_closed)
    lines.append(f"| **all** | {began[0]} | {began[1]} | | {closed[0]} | {closed[1]} | {nights[0]} | {nights[1]} |")
    return lines


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", action="append", help="faults that contain this word")
    parser.add_argument("--limit", type=float, default=80.0, metavar="S", help="so long the fault stands, for both")
    parser.add_argument("--heal", type=float, default=45.0, metavar="S", help="so long the night has to go on again, for both")
    parser.add_argument("--lanes", type=int, nargs=2, default=[1, 3], metavar="N", help="sites next to each other of each")
    parser.add_argument("--list", action="store_true", help="print the faults and stop")
    arguments = parser.parse_args()
    sys.path.append(str(pathlib.Path(__file__).resolve().parents[1] / "bench"))
    import systems
    from cases_both import CASES
    words = [word.lower() for word in arguments.only or [""]]
    cases = {name: run for name, run in CASES.items() if any(word in name.lower() for word in words)}
    if arguments.list:
        print("\n".join(cases))
        return 0
    if not systems.BINARY.exists():
        raise SystemExit(f"{systems.BINARY} is missing: cargo build --release --workspace, or STARMESH_BIN")
    systems.install()
    alone()
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # so that all that was started is ended
    # semaphores of processes that were killed end with this run
    subprocess.run(["mount", "-t", "tmpfs", "tmpfs", "/dev/shm"], check=True)
    folder = pathlib.Path(tempfile.mkdtemp(prefix="starmesh-predecessor-"))
    began = time.monotonic()
    runner = Runner(folder, cases, arguments.limit, arguments.heal)
    try:
        runner.run(dict(zip((systems.starmesh, systems.predecessor), arguments.lanes)))
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    measured = [name for name in cases if all((name, side) in runner.outcomes for side in ("starmesh", "predecessor"))]
    print("\n".join(rows(measured, runner.outcomes, arguments.limit)))
    missing = [key for key, outcome in runner.outcomes.items() if outcome.not_run]
    print(f"\n{len(measured)} of {len(cases)} faults, {len(missing)} columns not run, in {(time.monotonic() - began) / 60:.1f} min "
          f"on {os.cpu_count()} cores; load average {', '.join(f'{load:.1f}' for load in os.getloadavg())}")
    bad = [name for name in measured if not (ours := runner.outcomes[name, "starmesh"]).closed or ours.went_on_s is None]
    for name in bad:
        print(f"Starmesh FAILED: {name}")
    return 1 if bad or missing or len(measured) < len(cases) else 0


if __name__ == "__main__":
    sys.exit(main())
