"""Every way a device node of an enclosure can fail to start, judged at an open dome while nobody mends it."""

import contextlib
import os
import shutil
import socket
import threading
import time

from case import DOME_NODE, GUARD_PROCESS, case
from rig import Late, command_line, free_port, wait

START = "a slip in the configuration or on disk, and a restart: the guard process closes"
HARMLESS = "a slip that is another node's, and a restart of the dome's: nothing closes"
SURVIVES = "guard process or device node killed alone: nothing closes"
LIFE_S = 8.0


@contextlib.contextmanager
def changed(path, change):
    """A file, such as the configuration, as somebody saves it in the middle of the night; put right in the end."""
    whole = path.read_text()
    path.write_text(change(whole))
    try:
        yield
    finally:
        path.write_text(whole)


def restart_both(rig):
    """As a supervisor does after a crash of both processes, or a package upgrade without a stop."""
    rig.kill("dome")
    rig.start("dome")


def slip(change, only_node: bool = False):
    def run(rig):
        with changed(rig.configuration, change):
            if only_node:
                rig.kill_guarded()
            else:
                restart_both(rig)
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
def removed(rig):
    path = rig.configuration
    away = path.with_suffix(".away")
    path.rename(away)
    try:
        restart_both(rig)
        yield
    finally:
        away.rename(path)


@case("half-written token file, and the dome's processes restart", "N4 F2", GUARD_PROCESS, group=START)
def half_tokens(rig):
    with changed(rig.data / "tokens-alpha-dome.json", half):
        restart_both(rig)
        yield


@case("the dome has moved to another address and nobody answers at the old one, then a half-written token file and a restart",
      "N4 F1 F2", GUARD_PROCESS, group=START)
def moved_and_half_tokens(rig):
    port = free_port()
    rig.spawn("neighbour", [rig.binary, "simulator", "--bind", f"127.0.0.1:{port}", "--size-px", "64"])
    ours = f'name = "dome"\nserver = "{rig.wire.address}"'
    try:
        with changed(rig.configuration, lambda text: text.replace(ours, f'name = "dome"\nserver = "127.0.0.1:{port}"')):
            restart_both(rig)
            wait("the last-good copy names the old address", lambda: str(port) in copy_of(rig), 30)
    finally:
        rig.end("neighbour")
    restart_both(rig)
    rig.exposes(120.0)
    with changed(rig.data / "tokens-alpha-dome.json", half):
        rig.mark()
        restart_both(rig)
        yield


def copy_of(rig) -> str:
    """What the guard process needs to close the dome, as it is on disk."""
    path = rig.configuration.with_name(f".{rig.configuration.name}.dome.guard")
    return path.read_text() if path.exists() else ""


@case("data folder gone and its place taken, and the dome's processes restart", "N4 F2", GUARD_PROCESS, group=START)
def no_data(rig):
    away = rig.data.with_name("data-away")
    rig.data.rename(away)
    rig.data.write_text("a file where the folder was")
    try:
        restart_both(rig)
        yield
    finally:
        rig.data.unlink()
        away.rename(rig.data)


def binds(listener, port: int) -> bool:
    try:
        listener.bind(("127.0.0.1", port))
    except OSError:
        return False
    return True


@case("dome's device node cannot listen where it is told to, and its processes restart: it listens elsewhere", "N4 N8", group=HARMLESS,
      may_close=True, watch_s=12.0)
def listen_taken(rig):
    rig.kill("dome")
    with socket.socket() as taken:
        taken.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        # the sockets of the processes that were killed are gone a moment later
        wait("the port is free", lambda: binds(taken, rig.ports["dome"]), 10)
        taken.listen()
        rig.start("dome")
        wait("the dome's device node guards", lambda: rig.guarded("dome"), 10)
        yield


@case("spool port taken, and the dome's processes restart", "N4 N8", group=HARMLESS, may_close=True, watch_s=12.0)
def spool_taken(rig):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with changed(rig.configuration, lambda text: text.replace(f"{rig.host('hands')}:0", f"127.0.0.1:{port}")):
            restart_both(rig)
            wait("the dome's device node guards", lambda: rig.guarded("dome"), 10)
            node = rig.guarded("dome")[0]
            time.sleep(6.0)
            if rig.guarded("dome") != [node]:
                raise Late("a spool's port ended the dome's device node")
            yield


@contextlib.contextmanager
def crash_loop(rig, kill, start, life_s: float):
    """Lives of so many seconds, one after another, until the case is over."""
    over = threading.Event()

    def loop():
        while not over.is_set():
            if over.wait(life_s):
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
def crash_loop_of_both(rig):
    rig.kill("observatory")
    mark = rig.t0

    def kill():
        rig.kill("dome")
        rig.t0 = mark
    with crash_loop(rig, kill, lambda: rig.start("dome"), LIFE_S):
        yield


@case("crash loop of the dome's device node with lives of 3 s, and nobody permits", "N4 N15", DOME_NODE)
def crash_loop_of_node(rig):
    rig.kill("observatory")
    mark = rig.t0

    def kill():
        rig.kill_guarded()
        rig.t0 = mark
    with crash_loop(rig, kill, lambda: None, 3.0):
        yield


@case("guard process killed alone and restarted", "N4", group=SURVIVES, watch_s=14.0, may_close=True)
def guard_process_killed(rig):
    before = rig.guarded("dome")
    rig.kill_guard_process()
    time.sleep(2.0)
    if not all(command_line(pid) for pid in before):
        raise Late("the device node has ended with its guard process")
    rig.start("dome")
    wait("the device node has left to the new guard process", lambda: not any(command_line(pid) for pid in before), 10)
    yield


@case("guard process killed alone for good, and then nobody permits", "N4 N1", DOME_NODE)
def guard_process_gone(rig):
    before = rig.guarded("dome")
    rig.kill_guard_process()
    rig.kill("observatory")
    yield
    for pid in before:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, 9)


@case("device node killed alone", "N4", group=SURVIVES, watch_s=14.0, may_close=True)
def node_killed(rig):
    rig.kill_guarded()
    yield


@case("device node killed alone, and it cannot start again", "N4", GUARD_PROCESS)
def node_gone(rig):
    with changed(rig.configuration, half):
        rig.kill_guarded()
        yield


@case("a second guard process for the same file", "N14", group=SURVIVES, watch_s=6.0)
def second_guard_process(rig):
    rig.spawn("second", rig.command("dome"))
    time.sleep(3.0)
    if rig.guarded("second"):
        raise Late("two guard processes of one file run a device node each")
    yield
    rig.end("second")


@case("last-good copies gone while the dome is open, and the configuration is broken", "N4 F2", GUARD_PROCESS, group=START)
def copies_spoilt(rig):
    """The guard process itself has the copy in memory; only a restart would need the file."""
    for path in rig.folder.glob(".observatory.toml.dome.*"):
        if not path.name.endswith("lock"):
            shutil.copy(path, rig.folder / f"kept{path.name}")
            path.write_bytes(path.read_bytes()[:20])
    with changed(rig.configuration, half):
        rig.kill_guarded()
        yield


@case("the disk of the configuration hangs, and the dome's device node is killed", "F1 N4", GUARD_PROCESS, group=START)
def hanging_disk(rig):
    # who opens a pipe that nobody writes to waits as long as on a disk that hangs
    away = rig.configuration.with_suffix(".away")
    rig.configuration.rename(away)
    os.mkfifo(rig.configuration)
    try:
        rig.kill_guarded()
        rig.mark()
        yield
    finally:
        # whoever waits reads the end of an empty file
        with contextlib.suppress(OSError):
            os.close(os.open(rig.configuration, os.O_WRONLY | os.O_NONBLOCK))
        away.replace(rig.configuration)


@case("the configuration names another dome that answers, and the dome's processes restart: the old one is closed", "F1 D9",
      DOME_NODE, group=START)
def another_dome(rig):
    port = free_port()
    rig.spawn("neighbour", [rig.binary, "simulator", "--bind", f"127.0.0.1:{port}", "--size-px", "64"])
    ours = f'name = "dome"\nserver = "{rig.wire.address}"'
    try:
        with changed(rig.configuration, lambda text: text.replace(ours, f'name = "dome"\nserver = "127.0.0.1:{port}"')):
            restart_both(rig)
            yield
        restart_both(rig)
    finally:
        rig.end("neighbour")
