"""Every way a device node of an enclosure can fail to start, judged at an open dome while nobody mends it."""

import contextlib
import os
import pathlib
import shutil
import signal
import socket
import threading
import time

from case import DOME_NODE, END_CLOSES, GUARD_PROCESS, case
from harness import Late, command_line, free_port, wait

START = "a mistake in the configuration or on disk, and a restart: the guard process closes"
HARMLESS = "a mistake that is another node's, and a restart of the dome's: nothing closes"
SURVIVES = "guard process or device node killed alone: nothing closes"
RUN_S = 8.0


@contextlib.contextmanager
def changed(path, change):
    """A file, such as the configuration, as somebody saves it in the middle of the night; put right in the end."""
    whole = path.read_text()
    path.write_text(change(whole))
    try:
        yield
    finally:
        path.write_text(whole)


def restart_both(harness):
    """As a supervisor does after a crash of both processes, or a package upgrade without a stop."""
    harness.kill("dome")
    harness.start("dome")


def slip(change, only_node: bool = False):
    def run(harness):
        with changed(harness.configuration, change):
            if only_node:
                harness.kill_guarded()
            else:
                restart_both(harness)
            yield
    return run


def in_camera(text: str) -> str:
    return text.replace('name = "camera"\n', 'name = "camera"\ntemperature = -20\n')


def half(text: str) -> str:
    return text[:len(text) // 2]


def no_dome(text: str) -> str:
    before, after = text.split("[[dome]]", 1)
    return before + after[after.index("[["):]


case("slip in a camera's block, and the dome's processes restart", "N4 F1", GUARD_PROCESS, group=START)(slip(in_camera))
case("slip in a camera's block, and the dome's device node restarts", "N4 F1", GUARD_PROCESS, group=START)(
    slip(in_camera, only_node=True))
case("half-saved configuration, and the dome's processes restart", "N4 F1", GUARD_PROCESS, group=START)(slip(half))
case("empty configuration, and the dome's device node restarts", "N4 F1", GUARD_PROCESS, group=START, short=False)(
    slip(lambda _: "", only_node=True))
case("the dome's block is gone from the configuration", "N4 F1", GUARD_PROCESS, group=START)(slip(no_dome))
case("a character that is no UTF-8 in the configuration", "N4 F1", GUARD_PROCESS, group=START, short=False)(
    slip(lambda text: "\ufeff\x00" + text))


@case("the configuration has been removed, and the dome's processes restart", "N4 F1", GUARD_PROCESS, group=START)
def removed(harness):
    path = harness.configuration
    away = path.with_suffix(".away")
    path.rename(away)
    try:
        restart_both(harness)
        yield
    finally:
        away.rename(path)


@case("half-written token file, and the dome's processes restart", "N4 F2", GUARD_PROCESS, group=START)
def half_tokens(harness):
    with changed(harness.data / "tokens-alpha-dome.json", half):
        restart_both(harness)
        yield


def moved(harness):
    """The dome's address has been changed and changed back; nobody answers at the one of the meantime any more."""
    port = free_port()
    harness.spawn("neighbour", [harness.binary, "simulator", "--bind", f"127.0.0.1:{port}", "--size-px", "64"])
    ours = f'name = "dome"\nserver = "{harness.wire.address}"'
    try:
        with changed(harness.configuration, lambda text: text.replace(ours, f'name = "dome"\nserver = "127.0.0.1:{port}"')):
            restart_both(harness)
            wait("the last-good copy names the old address", lambda: str(port) in copy_of(harness), 30)
    finally:
        harness.end("neighbour")
    since = harness.wire.last()
    restart_both(harness)
    wait("the dome's device node has a permit again: it feeds the watchdog", lambda: harness.puts("action", since), 30)
    harness.exposes()


@case("the dome has moved to another address and nobody answers at the old one, then a half-written token file and a restart",
      "N4 F1 F2", GUARD_PROCESS, group=START)
def moved_and_half_tokens(harness):
    moved(harness)
    with changed(harness.data / "tokens-alpha-dome.json", half):
        harness.mark()
        restart_both(harness)
        yield


@case("the dome has moved to another address and nobody answers at the old one, then its device node is ended by SIGTERM",
      "N4 F1", END_CLOSES)
def moved_and_ended(harness):
    moved(harness)
    harness.mark()
    harness.signal(signal.SIGTERM, "dome")
    yield
    # An address at which nobody answers holds nobody up.
    harness.processes["dome"].wait(timeout=30)


@case("the dome's processes restart and are ended by SIGTERM before they have begun to work", "N4", END_CLOSES)
def ended_at_start(harness):
    restart_both(harness)
    # A process takes signals from the first lines of its program on; before these the system ends it.
    wait("the process is the program", lambda: handles_sigterm(harness.processes["dome"].pid), 5, 0.001)
    harness.mark()
    harness.signal(signal.SIGTERM, "dome")
    yield
    harness.processes["dome"].wait(timeout=30)


def handles_sigterm(pid: int) -> bool:
    """Has the process its own handler of SIGTERM?"""
    status = pathlib.Path(f"/proc/{pid}/status").read_text()
    mask = next(line for line in status.splitlines() if line.startswith("SigCgt:")).split()[1]
    return bool(int(mask, 16) >> (signal.SIGTERM - 1) & 1)


def copy_of(harness) -> str:
    """What the guard process needs to close the dome, as it is on disk."""
    path = harness.configuration.with_name(f".{harness.configuration.name}.dome.guard")
    return path.read_text() if path.exists() else ""


@case("data folder gone and its place taken, and the dome's processes restart", "N4 F2", GUARD_PROCESS, group=START)
def no_data(harness):
    away = harness.data.with_name("data-away")
    harness.data.rename(away)
    harness.data.write_text("a file where the folder was")
    try:
        restart_both(harness)
        yield
    finally:
        harness.data.unlink()
        away.rename(harness.data)


def binds(listener, port: int) -> bool:
    try:
        listener.bind(("127.0.0.1", port))
    except OSError:
        return False
    return True


@case("dome's device node cannot listen at its address, and its processes restart: it listens elsewhere", "N4 N8", group=HARMLESS,
      may_close=True, watch_s=12.0)
def listen_taken(harness):
    harness.kill("dome")
    with socket.socket() as taken:
        taken.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        # the sockets of the processes that were killed are gone a moment later
        wait("the port is free", lambda: binds(taken, harness.ports["dome"]), 10)
        taken.listen()
        harness.start("dome")
        wait("the dome's device node guards", lambda: harness.guarded("dome"), 10)
        yield


@case("spool port taken, and the dome's processes restart", "N4 N8", group=HARMLESS, may_close=True, watch_s=12.0)
def spool_taken(harness):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with changed(harness.configuration, lambda text: text.replace(f"{harness.host('hands')}:0", f"127.0.0.1:{port}")):
            restart_both(harness)
            wait("the dome's device node guards", lambda: harness.guarded("dome"), 10)
            node = harness.guarded("dome")[0]
            time.sleep(6.0)
            if harness.guarded("dome") != [node]:
                raise Late("a spool's port ended the dome's device node")
            yield


@contextlib.contextmanager
def crash_loop(harness, kill, start, run_s: float):
    """Runs of so many seconds, one after another, until the case is over."""
    over = threading.Event()

    def loop():
        while not over.is_set():
            if over.wait(run_s):
                return
            kill()
            time.sleep(1.0)
            start()
    thread = threading.Thread(target=loop, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join(20)


@case("crash loop of both of the dome's processes with lives of 8 s, and nobody permits", "N4 N15", DOME_NODE)
def crash_loop_of_both(harness):
    harness.kill("observatory")
    mark = harness.t0

    def kill():
        harness.kill("dome")
        harness.t0 = mark
    with crash_loop(harness, kill, lambda: harness.start("dome"), RUN_S):
        yield


@case("crash loop of the dome's device node with lives of 3 s, and nobody permits", "N4 N15", DOME_NODE)
def crash_loop_of_node(harness):
    harness.kill("observatory")
    mark = harness.t0

    def kill():
        harness.kill_guarded()
        harness.t0 = mark
    with crash_loop(harness, kill, lambda: None, 3.0):
        yield


@case("guard process killed alone and restarted", "N4", group=SURVIVES, watch_s=14.0, may_close=True)
def guard_process_killed(harness):
    before = harness.guarded("dome")
    harness.kill_guard_process()
    time.sleep(2.0)
    if not all(command_line(pid) for pid in before):
        raise Late("the device node has ended with its guard process")
    harness.start("dome")
    wait("the device node has left to the new guard process", lambda: not any(command_line(pid) for pid in before), 10)
    yield


@case("guard process killed alone for good, and then nobody permits", "N4 N1", DOME_NODE)
def guard_process_gone(harness):
    before = harness.guarded("dome")
    harness.kill_guard_process()
    harness.kill("observatory")
    yield
    for pid in before:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, 9)


@case("device node killed alone", "N4", group=SURVIVES, watch_s=14.0, may_close=True)
def node_killed(harness):
    harness.kill_guarded()
    yield


@case("device node killed alone, and it cannot start again", "N4", GUARD_PROCESS)
def node_gone(harness):
    with changed(harness.configuration, half):
        harness.kill_guarded()
        yield


@case("a second guard process for the same file", "N14", group=SURVIVES, watch_s=6.0)
def second_guard_process(harness):
    harness.spawn("second", harness.command("dome"))
    time.sleep(3.0)
    if harness.guarded("second"):
        raise Late("two guard processes of one file run a device node each")
    yield
    harness.end("second")


@case("last-good copies gone while the dome is open, and the configuration is broken", "N4 F2", GUARD_PROCESS, group=START)
def copies_spoilt(harness):
    """The guard process itself has the copy in memory; only a restart would need the file."""
    for path in harness.folder.glob(".observatory.toml.dome.*"):
        if not path.name.endswith("lock"):
            shutil.copy(path, harness.folder / f"kept{path.name}")
            path.write_bytes(path.read_bytes()[:20])
    with changed(harness.configuration, half):
        harness.kill_guarded()
        yield


@case("the disk of the configuration hangs, and the dome's device node is killed", "F1 N4", GUARD_PROCESS, group=START)
def hanging_disk(harness):
    # who opens a pipe that nobody writes to waits as long as on a disk that hangs
    away = harness.configuration.with_suffix(".away")
    harness.configuration.rename(away)
    os.mkfifo(harness.configuration)
    try:
        harness.kill_guarded()
        harness.mark()
        yield
    finally:
        # whoever waits reads the end of an empty file
        with contextlib.suppress(OSError):
            os.close(os.open(harness.configuration, os.O_WRONLY | os.O_NONBLOCK))
        away.replace(harness.configuration)


@case("the configuration names another dome that answers, and the dome's processes restart: the old one is closed", "F1 D9",
      DOME_NODE, group=START)
def another_dome(harness):
    port = free_port()
    harness.spawn("neighbour", [harness.binary, "simulator", "--bind", f"127.0.0.1:{port}", "--size-px", "64"])
    ours = f'name = "dome"\nserver = "{harness.wire.address}"'
    try:
        with changed(harness.configuration, lambda text: text.replace(ours, f'name = "dome"\nserver = "127.0.0.1:{port}"')):
            restart_both(harness)
            yield
        restart_both(harness)
    finally:
        harness.end("neighbour")
