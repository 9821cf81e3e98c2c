"""Plays a recorded bus to a web node: `player.py bus.jsonl`.

It prints one line of JSON: `bus`, the endpoint to connect to, and `http`, the address of its own server, which has the clock that the
web node follows, the pixels of the recorded frames, and for a test:

- `GET /orders`: the orders that it was asked. `GET /states`: what it publishes, by key.
- `POST /put` `{KEY: BODY}`: another payload for a state; `null` ends it. `POST /events` `[[KEY, BODY], ...]`: events, once each.
- `POST /now` `{KEY: BODY}`: one more payload, published at once.
- `POST /raw` `{KEY: TEXT}`: a payload as it is, valid or not, with each beat. `POST /reset`: the recording again.

States are published once a second with new numbers, so that they stay fresh at the receiver, and what a test changes is published at once. Keys are without
`starmesh/v1/`.
"""

import array
import base64
import copy
import json
import math
import os
import random
import sys
import threading
import time
from datetime import datetime, timedelta
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import zenoh

ROOT = "starmesh/v1/"
SIDE = 256
BEAT_S = 1.0


def stars(width: int, height: int) -> bytes:
    """A noisy sky with stars, 16 bits a pixel, the same each time."""
    drawn = random.Random(20261126)
    sky = array.array("H", (max(0, int(drawn.gauss(700, 12))) for _ in range(width * height)))
    for _ in range(130):
        x0, y0, peak = drawn.uniform(0, width), drawn.uniform(0, height), 60 * 10 ** drawn.uniform(0, 2.4)
        for y in range(max(0, int(y0) - 5), min(height, int(y0) + 7)):
            for x in range(max(0, int(x0) - 5), min(width, int(x0) + 7)):
                light = peak * math.exp(-((x - x0) ** 2 + (y - y0) ** 2) / 3)
                sky[y * width + x] = min(65535, sky[y * width + x] + int(light))
    if sys.byteorder == "big":
        sky.byteswap()
    return sky.tobytes()


def said(line: dict, search: dict) -> bool:
    """Does a line of the log meet the conditions of a search, whatever its time is?"""
    levels = ["error", "warn", "info"]
    node = search.get("node")
    return (search.get("text", "").lower() in line["message"].lower()
            and levels.index(line["level"]) <= levels.index(search.get("level", "info"))
            and (node is None or line["node"] == node or line["node"].startswith(f"{node}/")))


class Recording:
    def __init__(self, file: str):
        with open(file, encoding="utf-8") as lines:
            head, *rest = [json.loads(line) for line in lines]
        self.telescope = head["telescope"]
        self.began = datetime.fromisoformat(head["recorded_utc"])
        self.origin = time.monotonic()
        self.states = {line["state"].removeprefix(ROOT): line["body"] for line in rest if "state" in line}
        self.events = [(line["event"].removeprefix(ROOT), line["body"]) for line in rest if "event" in line]
        self.answers = [line for line in rest if "question" in line]
        self.pixels = stars(SIDE, SIDE)

    def utc(self) -> str:
        return (self.began + timedelta(seconds=time.monotonic() - self.origin)).isoformat().replace("+00:00", "Z")

    def answer(self, path: str, asked: dict) -> dict | None:
        """The recorded answer to a question, whatever its times, limits and frame are."""
        if path == "archive/history":
            ask = asked.get("ask")
            if isinstance(ask, dict) and "series" in ask:
                rows = [row for one in ask["series"]["properties"] for row in self.series(one)]
                return {"rows": rows, "truncated": False}
            name = ask if isinstance(ask, str) else next(iter(ask))
            for line in self.answers:
                known = line["asks"].get("ask")
                if line["question"] == path and (known == name or isinstance(known, dict) and name in known):
                    found = copy.deepcopy(line["answer"])
                    search = ask.get("find_frames", {}) if isinstance(ask, dict) else {}
                    if search.get("image_type"):
                        found["rows"] = [row for row in found["rows"] if search["image_type"].lower() in (row["found_frame"].get("image_type") or "").lower()]
                    if name == "find_log":
                        found["rows"] = [row for row in found["rows"] if said(row["log"], ask["find_log"])]
                    return found
            return {"rows": [], "truncated": False}
        if path == "archive/frame":
            ask = asked["ask"]
            if isinstance(ask, dict) and "tile" in ask:
                data = base64.b64encode(self.pixels).decode()
                return {"gives": {"tile": {"width_px": SIDE, "height_px": SIDE, "highest_z": 3, "zero": 0.0, "scale": 1.0, "bytes": data}}}
            name = ask if isinstance(ask, str) else next(iter(ask))
            for line in self.answers:
                known = line["asks"].get("ask")
                if line["question"] == path and (known == name or isinstance(known, dict) and name in known):
                    return line["answer"]
            return {"gives": {"refused": {"reason": "unknown", "detail": "not recorded"}}}
        same = [line for line in self.answers if line["question"] == path]
        exact = [line for line in same if set(line["asks"]) == set(asked)]
        return (exact or same or [{"answer": None}])[0]["answer"]

    def series(self, wanted: dict) -> list[dict]:
        for line in self.answers:
            ask = line["asks"].get("ask")
            if isinstance(ask, dict) and ask.get("series", {}).get("properties") == [wanted]:
                return line["answer"]["rows"]
        return []


class Player:
    def __init__(self, recording: Recording):
        self.recording = recording
        self.lock = threading.RLock()
        self.orders: list[dict] = []
        self.seq: dict[str, int] = {}
        config = zenoh.Config()
        config.insert_json5("mode", '"peer"')
        config.insert_json5("listen/endpoints", '["tcp/127.0.0.1:0"]')
        config.insert_json5("scouting/multicast/enabled", "false")
        self.session = zenoh.open(config)
        self.endpoint = f"tcp/127.0.0.1:{listening_port()}"
        self.reset()
        self.events: list[tuple[str, dict]] = []
        self.note(recording.events)
        self.kept = [self.session.declare_queryable(ROOT + "**", self.asked)]
        nodes = {key.removesuffix("/state") for key in self.states if "/node/" in key and key.endswith("/state")}
        self.kept += [self.session.liveliness().declare_token(f"{ROOT}{node}/alive") for node in nodes]

    def reset(self) -> None:
        with self.lock:
            self.states = copy.deepcopy(self.recording.states)
            self.raw: dict[str, str] = {}

    def note(self, events) -> None:
        """Numbers events once; they are published with each beat, since a receiver takes each number once."""
        for key, body in events:
            with self.lock:
                self.seq[key] = self.seq.get(key, -1) + 1
                stamp = {"boot_id": "recorded", "seq": self.seq[key], "at_utc": body.get("at_utc", self.recording.utc())}
                if key.endswith("/frame"):
                    body = {**body, "url": f"http://127.0.0.1:{self.http}/frame" if hasattr(self, "http") else "", "width_px": SIDE, "height_px": SIDE, "bytes": len(self.recording.pixels), "sha256": ""}
                self.events.append((key, {**body, **stamp}))

    def stamped(self, key: str, body: dict) -> dict:
        with self.lock:
            self.seq[key] = self.seq.get(key, -1) + 1
            return {**body, "boot_id": "recorded", "seq": self.seq[key], "at_utc": self.recording.utc()}

    def play(self) -> None:
        while True:
            self.publish()
            self.tell()
            time.sleep(BEAT_S)

    def publish(self, keys=None) -> None:
        """States as they are now, all where none are named. No thread publishes an older one after a newer one of another."""
        with self.lock:
            keys = list(keys or self.states | self.raw)
        for key in keys:
            with self.lock:
                if key in self.states:
                    self.put(key, json.dumps(self.stamped(key, self.states[key])))
                if key in self.raw:
                    self.put(key, self.raw[key])

    def tell(self) -> None:
        """All events, in their order: a receiver that has got a later one takes no earlier one."""
        with self.lock:
            events = list(self.events)
        for key, body in events:
            self.put(key, json.dumps(body))

    def put(self, key: str, text: str) -> None:
        self.session.put(ROOT + key, text, encoding=zenoh.Encoding.APPLICATION_JSON)

    def asked(self, query) -> None:
        try:
            self.reply(query)
        except Exception as error:  # noqa: BLE001 -- a question that is not recorded is told, and the playing goes on
            print(f"player: {query.key_expr}: {error!r}", file=sys.stderr, flush=True)

    def reply(self, query) -> None:
        key = str(query.key_expr)
        if not query.payload:
            with self.lock:
                matching = [(one, body) for one, body in self.states.items() if zenoh.KeyExpr(ROOT + one).intersects(query.key_expr)]
            for one, body in matching:
                query.reply(ROOT + one, json.dumps(self.stamped(one, body)))
            return
        asked = json.loads(bytes(query.payload))
        parts = key.removeprefix(ROOT).split("/")
        path = "/".join(parts[2:])
        if path == "observatory/order":
            with self.lock:
                self.orders.append({"key": key.removeprefix(ROOT), **asked})
            query.reply(key, json.dumps({"answer": "accepted", "id": asked["id"], "token": 1}))
            return
        found = self.recording.answer(path, asked)
        if found is not None:
            query.reply(key, json.dumps(found))


def listening_port() -> int:
    """The port on which this process listens, given by the kernel; zenoh does not tell it."""
    inodes = set()
    for entry in os.scandir("/proc/self/fd"):
        try:
            target = os.readlink(entry.path)
        except OSError:
            continue
        if target.startswith("socket:["):
            inodes.add(target[8:-1])
    with open("/proc/self/net/tcp", encoding="ascii") as table:
        for line in list(table)[1:]:
            fields = line.split()
            if fields[3] == "0A" and fields[9] in inodes:
                return int(fields[1].split(":")[1], 16)
    raise RuntimeError("zenoh does not listen")


def main() -> None:
    player = Player(Recording(sys.argv[1]))

    class Handler(BaseHTTPRequestHandler):
        def give(self, body: bytes, kind: str = "application/json") -> None:
            self.send_response(200)
            self.send_header("Content-Type", kind)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def do_GET(self) -> None:
            if self.path == "/simulator/v1/clock":
                self.give(json.dumps({"utc": player.recording.utc(), "speed": 1.0, "simulated": True}).encode())
            elif self.path == "/states":
                with player.lock:
                    text = json.dumps(player.states)
                self.give(text.encode())
            elif self.path == "/orders":
                self.give(json.dumps(player.orders).encode())
            elif self.path.startswith("/frame"):
                self.give(player.recording.pixels, "application/octet-stream")
            else:
                self.send_error(404)

        def do_POST(self) -> None:
            text = self.rfile.read(int(self.headers["Content-Length"] or 0))
            body = json.loads(text or b"null")
            if self.path == "/put":
                with player.lock:
                    for key, one in body.items():
                        if one is None:
                            player.states.pop(key, None)
                        else:
                            player.states[key] = one
                player.publish(body)
            elif self.path == "/raw":
                with player.lock:
                    player.raw.update(body)
                player.publish(body)
            elif self.path == "/events":
                player.note(body)
                player.tell()
            elif self.path == "/now":
                for key, one in body.items():
                    player.put(key, json.dumps(player.stamped(key, one)))
            elif self.path == "/reset":
                player.reset()
                player.orders.clear()
                player.publish()
            self.give(b"{}")

        def log_message(self, *_) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    player.http = server.server_port
    player.events.clear()
    player.seq.clear()
    player.note(player.recording.events)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    threading.Thread(target=player.play, daemon=True).start()
    print(json.dumps({"bus": player.endpoint, "http": f"http://127.0.0.1:{server.server_port}"}), flush=True)
    sys.stdin.read()  # it ends with the test that started it
    os._exit(0)


if __name__ == "__main__":
    main()
