"""Every row and every frame arrives, once, whatever was cut off or dead: judged by what a plain zenoh peer received.

Two archives on one bus. The first one is in a namespace of its own, whose link is cut; the second one has a
configuration of its own and is killed. `--outage-s 600` is the long form; `--short` is a part of `scripts/proof kills`.

    tests/faults/store_and_forward.py [--outage-s 12] [--only WORD | --short]
"""

import argparse
import contextlib
import datetime
import json
import os
import pathlib
import sqlite3
import subprocess
import sys
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "python"))

import zenoh

from bus_subscriber import BusSubscriber
from harness import PREFIX, ROLE, Late, wait
from network import NET, NetworkHarness
from wall_clock import WallClock

APART = "STARMESH_FORWARD_APART"
EPOCH = datetime.datetime(1970, 1, 1, tzinfo=datetime.UTC)


def micros(at: str) -> int:
    return (datetime.datetime.fromisoformat(at) - EPOCH) // datetime.timedelta(microseconds=1)


class Forward(NetworkHarness):
    """The archive meets the others over its own link only; a second archive runs on the bridge."""

    def __init__(self, binary: str, hold_min: float):
        self.hold_min = hold_min
        super().__init__(binary, "forward")
        self.clock = WallClock(self.folder / "shift")
        # everybody but the archive of the bridge and the link that is cut
        self.nft("flush ruleset")
        self.connect["observatory"] = [self.endpoint(node) for node in ("dome", "hands", "archive", "web")]
        self.second = self.folder / "second.toml"
        text = self.configuration.read_text()
        (self.folder / "second").mkdir()
        text = text.replace(f'data = "{self.data}"', f'data = "{self.folder / "second"}"\nimages = "{self.folder / "images2"}"')
        self.second.write_text(text.replace("[archive]\n", f'[archive]\ndatabase = "{self.folder / "second" / "archive.db"}"\n'))

    def write_config(self):
        super().write_config()
        text = self.configuration.read_text()
        text = text.replace("[spool]\n", f"[spool]\nhold_min = {self.hold_min}\n")
        self.configuration.write_text(text + '[archive]\nnodes = ["main", "second"]\n')

    def start(self, node: str, env: dict | None = None, limits: list[str] | None = None):
        clock = self.clock.environment if node == "hands" else {}
        super().start(node, {**clock, **(env or {})}, limits)

    def start_second(self):
        words = [word for node in ROLE for word in ("--connect", self.endpoint(node))]
        self.spawn("second", [self.binary, "node", "archive", "--id", "second", "--config", str(self.second),
                              "--listen", f"tcp/{NET}.1:0", *words, "--connect", self.endpoint("observatory")])

    def link(self, inward: str = "accept", outward: str = "accept"):
        """The rules of the first archive's own network."""
        text = f"""flush ruleset
table inet cut {{
  chain inward {{ type filter hook input priority 0; iifname "lo" accept; {inward}; }}
  chain outward {{ type filter hook output priority 0; oifname "lo" accept; {outward}; }}
}}
"""
        done = subprocess.run([*self.enter["archive"], "nft", "-f", "-"], input=text, capture_output=True, text=True)
        if done.returncode:
            raise RuntimeError(f"nft: {done.stderr.strip()}")

    def databases(self) -> dict[str, pathlib.Path]:
        return {"first": self.data / "archive.db", "second": self.folder / "second" / "archive.db"}


class Truth:
    """What was published, by a peer that was never cut off."""

    def __init__(self, harness: Forward):
        self.subscriber = BusSubscriber(harness.endpoint("hands"))

    def newest(self, key: str, boot: str) -> int:
        with self.subscriber._news:
            return max((payload["seq"] for at, payload in self.subscriber.received
                        if at == key and payload["boot_id"] == boot), default=-1)

    def published(self):
        with self.subscriber._news:
            received = list(self.subscriber.received)
        rows, lines, frames = {}, {}, set()
        for key, payload in received:
            chunks = key.removeprefix(PREFIX + "/").split("/")
            origin = (key, payload.get("boot_id"), payload.get("seq"))
            if chunks[0] == "device" and chunks[-1] == "state":
                for name, reading in payload["readings"].items():
                    rows.setdefault((chunks[1], chunks[2], name, micros(reading["at_utc"])), origin)
            elif chunks[-1] == "frame":
                frames.add(payload["id"])
            elif chunks[-1] == "diary":
                lines[(payload["boot_id"], payload["seq"])] = origin
        return rows, lines, frames


def has_tables(path: pathlib.Path) -> bool:
    with contextlib.suppress(sqlite3.OperationalError):
        stored(path)
        return True
    return False


def stored(path: pathlib.Path):
    with contextlib.closing(sqlite3.connect(f"file:{path}?mode=ro", uri=True, timeout=20)) as database:
        ask = lambda sql: database.execute(sql).fetchall()
        rows = [(kind.lower(), *rest) for kind, *rest in
                ask("SELECT device_type, device_name, device_command, at_us FROM samples JOIN series ON id = series")]
        lines = ask("SELECT boot_id, seq FROM log")
        frames = [id for id, in ask("SELECT frame_id FROM images")]
        gaps = ask("SELECT key, boot_id, why, samples, from_us, to_us FROM gaps")
        sums = ask("SELECT (SELECT count(*) FROM samples), (SELECT coalesce(sum(polled), 0) FROM minutes)")[0]
    assert len(set(lines)) == len(lines) and len(set(frames)) == len(frames), "a row is there twice"
    assert sums[0] == sums[1], f"values and minutes disagree: {sums}"
    return set(rows), set(lines), set(frames), gaps


def lacking(harness: Forward, truth: Truth, which: str):
    """What was published and is not stored, newest seconds left out."""
    rows, lines, frames = truth.published()
    has_rows, has_lines, has_frames, gaps = stored(harness.databases()[which])
    return ({row: origin for row, origin in rows.items() if row not in has_rows},
            {line: origin for line, origin in lines.items() if line not in has_lines}, frames - has_frames, gaps)


def last_words(lines: dict, has_lines: set, gaps: list) -> set:
    """What killed archives published before they died and took with them: the end of each incarnation but the newest, and
    what the database says of itself that a restart took, since an archive asks its own log after those of others."""
    taken = {boot for _, boot, why, *_ in gaps if why == "restart"}
    newest, whole = {}, {}
    for key, boot, seq in lines.values():
        newest[key] = max(newest.get(key, ""), boot)
        if (boot, seq) in has_lines:
            whole[boot] = max(whole.get(boot, -1), seq)
    return {line for line, (key, boot, seq) in lines.items()
            if "/node/archive/" in key and boot != newest[key] and (seq > whole.get(boot, -1) or boot in taken)}


def complete(harness: Forward, truth: Truth, which: str, limit_s: float = 120.0):
    """Waits until all that was published up to now is stored, but for the last words of an archive that was killed."""
    rows, lines, frames = truth.published()

    def done():
        has_rows, has_lines, has_frames, gaps = stored(harness.databases()[which])
        left = (rows.keys() - has_rows, lines.keys() - has_lines - last_words(lines, has_lines, gaps), frames - has_frames)
        done.left = left, gaps
        return not any(left)
    began = time.monotonic()
    try:
        wait(f"the {which} archive is complete", done, limit_s, 0.5)
    except Late as late:
        left, gaps = done.left
        some = [sorted(one)[:5] for one in left]
        raise AssertionError(f"{late}: {[len(one) for one in left]} rows, lines and frames are missing, such as {some}; gaps {gaps[:5]}") from late
    losses = [gap for gap in stored(harness.databases()[which])[3] if gap[2] == "lost"]
    assert not losses, f"called lost: {losses}"
    print(f"    {which}: {len(rows)} rows, {len(lines)} log lines, {len(frames)} frames, complete after {time.monotonic() - began:.1f} s", flush=True)


def cut(inward: str, outward: str):
    def run(harness: Forward, truth: Truth, outage_s: float):
        harness.link(inward, outward)
        time.sleep(outage_s)
        harness.link()
        complete(harness, truth, "first")
    return run


def dead(harness: Forward, truth: Truth, outage_s: float):
    """Dead, and killed again while it asks for what it lacks."""
    harness.kill("archive")
    time.sleep(outage_s)
    for lived_s in (0.7, 1.5):
        harness.start("archive")
        time.sleep(lived_s)
        harness.kill("archive")
    harness.start("archive")
    complete(harness, truth, "first")


def both(harness: Forward, truth: Truth, outage_s: float):
    """The first archive is cut off while the second one is dead."""
    second = harness.processes.get("second")
    if second is None:
        harness.start_second()
        wait("the second archive has a database", lambda: has_tables(harness.databases()["second"]), 30)
        complete(harness, truth, "second")
        second = harness.processes["second"]
    second.kill()
    second.wait()
    harness.link("drop", "drop")
    time.sleep(outage_s)
    harness.link()
    harness.start_second()
    complete(harness, truth, "first")
    complete(harness, truth, "second")


def jump(harness: Forward, truth: Truth, outage_s: float):
    """The clock of the device node's host jumps by two hours and back while the archive is cut off."""
    harness.link("drop", "drop")
    time.sleep(outage_s / 2)
    harness.clock.jump(7200)
    time.sleep(outage_s / 2)
    harness.link()
    complete(harness, truth, "first")
    harness.clock.jump(0)
    time.sleep(3)
    complete(harness, truth, "first")


def late(harness: Forward, truth: Truth, outage_s: float):
    """A second archive that comes late gets every frame: the spool keeps them for it. Neither confuses a question."""
    if "second" not in harness.processes:
        harness.start_second()
    wait("the second archive has a database", lambda: has_tables(harness.databases()["second"]), 30)
    complete(harness, truth, "second")
    complete(harness, truth, "first")
    question = {"ask": {"readings": {"kind": "telescope", "device": "mount", "property": "Altitude"}}, "limit": 3}
    replies = truth.subscriber.session.get(f"{PREFIX}/archive/history", payload=json.dumps(question), timeout=5.0,
                                           target=zenoh.QueryTarget.ALL, consolidation=zenoh.ConsolidationMode.NONE)
    answers = [json.loads(bytes(reply.ok.payload)) for reply in replies if reply.ok is not None]
    assert len(answers) == 2 and all(len(answer["rows"]) == 3 for answer in answers), answers
    asks = harness.folder / "asks.toml"
    asks.write_text(harness.configuration.read_text().replace("[bus]\n", f'[bus]\nconnect = ["{harness.endpoint("hands")}"]\n'))
    done = subprocess.run([harness.binary, "archive", "frames", "--config", str(asks)], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr


def restarted(harness: Forward, truth: Truth, outage_s: float):
    """A device node that is killed while the archive is cut off: what it held is lost, and the database has the gap."""
    before = time.time()
    harness.link("drop", "drop")
    time.sleep(outage_s / 2)
    harness.kill("hands")
    died = truth.published()[0]
    harness.start("hands")
    time.sleep(outage_s / 2)
    harness.link()
    deadline = time.monotonic() + 60
    while True:
        rows, lines, frames, gaps = lacking(harness, truth, "first")
        restarts = {gap[0]: gap for gap in gaps if gap[2] == "restart"}
        unexplained = [row for row, (key, _, _) in rows.items() if not (
            key in restarts and restarts[key][4] - 1_500_000 <= row[3] <= restarts[key][5])]
        if not frames and not unexplained and len(restarts) >= 6:
            break
        assert time.monotonic() < deadline, (len(rows), unexplained[:5], frames, restarts)
        time.sleep(1)
    assert rows.keys() <= died.keys(), "rows of the new incarnation are missing"
    print(f"    {len(rows)} rows went with the device node's memory; gaps of {len(restarts)} keys are listed; "
          f"every frame is there ({time.time() - before:.0f} s)", flush=True)


def overflown(harness: Forward, truth: Truth, outage_s: float):
    """A cut that is longer than states are held: exactly what is lost is listed, and an alert is raised."""
    harness.link("drop", "drop")
    time.sleep(3 * harness.hold_min * 60)
    harness.link()

    def listed():
        rows, _, _, gaps = lacking(harness, truth, "first")
        lost = {(key, boot): 0 for key, boot, why, *_ in gaps if why == "lost"}
        for key, boot, why, samples, *_ in gaps:
            if why == "lost":
                lost[(key, boot)] += samples
        origins = {origin for origin in rows.values()}
        alerts = truth.subscriber.newest.get(f"{PREFIX}/node/archive/main/alerts", {}).get("alerts", [])
        listed.unlisted = [origin for origin in origins if origin[:2] not in lost]
        recent = any(seq > truth.newest(key, boot) - 5 for key, boot, seq in origins)
        is_told = any(alert["id"].startswith("archive/lost") for alert in alerts)
        return is_told and lost and not recent and not listed.unlisted and (lost, origins)
    try:
        lost, origins = wait("what is lost is listed, with an alert", listed, 90, 1.0)
    except Late as late:
        raise AssertionError(f"{late}: missing and not listed: {listed.unlisted[:5]}") from late
    assert len(origins) <= sum(lost.values()), "rows of states that are not listed as lost are missing"
    print(f"    {sum(lost.values())} states of {len(lost)} keys are listed as lost, {len(origins)} of them had rows of their own", flush=True)


CASES = {
    "cut both ways": cut("drop", "drop"),
    "cut inward": cut("drop", "accept"),
    "cut outward": cut("accept", "drop"),
    "dead": dead,
    "clock jumps": jump,
    "second archive": late,
    "both": both,
    "publisher restarts": restarted,
}
SHORT = {"cut both ways", "dead", "publisher restarts"}


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--outage-s", type=float, default=12.0)
    parser.add_argument("--only")
    parser.add_argument("--short", action="store_true")
    options = parser.parse_args()
    if not os.environ.get(APART):
        # a network of its own: bridge and addresses meet no other test's
        os.environ[APART] = "1"
        os.execvp("unshare", ["unshare", "--net", "--", sys.executable, "-B", *sys.argv])
    subprocess.run(["ip", "link", "set", "lo", "up"], check=True)
    binary = os.environ.get("STARMESH_BIN", str(pathlib.Path(__file__).resolve().parents[2] / "target/debug/starmesh"))
    chosen = {name: run for name, run in CASES.items() if (name in SHORT if options.short else not options.only or options.only in name)}
    rounds = [(15.0, chosen)] if chosen else []
    if not options.short and (not options.only or options.only in "overflow"):
        rounds.append((0.15, {"overflow": overflown}))
    for hold_min, cases in rounds:
        harness, truth = Forward(binary, hold_min), None
        try:
            # the peer that judges is there before anything is published
            harness.start("dome")
            harness.start("hands")
            truth = Truth(harness)
            for node in ("observatory", "archive"):
                harness.start(node)
            harness.exposes()
            complete(harness, truth, "first")
            for name, run in cases.items():
                print(f"{name}, {options.outage_s:.0f} s", flush=True)
                run(harness, truth, options.outage_s)
        except BaseException as error:
            harness.keep = True
            print(harness.last_words(), file=sys.stderr)
            print(f"FAILED: store and forward: {error!r}", flush=True)
            raise
        finally:
            if truth:
                truth.subscriber.close()
            harness.stop()
    print("every row and every frame arrived once")


if __name__ == "__main__":
    main()
