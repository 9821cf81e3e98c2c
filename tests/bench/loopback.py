"""HTTP on this machine: a free port, an answer, and waiting for what must come to hold."""

import contextlib
import json
import pathlib
import sys
import time
import urllib.request

sys.path.append(str(pathlib.Path(__file__).resolve().parents[1] / "python"))

from ports import free_port

__all__ = ["fetch", "free_port", "put", "wait"]


def fetch(url: str):
    with urllib.request.urlopen(url, timeout=5) as answer:
        return json.load(answer)


def put(url: str, body: dict):
    request = urllib.request.Request(url, data=json.dumps(body).encode(), method="PUT",
                                     headers={"Content-Type": "application/json"})
    with urllib.request.urlopen(request, timeout=5) as answer:
        answer.read()


def wait(what: str, holds, limit_s: float = 60.0, pause_s: float = 0.05):
    until = time.monotonic() + limit_s
    while time.monotonic() < until:
        with contextlib.suppress(OSError, KeyError, TypeError, ValueError):
            if result := holds():
                return result
        time.sleep(pause_s)
    raise SystemExit(f"bench: {what}: not within {limit_s} s")
