"""A plain zenoh peer that receives everything and stores what it received."""

import json
import threading
import time

import zenoh


class BusSubscriber:
    """Subscribes `starmesh/**` and stores every payload; `newest` is by key."""

    def __init__(self, endpoint: str):
        config = zenoh.Config()
        config.insert_json5("mode", '"peer"')
        config.insert_json5("connect/endpoints", json.dumps([endpoint]))
        config.insert_json5("listen/endpoints", '["tcp/127.0.0.1:0"]')
        config.insert_json5("scouting/multicast/enabled", "false")
        self.session = zenoh.open(config)
        self.received: list[tuple[str, dict]] = []
        self.newest: dict[str, dict] = {}
        self.unreadable: list[str] = []
        self._news = threading.Condition()
        self._subscriber = self.session.declare_subscriber("starmesh/**", self._receive)

    def _receive(self, sample):
        key = str(sample.key_expr)
        try:
            payload = json.loads(bytes(sample.payload))
        except (ValueError, RecursionError):
            self.unreadable.append(key)
            return
        with self._news:
            self.received.append((key, payload))
            self.newest[key] = payload
            self._news.notify_all()

    def wait_for(self, what: str, holds, timeout_s: float):
        """Waits until `holds(newest)` is true and returns it; fails with what was last received."""
        until = time.monotonic() + timeout_s
        with self._news:
            while True:
                result = holds(self.newest)
                if result:
                    return result
                left = until - time.monotonic()
                if left <= 0:
                    break
                self._news.wait(left)
        brief = {k: str(v.get("fields", v))[:300] for k, v in self.newest.items()
                 if k.endswith(("/state", "/guard")) and ("dome" in k or "observatory" in k)}
        met = len(self.session.info.peers_zid())
        raise AssertionError(f"{what}: not within {timeout_s} s, with {met} peers met; last received {json.dumps(brief, indent=1)}")

    def ask(self, key: str, question: dict, timeout_s: float = 5.0) -> list[dict]:
        """Asks a queryable and returns its answers."""
        replies = self.session.get(key, payload=json.dumps(question), timeout=timeout_s)
        return [json.loads(bytes(reply.ok.payload)) for reply in replies if reply.ok is not None]

    def close(self):
        self.session.close()
