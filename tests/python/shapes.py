"""Is what was heard on the bus of the shape that the contract's golden samples promise?

    import shapes
    complaints = shapes.check(key, payload)            # a payload heard on its key; [] when all is well
    complaints = shapes.check_payload(name, payload)   # by name: "reply", "archive.answer", "dome.command" ...

The shape of a payload is the union of its samples in common/contract/golden/v1/<name>.json. What samples cannot say
(optional fields, values that may be missing, free keys, words of enumerations) stands in rules.json beside them, which
the tests of common/contract hold to the code. A field that no sample has is a complaint here, though a subscriber
ignores it: a new field belongs in the sample.

`python3 tests/python/shapes.py` checks all golden files with themselves, and itself with broken samples.
"""

import copy
import datetime
import functools
import json
import math
import pathlib
import re
import sys

GOLDEN = pathlib.Path(__file__).resolve().parents[2] / "common" / "contract" / "golden" / "v1"
ROOT = "starmesh/v1/"
ENVELOPE = {"boot_id", "seq", "at_utc"}
TIME = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(\.\d{1,9})?Z")
CHUNKS = {
    "{site}": r"[a-z0-9][a-z0-9-]{0,62}",
    "{telescope}": r"[a-z0-9][a-z0-9-]{0,62}",
    "{role}": r"device|observatory|archive|web",
}
NAME = r"[A-Za-z0-9][A-Za-z0-9_.-]{0,62}"


@functools.cache
def rules():
    return json.loads((GOLDEN / "rules.json").read_text(encoding="utf-8"))


@functools.cache
def names():
    """All payload names."""
    return sorted({name for payloads in rules()["keys"].values() for name in payloads})


def samples(name):
    """A payload's golden samples."""
    content = json.loads((GOLDEN / f"{name}.json").read_text(encoding="utf-8"))
    return content if isinstance(content, list) else [content]


class Shape:
    """What the samples have at one place: types of the scalars, fields of the objects, elements of the lists."""

    def __init__(self):
        self.types, self.fields, self.always, self.element = set(), {}, None, None


def kind_of(value):
    """JSON type, whole and broken numbers being one."""
    if isinstance(value, bool):
        return "bool"
    if isinstance(value, (int, float)):
        return "number"
    return {str: "text", dict: "object", list: "list", type(None): "null"}.get(type(value), "foreign")


def below(place, step):
    return f"{place}.{step}" if place else step


def learn(shape, value, name, place=""):
    if is_no_data(name, place, value):
        return
    shape.types.add(kind_of(value))
    if isinstance(value, dict):
        free = place in rules()["free_keys"].get(name, [])
        for key, inner in value.items():
            step = "*" if free else key
            learn(shape.fields.setdefault(step, Shape()), inner, name, below(place, step))
        present = set() if free else set(value)
        shape.always = present if shape.always is None else shape.always & present
    elif isinstance(value, list):
        shape.element = shape.element or Shape()
        for inner in value:
            learn(shape.element, inner, name, below(place, "*"))


@functools.cache
def shape_of(name):
    shape = Shape()
    for sample in samples(name):
        learn(shape, sample, name)
    return shape


def is_no_data(name, place, value):
    return place in rules()["may_be_missing"].get(name, []) and isinstance(value, dict) and "no_data" in value


def names_of(key):
    """Names of the payloads that may travel on a key; None when the key is not of the contract."""
    if not key.startswith(ROOT):
        return None
    chunks = key[len(ROOT):].split("/")
    for pattern, payloads in rules()["keys"].items():
        words = pattern.split("/")
        if len(words) != len(chunks):
            continue
        fits = all(
            re.fullmatch(CHUNKS.get(word) or NAME, chunk) if word.startswith("{") else word == chunk
            for word, chunk in zip(words, chunks)
        )
        if not fits:
            continue
        if "{kind}" not in words:
            return payloads
        kind = chunks[words.index("{kind}")]
        own = [payload for payload in payloads if payload.split(".")[0] == kind]
        return own + [payload for payload in payloads if "." not in payload] if own else None
    return None


def check(key, payload):
    """What is wrong with a payload heard on a key; on a query's key it may be the question or the answer."""
    payloads = names_of(key)
    if payloads is None:
        return [f"{key}: no key of the contract"]
    if not payloads:
        return [f"{key}: carries no payload"]
    tries = [check_payload(name, payload) for name in payloads]
    return [f"{key}: {complaint}" for complaint in min(tries, key=len)]


def check_payload(name, payload):
    """What is wrong with a payload of this name."""
    if name not in names():
        return [f"{name}: no payload of the contract"]
    complaints = []
    payload = without_ages(name, payload, complaints)
    compare(shape_of(name), payload, name, "", complaints)
    if not complaints and "seq" in payload and (isinstance(payload["seq"], float) or payload["seq"] < 0):
        complaints.append(f"{name} seq: {payload['seq']!r} is no count")
    return complaints


def without_ages(name, payload, complaints):
    """The payload without what every envelope (`sent_s`, `held_s`) and every device's state (`poll_s`) may have, once that is looked at."""
    if not isinstance(payload, dict):
        return payload
    may = {"sent_s", "held_s"} if "seq" in payload else set()
    may |= {"poll_s"} if "period_s" in payload and "link" in payload else set()
    for key in may & set(payload):
        value = payload[key]
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 <= value < math.inf:
            complaints.append(f"{name} {key}: {short(value)} is no number of seconds")
    return {key: value for key, value in payload.items() if key not in may}


def compare(shape, value, name, place, complaints):
    def complain(text):
        complaints.append(f"{name} {place or '(top)'}: {text}")

    kind = kind_of(value)
    leaf = place.rsplit(".", 1)[-1]
    if kind == "number" and not math.isfinite(value):
        return complain(f"{value} is no finite number")
    if place.endswith("readings.*"):
        return check_reading(value, complain)
    if place in rules()["scalars"].get(name, []):
        return check_scalar(value, complain)
    if is_no_data(name, place, value):
        return check_no_data(value, complain)
    if kind not in shape.types:
        return complain(f"{short(value)} is of type {kind}, expected {' or '.join(sorted(shape.types))}")
    if leaf.endswith("_utc"):
        check_time(value, complain)
    words = rules()["words"].get(name, {}).get(place)
    if words:
        if kind == "object" and len(value) != 1:
            return complain(f"{sorted(value)} should be one of {words}")
        word = next(iter(value)) if kind == "object" else value
        if word not in words:
            return complain(f"{short(word)} is none of {words}")
    if kind == "object":
        compare_object(shape, value, name, place, complaints, complain)
    elif kind == "list":
        for inner in value:
            compare(shape.element, inner, name, below(place, "*"), complaints)


def compare_object(shape, value, name, place, complaints, complain):
    optional = rules()["optional"].get(name, [])
    for key in sorted(shape.always - set(value)):
        if below(place, key) not in optional:
            complain(f"{key} is missing")
    for key, inner in value.items():
        step = key if key in shape.fields else "*"
        if step in shape.fields:
            compare(shape.fields[step], inner, name, below(place, step), complaints)
        else:
            complain(f"{key} is unknown")


def check_time(value, complain):
    if isinstance(value, list):
        # the two ends of a window, or several windows
        for inner in value:
            check_time(inner, complain)
        return
    if not isinstance(value, str) or not TIME.fullmatch(value):
        return complain(f"{short(value)} is no RFC 3339 time with Z")
    try:
        datetime.datetime.strptime(value[:19], "%Y-%m-%dT%H:%M:%S")
    except ValueError:
        complain(f"{value!r} is no time")


def check_no_data(value, complain):
    reason = value["no_data"]
    if set(value) != {"no_data"} or not isinstance(reason, str) or not reason:
        complain(f"{short(value)} should be {{\"no_data\": reason}}")


def check_scalar(value, complain):
    kind = kind_of(value)
    if kind == "list":
        for inner in value:
            check_scalar(inner, complain)
    elif kind == "number" and not math.isfinite(value):
        complain(f"{value} is no finite number")
    elif kind not in ("bool", "number", "text"):
        complain(f"{short(value)} is no scalar")


def check_reading(value, complain):
    if not isinstance(value, dict):
        return complain(f"{short(value)} is no reading")
    check_time(value.get("at_utc"), complain)
    rest = {key: inner for key, inner in value.items() if key not in ("at_utc", "age_s")}
    age_s = value.get("age_s", 0.0)
    if isinstance(age_s, bool) or not isinstance(age_s, (int, float)) or not 0 <= age_s < math.inf:
        complain(f"its age_s {short(age_s)} is no age in seconds")
    if "no_data" in rest:
        return check_no_data(rest, complain)
    if "value" not in rest:
        return complain(f"{short(value)} has neither value nor no_data")
    check_scalar(rest.pop("value"), complain)
    if not isinstance(rest.pop("unit", ""), str):
        complain("its unit is no text")
    if rest:
        complain(f"{sorted(rest)} unknown in a reading")


def short(value):
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


# ---- the check of the check


def example_key(pattern, name):
    chunks = {"{site}": "paranal", "{telescope}": "callisto", "{kind}": name.split(".")[0], "{role}": "device"}
    return ROOT + "/".join(chunks.get(w, "alpha") if w.startswith("{") else w for w in pattern.split("/"))


def places(value, place=()):
    yield place, value
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for step, below_it in inner:
        yield from places(below_it, place + (step,))


def changed(sample, place, change):
    """A copy of the sample after `change(parent, last step)`."""
    broken = copy.deepcopy(sample)
    parent = broken
    for step in place[:-1]:
        parent = parent[step]
    change(parent, place[-1])
    return broken


def set_to(value):
    def change(parent, step):
        parent[step] = value
    return change


def drop(parent, step):
    del parent[step]


def breakages(name, sample):
    """Broken copies of a sample, each with words for what is broken."""
    optional, free = rules()["optional"].get(name, []), rules()["free_keys"].get(name, [])
    for place, value in places(sample):
        pattern = ""
        parent_pattern = ""
        for step in place:
            parent_pattern = pattern
            pattern = below(pattern, "*" if isinstance(step, int) or pattern in free else step)
        if isinstance(value, dict) and pattern not in free:
            grown = copy.deepcopy(sample)
            target = grown
            for step in place:
                target = target[step]
            target["from_the_future"] = 1
            yield f"unknown field at {pattern or 'the top'}", grown
        if not place:
            continue
        allowed = types_at(name, pattern)
        if "null" not in allowed:
            yield f"null at {pattern}", changed(sample, place, set_to(None))
        yield f"foreign object at {pattern}", changed(sample, place, set_to({"odd": {"x": None}}))
        if kind_of(value) == "number":
            for wrong in (math.nan, math.inf):
                yield f"{wrong} at {pattern}", changed(sample, place, set_to(wrong))
        if any(str(step).endswith("_utc") for step in place) and not isinstance(value, list):
            for wrong in ("2026-11-21 03:12:45", "2026-11-21T03:12:45+00:00", "2026-13-21T03:12:45Z", 1795230765.2):
                yield f"{wrong} at {pattern}", changed(sample, place, set_to(wrong))
        if pattern in rules()["words"].get(name, {}) and isinstance(value, str):
            yield f"foreign word at {pattern}", changed(sample, place, set_to("no_such_word"))
        # an example and a JSON Schema hold anything
        free_json = name == "actions.answer" and pattern.startswith(("actions.*.example.", "actions.*.schema."))
        anything = free_json or pattern in rules()["scalars"].get(name, []) or any(
            pattern.startswith(place_of + ".") for place_of in rules()["scalars"].get(name, []))
        if kind_of(value) in ("number", "bool") and not anything and "text" not in allowed:
            yield f"text at {pattern}", changed(sample, place, set_to("12"))
        is_field = isinstance(place[-1], str) and parent_pattern not in free
        if is_field and pattern not in optional and not pattern.endswith(".unit"):
            yield f"no {pattern}", changed(sample, place, drop)


def self_check():
    problems, checked, caught = [], 0, 0
    for pattern, payloads in rules()["keys"].items():
        for name in payloads:
            key = example_key(pattern, name)
            if name not in (names_of(key) or []):
                problems.append(f"{key} is not a key of {name}")
            for sample in samples(name):
                checked += 1
                problems += check(key, sample) + check_payload(name, sample)
    for name in names():
        for sample in samples(name):
            for what, broken in breakages(name, sample):
                if check_payload(name, broken):
                    caught += 1
                elif not tolerated(name, what):
                    problems.append(f"{name}: {what} went unseen")
            problems += wrongly_refused(name, sample)
    published = [name for name in names() if ENVELOPE <= set().union(*map(set, samples(name)))]
    for foreign in ("starmesh/v2/paranal/callisto/archive/stored", "starmesh/v1/Paranal/callisto/archive/stored",
                    "starmesh/v1/paranal/callisto/device/toaster/a/state", "starmesh/v1/paranal/callisto/x", ""):
        if not check(foreign, {}):
            problems.append(f"{foreign!r} was taken for a key")
    if not check("starmesh/v1/paranal/callisto/device/dome/d/state", samples("camera.state")[0]):
        problems.append("a camera's state was taken for a dome's")
    if len(published) < 30:
        problems.append(f"only {len(published)} payloads have an envelope")
    for problem in problems:
        print(problem)
    print(f"{checked} samples of {len(names())} payloads checked, {caught} broken samples caught, "
          f"{len(problems)} problems")
    return 1 if problems or not checked or caught < 1000 else 0


def types_at(name, pattern):
    """The types that the samples have at a place; a value that may be anything has several."""
    shape = shape_of(name)
    for step in pattern.split("."):
        shape = shape.fields.get(step) or shape.fields.get("*") or shape.element
        if shape is None:
            return set()
    return shape.types


def tolerated(name, what):
    """A field that only some variants have (the reason of a lost link) can be absent unseen: samples are a union."""
    if not what.startswith("no "):
        return False
    pattern = what[3:]
    parent, _, key = pattern.rpartition(".")
    shape = shape_of(name)
    for step in parent.split(".") if parent else []:
        shape = shape.element if step == "*" and "*" not in shape.fields else shape.fields[step]
    return key not in (shape.always or set())


def wrongly_refused(name, sample):
    """Optional fields left out, values missing with a reason, and whole numbers are all well."""
    complaints = []
    for place, value in places(sample):
        pattern = ""
        for step in place:
            free = pattern in rules()["free_keys"].get(name, [])
            pattern = below(pattern, "*" if isinstance(step, int) or free else step)
        good = []
        if pattern in rules()["optional"].get(name, []):
            good.append(changed(sample, place, drop))
        if pattern in rules()["may_be_missing"].get(name, []):
            good.append(changed(sample, place, set_to({"no_data": "timeout: 2 s"})))
        if isinstance(value, float):
            good.append(changed(sample, place, set_to(int(value))))
        for payload in good:
            complaints += [f"refused though well: {complaint}" for complaint in check_payload(name, payload)]
    return complaints


if __name__ == "__main__":
    sys.exit(self_check())
