#!/usr/bin/env python3
"""Breaks one thing after another at real nodes and checks at the simulator what came of it; see docs/reliability.md.

    run.py                     the short form: each short case once
    run.py --count 1000        cases again and again in random order, with random pairs
    run.py --only WORD         cases whose name, class or hazards contain WORD

A case that fails is injected again, alone. It fails if it fails twice; else it depends on load. Both are printed.
"""

import argparse
import json
import os
import pathlib
import queue
import random
import signal
import sys
import threading
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))
PROJECT = pathlib.Path(__file__).resolve().parents[2]


def alone():
    """Everything runs in network and mount namespaces of its own: nothing here reaches the host's."""
    if "STARMESH_FAULTS_ALONE" in os.environ:
        return
    os.environ["STARMESH_FAULTS_ALONE"] = "1"
    mapped = [] if os.geteuid() == 0 else ["--map-root-user"]
    inside = ["sh", "-c", 'ip link set lo up && exec "$@"', "sh", sys.executable, "-B", *sys.argv]
    os.execvp("unshare", ["unshare", *mapped, "--net", "--mount", *inside])


def run_all(threads: list[threading.Thread]):
    """Starts them and waits for their ends, so that an interrupt is heard meanwhile."""
    for thread in threads:
        thread.start()
    for thread in threads:
        while thread.is_alive():
            thread.join(0.5)


def lanes(cases, harnesses: int):
    """Cases by flavour; the plain ones are shared by all."""
    special: dict[str, list] = {}
    plain: queue.SimpleQueue = queue.SimpleQueue()
    for case in cases:
        if case.flavour == "plain":
            plain.put(case)
        else:
            special.setdefault(case.flavour, []).append(case)
    return special, plain


class Runner:
    """Some harnesses beside each other, since waiting is most of the work."""

    def __init__(self, binary: str, cases, harnesses: int, allowance_s: float, loud: bool):
        from case import inject
        self.inject, self.binary, self.allowance_s, self.loud = inject, binary, allowance_s, loud
        self.special, self.plain = lanes(cases, harnesses)
        self.results, self.lock, self.failed = [], threading.Lock(), []
        self.harnesses, self.stop = harnesses, threading.Event()

    def run(self):
        threads = [threading.Thread(target=self.work, args=(n,), daemon=True) for n in range(self.harnesses)]
        try:
            run_all(threads)
        except KeyboardInterrupt:
            self.stop.set()
            for thread in threads:
                thread.join(60)
        return self.results

    def work(self, number: int):
        time.sleep(number * 1.0)  # processes that start all at once only get into each other's way
        try:
            while not self.stop.is_set():
                with self.lock:
                    flavour = next(iter(self.special), None)
                    waiting = self.special.pop(flavour) if flavour else None
                if waiting is None:
                    break
                todo = queue.SimpleQueue()
                for case in waiting:
                    todo.put(case)
                self.lane(flavour, number, todo)
            self.lane("plain", number, self.plain)
        except Exception as error:
            with self.lock:
                self.failed.append(f"harness {number}: {error!r}")

    def lane(self, flavour: str, number: int, todo: queue.SimpleQueue):
        import flavours
        harness, healthy, has_failed = None, False, False
        try:
            while not self.stop.is_set():
                try:
                    case = todo.get_nowait()
                except queue.Empty:
                    return
                if not healthy:
                    if harness:
                        harness.stop()
                    has_failed = False
                    harness = flavours.make(flavour, self.binary, f"{flavour}{number}")
                    harness.keep = True
                    harness.start_all()
                    harness.exposes()
                began = time.monotonic()
                result = self.inject(case, harness, self.allowance_s)
                # what has failed may still be under way in it: the next case gets a new one
                healthy = result.passed and result.went_on is not False and not case.leave
                harness.keep = has_failed = has_failed or not result.passed
                self.note(result, time.monotonic() - began)
        finally:
            if harness:
                harness.stop()

    def note(self, result, seconds: float):
        with self.lock:
            self.results.append(result)
            took = "-" if result.took_s is None else f"{result.took_s:.2f} s"
            word = "ok  " if result.passed else "FAIL"
            print(f"{word} {time.strftime('%H:%M:%S')} {result.harness:8} {seconds:5.1f} s  first request {took:>8}  "
                  f"{result.case.name}" + (f"\n     {result.why}" if result.why else ""), flush=True)
            if result.words and self.loud:
                print(result.words, flush=True)


def chosen(arguments, cases):
    if arguments.only:
        words = [word.lower() for word in arguments.only]
        texts = [f"{c.name} {c.group} {' '.join(c.hazards)} {c.flavour}".lower() for c in cases]
        cases = [c for c, text in zip(cases, texts) if any(word in text for word in words)]
    elif not arguments.count:
        cases = [c for c in cases if c.short]
    if not arguments.count:
        return cases
    from pairs import paired
    chance = random.Random(arguments.seed)
    picked = []
    while len(picked) < arguments.count:
        lap = list(cases)
        chance.shuffle(lap)
        picked += [paired(c, chance) for c in lap]
    return picked[:arguments.count]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=0, help="so many injections, at random; 0: the short form")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--telescopes", type=int, default=6, help="telescopes next to each other")
    parser.add_argument("--only", action="append", help="cases that contain this word")
    parser.add_argument("--results", type=pathlib.Path, metavar="FILE", help="each result as JSON, for scripts/proof")
    parser.add_argument("--allowance", type=float, default=None, metavar="S",
                        help="added to each bound for a busy machine; 1 in the short form, else 0")
    parser.add_argument("--list", action="store_true", help="print the cases and stop")
    parser.add_argument("--quiet", action="store_true", help="without the nodes' last words after a failure")
    arguments = parser.parse_args()
    binary = pathlib.Path(os.environ.get("STARMESH_BIN", PROJECT / "target" / "debug" / "starmesh"))
    if not binary.exists():
        print(f"{binary} is missing: cargo build --workspace", file=sys.stderr)
        return 2
    if not arguments.list:
        alone()
    import cases_all
    import table
    from hazards import HAZARDS
    cases_all.attack(1000 if arguments.count else 200)
    cases = chosen(arguments, cases_all.CASES)
    if arguments.list:
        for c in cases:
            print(f"{c.flavour:6} {' '.join(c.hazards):14} {c.group[:40]:40} {c.name}")
        used = {code for c in cases for code in c.hazards}
        print(*(f"{code:4} {what}" for code, what in HAZARDS.items() if code in used), f"{len(cases)} cases", sep="\n")
        return 0
    allowance_s = arguments.allowance if arguments.allowance is not None else (0.0 if arguments.count else 1.0)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    began = time.monotonic()
    runner = Runner(str(binary), cases, arguments.telescopes, allowance_s, not arguments.quiet)
    runner.run()
    results = runner.results
    minutes = (time.monotonic() - began) / 60
    failed, passed_alone = [r for r in results if not r.passed], set()
    for result in failed:
        print(f"again, alone: {result.case.name}", flush=True)
        second = Runner(str(binary), [result.case], 1, allowance_s, not arguments.quiet)
        if all(again.passed for again in second.run()) and not second.failed:
            passed_alone.add(id(result))
    print()
    print("\n".join(table.rows(results, allowance_s)))
    print()
    print(table.dark_time(results))
    print(table.hazards(results))
    line, is_within = table.p99_over_all(results, allowance_s)
    print(line)
    for result in failed:
        word = "DEPENDS ON LOAD" if id(result) in passed_alone else "FAILED"
        print(f"{word}: {result.case.name}: {result.why.splitlines()[-1]}")
    for line in runner.failed:
        print("FAILED:", line)
    if arguments.results:
        arguments.results.write_text(json.dumps(
            [{"case": r.case.name, "why": r.why, "late_s": table.late_s(r), "alone": id(r) in passed_alone} for r in results]))
    missing = len(cases) - len(results)
    print(f"{len(results)} injections in {minutes:.1f} min on {os.cpu_count()} cores, seed {arguments.seed}; "
          f"{len(failed)} failed, {len(passed_alone)} of them passed alone" + (f", {missing} NOT RUN" if missing else ""))
    return 1 if len(failed) > len(passed_alone) or runner.failed or missing or not is_within else 0


if __name__ == "__main__":
    sys.exit(main())
