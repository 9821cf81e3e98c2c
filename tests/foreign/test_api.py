"""The API of a running demo against its own documents: a program that makes requests of the OpenAPI file, and the examples of docs/api.md.

Judges: schemathesis, jsonschema-rs and prometheus-client.
"""

import concurrent.futures
import contextlib
import email.parser
import hashlib
import json
import os
import pathlib
import re
import signal
import subprocess
import sys
import time
import urllib.error
import urllib.request

import astropy.io.fits
import jsonschema_rs
import numpy as np
import pytest
import websockets.sync.client
from ports import free_port
from prometheus_client.parser import text_string_to_metric_families
from shared import PROJECT

API = PROJECT / "docs" / "api.md"
SOCKET = json.loads((PROJECT / "docs" / "api" / "socket.json").read_text())


def ask(url: str):
    with urllib.request.urlopen(url, timeout=20) as answer:
        return json.load(answer)


def close(page: str, person: str, reason: str, prefer: str = "") -> dict:
    """Gives an order to close, and returns the command."""
    body = json.dumps({"command": "close", "reason": reason, "operator": person}).encode()
    headers = {"Content-Type": "application/json", "Idempotency-Key": f"{person} {time.time_ns()}"} | ({"Prefer": prefer} if prefer else {})
    url = f"{page}/api/v1/telescopes/demo/alpha/commands"
    with urllib.request.urlopen(urllib.request.Request(url, body, headers), timeout=90) as answer:
        assert answer.status in (200, 201, 202), answer.status
        return json.load(answer)


@contextlib.contextmanager
def running_demo(starmesh, folder, *options):
    """The demo and its page, as the README starts it, at a tenth of its speed so that it lasts."""
    url = f"http://127.0.0.1:{(port := free_port())}"
    with open(folder / "log", "w") as log:
        demo = subprocess.Popen([starmesh, "demo", "--port", str(port), "--speed", "30", "--size-px", "256", "--stay", *options],
                                cwd=folder, stdout=log, stderr=subprocess.STDOUT)
    try:
        end = time.monotonic() + 60
        while True:
            with contextlib.suppress(OSError, urllib.error.HTTPError):
                if all(ask(f"{url}/api/v1/telescopes/demo/alpha/{part}")["quality"] == "fresh" for part in ("schedule", "safety", "night")):
                    break
            assert time.monotonic() < end and demo.poll() is None, (folder / "log").read_text()
            time.sleep(0.5)
        yield demo, url, re.search(r"tcp/[0-9.]+:(\d+)", (folder / "log").read_text())[1]
    finally:
        demo.send_signal(signal.SIGINT)
        demo.wait(timeout=60)


@pytest.fixture(scope="module")
def demo(starmesh, tmp_path_factory):
    with running_demo(starmesh, tmp_path_factory.mktemp("api")) as demo:
        yield demo


@pytest.fixture
def page(demo):
    return demo[1]


def test_requests_made_of_the_document_find_no_fault(page, tmp_path):
    # Without a precondition a draft stays as it is: 428 (RFC 6585) is the answer to that.
    (tmp_path / "schemathesis.toml").write_text('[parameters]\nsite = "demo"\ntelescope = "alpha"\n[checks.missing_required_header]\n'
                                                'expected-statuses = [400, 401, 403, 406, 415, 422, 428]\n')
    # It refuses more than a schema can say, such as a place below the pole: that is no fault.
    words = ["run", f"{page}/api/openapi.json", "--url", page, "--max-examples", "10", "--phases", "examples,coverage,fuzzing",
             "--exclude-checks", "positive_data_acceptance", "--request-timeout", "20", "--seed", "1"]
    done = subprocess.run([pathlib.Path(sys.executable).with_name("schemathesis"), *words], cwd=tmp_path,
                          capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-6000:] + done.stderr


def blocks_of(fence: str, heading: str = "") -> list[str]:
    """The blocks of docs/api.md, or of one of its sections."""
    text = API.read_text()
    if heading:
        text = text.split(f"\n## {heading}\n")[1].split("\n## ")[0]
    return re.findall(rf"```{fence}\n(.*?)```", text, re.DOTALL)


def commands_of(fence: str, heading: str = "") -> list[str]:
    """The commands of the blocks that begin with one."""
    blocks = [block for block in blocks_of(fence, heading) if block.startswith("curl")]
    return [command for block in blocks for command in re.split(r"\n(?=curl)", block.strip())]


def run_example(command: str, page: str, folder: pathlib.Path, **variables: str):
    """What a command of the document prints, as JSON where it prints anything; it must be no problem."""
    command = command.replace("http://127.0.0.1:8080", page)
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, timeout=90, cwd=folder, env={**os.environ, **variables})
    answer = json.loads(done.stdout) if done.stdout else None
    is_problem = isinstance(answer, dict) and "code" in answer
    assert done.returncode == 0 and not is_problem, f"{command}\n{done.stdout}{done.stderr}"
    return answer


def test_a_frame_is_found_described_drawn_and_fetched_as_the_document_prints_it(page, tmp_path):
    """After the first frame with stars of the demo's night; every file is what a user of Python makes of it."""
    [block] = [block for block in blocks_of("sh") if block.startswith("TELESCOPE=")]
    telescope = f"{page}/api/v1/telescopes/demo/alpha"
    end = time.monotonic() + 240
    while not (rows := ask(f"{telescope}/frames?image_type=light&stars_min=1&limit=1")["rows"]) or not rows[0]["found_frame"]["header_complete"]:
        assert time.monotonic() < end, "the demo took no frame of stars"
        time.sleep(1)
    done = subprocess.run(["bash", "-ec", block.replace("http://127.0.0.1:8080", page)], cwd=tmp_path, capture_output=True, text=True, timeout=90)
    assert done.returncode == 0, done.stdout + done.stderr
    document = {path.stem: json.loads(path.read_text()) for path in tmp_path.glob("*.json")}
    frame = document["frame"]
    assert frame["id"] == document["frames"]["rows"][-1]["found_frame"]["id"] and frame["facts"]["stars"] == frame["stars"]
    assert document["latest"]["camera"] == frame["camera"] and document["report"]["telescope"] == "alpha"

    [fits_file] = tmp_path.glob("*.fits")
    assert fits_file.name == pathlib.PurePosixPath(frame["file"]).name and fits_file.stat().st_size == frame["bytes"]
    with astropy.io.fits.open(fits_file, checksum=True) as hdus:
        # a copy: with the pixels astropy scales them, and changes its header
        header, pixels = hdus[0].header.copy(), hdus[0].data
    assert pixels.shape == (frame["height_px"], frame["width_px"])
    cards = [(card["keyword"], card["value"]) for card in document["header"]["hdus"][0]["cards"] if card["keyword"] not in ("COMMENT", "HISTORY")]
    expected = [(card.keyword, None if isinstance(card.value, astropy.io.fits.card.Undefined) else card.value)
                for card in header.cards if card.keyword not in ("COMMENT", "HISTORY", "")]
    assert cards == expected
    assert document["pixels"]["values"] == pixels[100:108, 100:108].astype(float).ravel().tolist()

    tile_header = email.parser.Parser().parsestr((tmp_path / "tile.txt").read_text().split("\n", 1)[1])
    shape = int(tile_header["tile-height"]), int(tile_header["tile-width"])
    tile = np.fromfile(tmp_path / "tile.raw", "<u2").reshape(shape)
    block_px = 2 ** int(tile_header["tile-highest-z"])
    means = pixels.reshape(shape[0], block_px, shape[1], block_px).mean((1, 3))
    assert np.abs(tile - means).max() <= 0.5
    picture = (tmp_path / "preview.jpg").read_bytes()
    assert picture.startswith(b"\xff\xd8") and picture.endswith(b"\xff\xd9")
    at = picture.index(b"\xff\xc0")
    assert tuple(int.from_bytes(picture[at + n:at + n + 2]) for n in (5, 7)) == pixels.shape, "a frame that is smaller keeps its size"

    # as `curl -C -` goes on where it was
    resumed = urllib.request.Request(f"{telescope}/frames/{frame['id']}/file", headers={"Range": "bytes=2880-"})
    with urllib.request.urlopen(resumed, timeout=20) as answer:
        assert answer.status == 206 and answer.read() == fits_file.read_bytes()[2880:]


def test_the_examples_of_the_document_work(page, tmp_path):
    schedules = commands_of("sh", "Schedules")
    commands = [command for command in commands_of("sh") if command not in schedules]
    assert len(commands) >= 9, commands
    for command in commands:
        answer = run_example(command, page, tmp_path)
        if "/commands -H" in command or "-X POST" in command:
            assert answer["state"] == "done" and answer["detail"] == "verified closed", answer
            assert answer["requested_by"] == "ana", answer


def test_a_draft_becomes_the_schedule_in_force_by_the_commands_of_the_document(page, tmp_path):
    fetch, schemas, validate, simulate, put, diff, activate, revisions = commands_of("sh", "Schedules")
    assert run_example(fetch, page, tmp_path) is None
    file = tmp_path / "tonight.jsonl"
    before = file.read_text()
    assert before.startswith("// the demo's night"), before
    [action] = run_example(schemas, page, tmp_path)
    assert action["name"] == "object" and action["schema"]["properties"]["exptime"]["unit"] == "s", action

    # An error is found with its line, and nothing of it comes into force.
    lines = before.splitlines(keepends=True)
    target = next(number for number, line in enumerate(lines) if '"object"' in line)
    file.write_text("".join(lines).replace('"complete_headers"', '"complete_header"'))
    findings = run_example(validate, page, tmp_path)
    # by day there is a warning, too, that a row begins before tonight
    [error] = [finding for finding in findings["findings"] if finding["severity"] == "error"]
    assert not findings["valid"] and error["line"] == len(lines) and "complete_headers" in error["right"], findings

    # One row is changed, one is new.
    lines[target] = lines[target].replace('"n":20', '"n":7')
    lines.insert(target + 1, lines[target].replace('"action_value":{"object":"', '"action_value":{"object":"second '))
    file.write_text("".join(lines))
    findings = run_example(validate, page, tmp_path)
    assert findings["valid"] and findings["rows"] == len(lines) - 1, findings
    plan = run_example(simulate, page, tmp_path)
    assert len(plan["rows"]) == len(lines) - 1 and plan["night"]["frames"] > 0, plan["night"]
    changed = next(row for row in plan["rows"] if row["line"] == target + 1)
    assert changed["frames_wanted"] == 7 and changed["frames"] <= 7 and changed["altitude_curve"], changed
    draft = run_example(put, page, tmp_path)
    difference = run_example(diff, page, tmp_path)
    assert [(row["change"], row.get("line_after")) for row in difference["changes"]] == [("changed", target + 1), ("added", target + 2)]
    assert difference["changes"][0]["fields"] == [{"pointer": "/action_value/n", "before": 20, "after": 7}], difference
    assert difference["draft_etag"] == draft["etag"] and difference["same"] == len(lines) - 3, difference
    command = run_example(activate, page, tmp_path)
    assert (command["state"], command["reason"], command["requested_by"]) == ("done", "a supernova", "ana"), command

    url = f"{page}/api/v1/telescopes/demo/alpha/schedule"
    end = time.monotonic() + 20
    while len((state := ask(url)["body"])["rows"]) != len(lines) - 1:
        assert time.monotonic() < end, state
        time.sleep(0.2)
    assert state["sha256"] == hashlib.sha256(file.read_bytes()).hexdigest()
    assert any((row.get("object") or "").startswith("second ") and row["frames_wanted"] == 7 for row in state["rows"]), state["rows"]
    newest = run_example(revisions, page, tmp_path)[0]
    assert (newest["author"].split("@")[0], newest["reason"], newest["sha256"]) == ("web/ana", "a supernova", state["sha256"]), newest
    # Somebody who still has the old one in mind replaces nothing.
    with pytest.raises(AssertionError, match='"code":"precondition"'):
        run_example(activate, page, tmp_path)
    with urllib.request.urlopen(f"{url}/revisions/{newest['version'] - 1}", timeout=20) as answer:
        assert json.load(answer)["text"] == before


def test_a_program_signs_in_by_the_commands_of_the_document(starmesh, tmp_path):
    """At a demo with a user, which the running web node follows."""
    password = "four plain words here"
    with running_demo(starmesh, tmp_path, "--keep", str(tmp_path / "kept")) as (_, page, _):
        user = [starmesh, "user", "add", "ana", "--right", "engineer", "--password-file", "-", "--config", tmp_path / "kept" / "observatory.toml"]
        subprocess.run(user, input=password, text=True, check=True, capture_output=True)
        words = [starmesh, "user", "token", "add", "ana", "--name", "cron", "--days", "1", "--config", tmp_path / "kept" / "observatory.toml"]
        token = subprocess.run(words, text=True, check=True, capture_output=True).stdout.strip()
        end = time.monotonic() + 20
        with contextlib.suppress(urllib.error.HTTPError):
            while ask(f"{page}/api/v1/me")["way"] == "open":
                assert time.monotonic() < end
                time.sleep(0.2)
        by_token, log_in, me, made, log_out = commands_of("sh user", "Signing in")
        answers = [run_example(command, page, tmp_path, TOKEN=token, PASSWORD=password) for command in (by_token, log_in, me, made, log_out)]
        assert answers[0]["telescopes"] and answers[1]["name"] == answers[2]["name"] == "ana" and answers[2]["way"] == "session", answers
        assert answers[3]["token"].startswith("starmesh_") and answers[4] is None
        with pytest.raises(AssertionError, match='"code":"unauthenticated"'):
            run_example(me, page, tmp_path)
        words = {"PASSWORD": password, "INITIAL": "what bob gets at first", "NEW": "quite another five words"}
        _, users, made, changed, removed, own = [run_example(command, page, tmp_path, **words) for command in (log_in, *commands_of("sh user", "Users"))]
        assert [user["name"] for user in users["items"]] == ["ana"] and made["name"] == "bob" and changed["rights"] == ["viewer"], (users, made, changed)
        assert removed is own is None
        with pytest.raises(AssertionError, match='"code":"unauthenticated"'):
            run_example(me, page, tmp_path)


def test_the_python_client_is_made_of_the_document_and_its_example_works(page, tmp_path):
    clients = PROJECT / "clients" / "python"
    made = subprocess.run([sys.executable, clients / "build", tmp_path / "dist"], capture_output=True, text=True)
    assert made.returncode == 0, made.stdout + made.stderr
    [wheel] = (tmp_path / "dist").glob("*.whl")
    subprocess.run([sys.executable, "-m", "pip", "install", "--quiet", "--target", tmp_path / "installed", wheel], check=True)
    done = subprocess.run([sys.executable, "-B", clients / "example.py", page, "demo", "alpha"], capture_output=True, text=True,
                          env={**os.environ, "PYTHONPATH": str(tmp_path / "installed")}, timeout=120)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "demo/alpha: " in done.stdout and done.stdout.rstrip().endswith("done: verified closed"), done.stdout
    lost = subprocess.run([sys.executable, "-B", clients / "example.py", page, "demo", "nobody"], capture_output=True, text=True,
                          env={**os.environ, "PYTHONPATH": str(tmp_path / "installed")}, timeout=120)
    assert lost.returncode == 1 and "demo/nobody" in lost.stderr, lost.stdout + lost.stderr


def test_the_example_of_a_subscriber_prints_the_verdict(demo):
    [program] = re.findall(r"```python\n(.*?)```", API.read_text(), re.DOTALL)
    done = subprocess.run([sys.executable, "-c", program.replace("PORT", demo[2])], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0 and re.fullmatch(r"starmesh/v1/demo/alpha/observatory/safety/state (safe|unsafe)\n", done.stdout), done


def test_odd_subscriptions_cost_the_server_nothing_and_lose_nobody(page):
    program = Program(page)
    program.send(op="sub", topics=["log"] * 500)
    program.send(op="ping", t=1)
    messages = []
    while not messages or messages[-1]["op"] != "pong":
        messages.append(program.receive())
    assert [message["op"] for message in messages if message.get("topic") == "log"].count("snap") == 1
    program.send(op="sub", topics=["log?"])
    assert "already" in program.until(lambda message: message["op"] == "err")["data"]["detail"]
    program.send(op="sub", topics=[f"tel/demo/alpha/device/{n}" for n in range(300)])
    assert "256" in program.until(lambda message: message["op"] == "err")["data"]["detail"]
    program.until(lambda message: message["op"] == "beat")


class Program:
    """A program at the socket, as docs/api.md describes it; everything it receives is judged by the socket's document."""

    def __init__(self, page: str):
        schema = {**SOCKET["components"]["messages"]["from-server"]["payload"], "components": SOCKET["components"]}
        self.judge = jsonschema_rs.Draft202012Validator(schema)
        url = page.replace("http", "ws") + "/api/v1/ws"
        # left open by those who read nothing; the demo's end closes it
        self.socket = contextlib.ExitStack().enter_context(websockets.sync.client.connect(url, max_size=None))
        self.session = self.until(lambda message: message["op"] == "welcome")["data"]["session"]

    def send(self, **message):
        self.socket.send(json.dumps(message))

    def receive(self) -> dict:
        message = json.loads(self.socket.recv(timeout=5))
        self.judge.validate(message)
        return message

    def until(self, wanted, limit_s: float = 20.0) -> dict:
        end = time.monotonic() + limit_s
        while time.monotonic() < end:
            if wanted(message := self.receive()):
                return message
        raise AssertionError(f"not within {limit_s} s")


def of_document(op: str) -> list[dict]:
    """The messages to the socket that docs/api.md shows."""
    blocks = re.findall(r"```json\n(.*?)```", API.read_text(), re.DOTALL)
    return [message for block in blocks if (message := json.loads(block)).get("op") == op]


def test_the_topics_of_the_document_begin_with_the_whole_and_go_on_with_changes(page):
    program, (first, resume) = Program(page), of_document("sub")
    topics = ["net", "alerts", "commands", "frames/demo/alpha", "log", "tel/demo/alpha/device/dome", *first["topics"]]
    assert resume["op"] == "sub" and set(resume["resume"]) == {"session", "seq"}
    program.send(**{**first, "topics": sorted(set(topics))})
    snaps, changed = {}, set()
    end = time.monotonic() + 20
    while time.monotonic() < end and not (set(topics) <= set(snaps) and {"net", "tel/demo/alpha"} <= changed):
        message = program.receive()
        if message["op"] == "snap":
            assert message["topic"] not in snaps, "one snap is enough"
            snaps[message["topic"]] = message["data"]
        elif message["op"] in ("delta", "event"):
            assert message["topic"] in snaps, "the whole comes first"
            changed.add(message["topic"])
    assert set(snaps) == set(topics) and {"net", "tel/demo/alpha"} <= changed, (snaps.keys(), changed)
    assert "demo/alpha" in snaps["net"]["items"]
    assert all(key.startswith("demo/alpha/device/dome/") for key in snaps["tel/demo/alpha/device/dome"]["states"])


def test_a_program_that_was_cut_off_gets_each_log_line_once_and_in_order(page):
    watcher, cut = Program(page), Program(page)
    for program in (watcher, cut):
        program.send(op="sub", topics=["log"])
        snap = program.until(lambda message: message["op"] == "snap")
    cut.socket.close()

    lines = []
    for reason in ("the first", "the second"):
        close(page, "ana", reason)
        until = time.monotonic() + 3
        while time.monotonic() < until:
            message = watcher.receive()
            lines += message["data"] if message["op"] == "event" else []
    assert lines, "orders stand in the log"
    again = Program(page)
    assert again.session == cut.session
    again.send(op="sub", topics=["log"], resume={"session": again.session, "seq": {"log": snap["seq"]}})
    event = again.until(lambda message: message.get("topic") == "log")
    assert event["op"] == "event", event
    numbers = [line["number"] for line in event["data"]]
    assert numbers[:len(lines)] == [line["number"] for line in lines] and numbers == sorted(set(numbers)), (numbers, lines)


def test_a_program_that_reads_nothing_delays_no_other(page):
    slow, fast = [Program(page) for _ in range(5)], Program(page)
    for program in [*slow, fast]:
        program.send(op="sub", topics=["net", "tel/demo/alpha", "log"], max_rate_hz=10)
    longest, last = 0.0, time.monotonic()
    end = last + 12
    while time.monotonic() < end:
        fast.until(lambda message: message["op"] == "beat")
        longest, last = max(longest, time.monotonic() - last), time.monotonic()
    assert longest < 3.0, f"{longest:.1f} s between two beats, after which a page calls its link lost"


def observatory_node(parent: int) -> int:
    """The process of the observatory node that `parent` has started."""
    for entry in pathlib.Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            is_child = int((entry / "stat").read_text().rsplit(")", 1)[1].split()[1]) == parent
            if is_child and (entry / "cmdline").read_bytes().split(b"\0")[1:3] == [b"node", b"observatory"]:
                return int(entry.name)
    raise AssertionError("the demo has no observatory node")


def test_a_script_that_asks_for_the_heartbeat_learns_of_a_silent_observatory_node(demo):
    """As sites that came from Astra have it in cron: `error_free` is false within 35 s."""
    process, page, _ = demo
    node = observatory_node(process.pid)
    os.kill(node, signal.SIGSTOP)
    try:
        end = time.monotonic() + 35
        while (data := ask(f"{page}/api/heartbeat")["data"])["error_free"] or not data["stale"]:
            assert time.monotonic() < end, data
            time.sleep(0.5)
        assert data["error_source"], data
    finally:
        os.kill(node, signal.SIGCONT)
    end = time.monotonic() + 20
    while ask(f"{page}/api/heartbeat")["data"]["stale"]:
        assert time.monotonic() < end
        time.sleep(0.5)


def test_of_two_people_who_close_at_once_neither_is_sent_to_the_dome(page):
    with concurrent.futures.ThreadPoolExecutor() as people:
        for ended in people.map(lambda person: close(page, person, "clouds", "wait=60"), ["ana", "olga", "bob"]):
            assert (ended["state"], ended["detail"]) == ("done", "verified closed"), ended


def test_the_metrics_are_what_prometheus_reads(page):
    with urllib.request.urlopen(f"{page}/metrics", timeout=20) as answer:
        families = {family.name: family for family in text_string_to_metric_families(answer.read().decode())}
    assert families["starmesh_telescope_up"].samples[0].labels == {"site": "demo", "telescope": "alpha"}
    assert families["starmesh_telescope_up"].samples[0].value == 1
    properties = {sample.labels["property"] for sample in families["starmesh_reading"].samples}
    assert {"Humidity", "ShutterStatus", "Altitude"} <= properties, properties
