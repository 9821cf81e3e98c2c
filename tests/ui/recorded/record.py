"""Records the bus of a demo for tests/ui: `record.py tcp/127.0.0.1:PORT bus.jsonl`, with the bus address that the demo prints.

One line each: the newest sample of every state, the newest events, and answers of the archive and of the observatory node. Lists are
cut to what a page needs, so that the file stays below 500 kB.
"""

import json
import sys
import threading
import time

import zenoh

SITE, TELESCOPE = "demo", "alpha"
BASE = f"starmesh/v1/{SITE}/{TELESCOPE}"
# name of the last piece of an event's key -> so many are kept
EVENTS = {"diary": 120, "frame": 6, "facts": 6, "stored": 6}
SERIES = {
    "observingconditions/weather": ["WindSpeed", "WindGust", "Humidity", "Temperature", "DewPoint", "SkyTemperature", "RainRate", "Pressure", "CloudCover", "SkyQuality"],
    "camera/camera": ["CCDTemperature"],
    "focuser/focuser": ["Temperature", "Position"],
    "telescope/mount": ["Altitude"],
}


def short(value):
    """Floats as short as they mean something."""
    if isinstance(value, float):
        return float(f"{value:.7g}")
    if isinstance(value, dict):
        return {name: short(one) for name, one in value.items()}
    return [short(one) for one in value] if isinstance(value, list) else value


def main(endpoint: str, file: str) -> None:
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", json.dumps([endpoint]))
    states: dict[str, dict] = {}
    events: dict[str, list[tuple[str, dict]]] = {}
    lock = threading.Lock()

    def keep(sample) -> None:
        key = str(sample.key_expr)
        last = key.rsplit("/", 1)[-1]
        body = json.loads(bytes(sample.payload))
        for of_one_sending in ("sent_s", "held_s"):
            body.pop(of_one_sending, None)
        with lock:
            if last in EVENTS:
                events.setdefault(last, []).append((key, body))
                del events[last][: -EVENTS[last]]
            elif "/node/web/" in key:
                pass  # the web node under test is the telescope's own
            elif last in ("state", "guard", "capabilities", "alerts") or "/permit/" in key:
                states[key] = body

    session = zenoh.open(config)
    subscriber = session.declare_subscriber("starmesh/**", keep)

    def ask(key: str, question: dict) -> dict | None:
        replies = session.get(f"{BASE}/{key}", payload=json.dumps(question), timeout=60, encoding=zenoh.Encoding.APPLICATION_JSON)
        answers = [json.loads(bytes(reply.ok.payload)) for reply in replies if reply.ok is not None]
        return answers[0] if answers else None

    print("listening for 100 s", file=sys.stderr)
    time.sleep(100)
    subscriber.undeclare()
    now = max(body["at_utc"] for body in states.values() if "at_utc" in body)
    lines = [{"recorded_utc": now, "telescope": f"{SITE}/{TELESCOPE}"}]
    lines += [{"state": key, "body": body} for key, body in sorted(states.items())]
    lines += [{"event": key, "body": body} for kept in events.values() for key, body in kept]

    def answer(key: str, question: dict, change=lambda body: body):
        body = ask(key, question)
        if body is None:
            print(f"nobody answers {key} {json.dumps(question)[:100]}", file=sys.stderr)
            return None
        lines.append({"question": key, "asks": question, "answer": change(body)})
        return body

    for device, properties in SERIES.items():
        kind, name = device.split("/")
        for one in properties:
            answer("archive/history", {"ask": {"series": {"properties": [{"kind": kind, "device": name, "property": one}], "points": 60}}})
    # The player's clock runs as fast as the machine's.
    states[f"{BASE}/observatory/night/state"]["speed"] = 1.0
    found = answer("archive/history", {"ask": {"find_frames": {}}, "limit": 24})
    answer("archive/history", {"ask": "frames", "limit": 10})
    answer("archive/history", {"ask": "corrections", "limit": 120})
    answer("archive/history", {"ask": {"find_log": {}}, "limit": 100})
    answer("archive/history", {"ask": "audit", "limit": 10})
    frames = [row["found_frame"] for row in (found or {"rows": []})["rows"]]
    if frames:
        light = next((frame for frame in reversed(frames) if frame.get("fwhm_arcsec")), frames[-1])
        about = answer("archive/frame", {"frame": light["id"], "ask": "about"})
        lines.append({"event": f"{BASE}/observatory/frame/{light['id']}/facts", "body": about["gives"]["about"]["facts"]})
        for wanted in ({"header": {}}, {"picture": {"longest_px": 320, "stretch": "asinh"}}):
            answer("archive/frame", {"frame": light["id"], "ask": wanted})
        answer("archive/report", {"night": light["night"], "form": "json"})
    answer("observatory/actions", {})
    texts = answer("observatory/schedule/texts", {})
    answer("observatory/schedule/texts", {"list": 10})
    if texts and texts.get("text"):
        text = texts["text"]
        answer("observatory/schedule/check", {"text": text})
        answer("observatory/schedule/plan", {"text": text})
    with open(file, "w", encoding="utf-8") as out:
        out.writelines(json.dumps(short(line), separators=(",", ":"), ensure_ascii=False) + "\n" for line in lines)
    session.close()


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])
