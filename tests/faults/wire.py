"""The simulator's own HTTP: the truth, the faults, and the log of what arrived. Nothing here asks a Starmesh node."""

import datetime
import http.client
import json
import time
import urllib.parse
import urllib.request


class Wire:
    """One simulated observatory, seen from behind."""

    def __init__(self, host: str, port: int):
        self.host, self.port = host, port
        self._newest = 0

    @property
    def address(self) -> str:
        return f"{self.host}:{self.port}"

    def ask(self, method: str, path: str, body: dict | None = None):
        connection = http.client.HTTPConnection(self.host, self.port, timeout=5)
        try:
            payload = None if body is None else json.dumps(body)
            connection.request(method, path, payload, {"Content-Type": "application/json"})
            answer = connection.getresponse()
            text = answer.read()
            if answer.status != 200:
                raise ValueError(f"{method} {path}: {answer.status} {text[:200]!r}")
            return json.loads(text)
        finally:
            connection.close()

    def world(self) -> dict:
        return self.ask("GET", "/simulator/v1/world")

    def change(self, thing: str, **order):
        """PUT /simulator/v1/world/{thing}, see simulator/src/control.rs."""
        self.ask("PUT", f"/simulator/v1/world/{thing}", order)

    def fault(self, kind: str, **fault):
        """PUT /simulator/v1/faults/{kind}; without words it heals."""
        self.ask("PUT", f"/simulator/v1/faults/{kind}", fault)

    def ask_alpaca(self, kind: str, member: str, **parameters):
        """A command as any other ASCOM client on the network would send it."""
        form = urllib.parse.urlencode(parameters)
        request = urllib.request.Request(f"http://{self.address}/api/v1/{kind}/0/{member}", form.encode(), method="PUT")
        with urllib.request.urlopen(request, timeout=5) as answer:
            body = json.load(answer)
        if body.get("ErrorNumber"):
            raise ValueError(f"{kind} {member}: {body}")

    def get_alpaca(self, kind: str, member: str):
        """A property as any other ASCOM client on the network would read it."""
        body = self.ask("GET", f"/api/v1/{kind}/0/{member}")
        if body["ErrorNumber"]:
            raise ValueError(f"{kind} {member}: {body}")
        return body["Value"]

    def heal(self):
        self.ask("DELETE", "/simulator/v1/faults")

    def open_fraction(self) -> float:
        """0 is closed, in truth and whatever the dome says."""
        return self.world()["dome"]["open"]

    def puts(self, since: int = 0) -> list[dict]:
        """Commands that arrived at devices after number `since`, oldest first."""
        return self.ask("GET", f"/simulator/v1/log?since={since}")["puts"]

    def requests(self) -> dict:
        """Requests since the start, by device."""
        return self.ask("GET", "/simulator/v1/log?since=999999999")["requests"]["by_device"]

    def last(self) -> int:
        """Number of the newest command."""
        puts = self.puts(self._newest)
        self._newest = puts[-1]["seq"] if puts else self._newest
        return self._newest


def arrived_s(put: dict) -> float:
    """Wall clock of this host when a command arrived; the simulator's own clock is never faked."""
    return datetime.datetime.fromisoformat(put["wall_utc"]).timestamp()


class Late(Exception):
    """Something that must hold did not come to hold in time."""


def wait(what: str, holds, limit_s: float, pause_s: float = 0.05):
    """Waits for a level and returns it."""
    until = time.monotonic() + limit_s
    while True:
        result = holds()
        if result:
            return result
        if time.monotonic() > until:
            raise Late(f"{what}: not within {limit_s:.0f} s")
        time.sleep(pause_s)
