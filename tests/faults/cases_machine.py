"""The machine under the nodes: clocks that jump, disks that are full or read-only, locks, no more files."""

import fcntl
import os
import pathlib
import sqlite3
import threading
import time

import exhaust
from case import MACHINE, MONITOR_SILENT, SILENCE, case
from harness import Late

WALL = {"flavour": "wall"}
NOTHING = "clock, disk or files, sky safe: nothing closes"
HOUR_S = 3600


def jump(node: str, seconds: int):
    """The wall clock of one node jumps under its feet (libfaketime; its monotonic clocks stay exact)."""
    def run(harness):
        harness.jump(node, seconds)
        time.sleep(4.0)
        harness.mark()
        harness.wire.change("safety", unsafe=True)
        yield
        harness.jump(node, 0)
        time.sleep(2.0)
    return run


def only_jump(node: str, seconds: int):
    def run(harness):
        harness.jump(node, seconds)
        yield
        harness.jump(node, 0)
        time.sleep(2.0)
    return run


for node, word in [("observatory", "observatory"), ("hands", "other device node"), ("dome", "dome's device node")]:
    for seconds in (HOUR_S, -HOUR_S):
        short = (node, seconds) in [("observatory", HOUR_S), ("dome", -HOUR_S)]
        case(f"clock of the {word} jumps by {seconds // HOUR_S:+d} h, then it is unsafe", "N17", MACHINE, short=short,
             **WALL)(jump(node, seconds))
        case(f"clock of the {word} jumps by {seconds // HOUR_S:+d} h", "N17", group=NOTHING, watch_s=6.0, exposes=False, **WALL,
             short=(node, seconds) in [("observatory", -HOUR_S), ("hands", HOUR_S)])(only_jump(node, seconds))


@case("clock of the other device node goes back 1 h, and it is restarted: the night goes on", "N17 N4",
      group="clock, disk or files: the night goes on", may_close=True, watch_s=0.0, **WALL)
def restarted_in_the_past(harness):
    harness.jump("hands", -HOUR_S)
    harness.restart("hands")
    time.sleep(3.0)
    harness.jump("hands", 0)  # the clock is right again; the name of its life stays an hour older than that of the one before
    harness.exposes()
    yield


@case("clock of the observatory goes back 1 h, and it is restarted: the night goes on", "N17 N1",
      group="clock, disk or files: the night goes on", may_close=True, watch_s=0.0, **WALL)
def observatory_in_the_past(harness):
    harness.jump("observatory", -HOUR_S)
    harness.restart("observatory")
    time.sleep(3.0)
    harness.jump("observatory", 0)
    harness.exposes()
    yield


@case("disk full, then it is unsafe", "N20 S10", MACHINE, **WALL)
def full_unsafe(harness):
    with exhaust.room(harness.data):
        time.sleep(3.0)
        harness.mark()
        harness.wire.change("safety", unsafe=True)
        yield


@case("disk full, then the observatory dies", "N20 N1", SILENCE, short=False, **WALL)
def full_dead(harness):
    with exhaust.room(harness.data):
        harness.kill("observatory")
        yield


@case("data folder read-only, then it is unsafe", "N21 S10", MACHINE, **WALL)
def read_only_unsafe(harness):
    with exhaust.writing(harness.data):
        time.sleep(3.0)
        harness.mark()
        harness.wire.change("safety", unsafe=True)
        yield


@case("data folder read-only, and the dome's device node restarts without a commander", "N21 N4 N19",
      SILENCE, short=False, **WALL)
def read_only_restart(harness):
    with exhaust.writing(harness.data):
        harness.kill("observatory", "dome")
        harness.restart("dome")
        yield


class Lock:
    """Holds the archive's database as another program would."""

    def __init__(self, path: pathlib.Path):
        self.ready, self.end = threading.Event(), threading.Event()

        def hold():
            database = sqlite3.connect(path, timeout=10)
            database.execute("BEGIN EXCLUSIVE")
            self.ready.set()
            self.end.wait(60)
            database.rollback()
            database.close()
        self.thread = threading.Thread(target=hold, daemon=True)
        self.thread.start()
        if not self.ready.wait(15):
            raise Late("the database could not be locked")

    def release(self):
        self.end.set()
        self.thread.join()


@case("database locked by another process", "N22 S10 N9", group=NOTHING, watch_s=8.0)
def locked(harness):
    lock = Lock(harness.data / "archive.db")
    yield
    lock.release()


def exhausted(node: str):
    def run(harness):
        with exhaust.files(harness.loops(node)):
            time.sleep(1.0)
            harness.mark()
            harness.wire.change("safety", unsafe=True)
            yield
    return run


case("dome's device node out of files, then it is unsafe", "N23", MACHINE)(exhausted("dome"))
case("observatory out of files, then it is unsafe", "N23", MACHINE)(exhausted("observatory"))
case("other device node out of files, then it is unsafe", "N23 S2", MONITOR_SILENT)(exhausted("hands"))


def nobody_reads(*nodes: str):
    """Their lines go into a pipe that is full: a stopped terminal (Ctrl-S), `| less`, a log collector that stands still."""
    def run(harness):
        read, write = os.pipe()
        fcntl.fcntl(write, fcntl.F_SETPIPE_SZ, 4096)
        os.write(write, b"." * 4096)
        try:
            for node in nodes:
                harness.end(node)
                harness.spawn(node, harness.command(node), out=write)
            harness.exposes(90.0)
            harness.mark()
            harness.wire.change("safety", unsafe=True)
            yield
            harness.wire.change("safety", unsafe=False)
            for node in nodes:
                harness.restart(node)
        finally:
            os.close(read)
            os.close(write)
    return run


case("nobody takes the lines of the observatory and of the dome's processes, and it is unsafe", "F1 F2", MACHINE)(
    nobody_reads("observatory", "dome"))
