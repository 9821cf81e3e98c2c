"""The demo's network of four telescopes, watched through its one page, and its metrics by Prometheus' own program with the examples of `deploy`.

Judges: promtool (Debian's package prometheus, unpacked into a temporary folder), and the exit code and summary of the demo.
"""

import json
import re
import shutil
import subprocess
import time
import urllib.error
import urllib.request

import pytest
from ports import free_port
from shared import PROJECT

LIMIT_S = 900
TELESCOPES = ["demo/alpha", "demo/beta", "ridge/gamma", "ridge/delta"]


@pytest.fixture(scope="module")
def promtool(tmp_path_factory) -> str:
    """Prometheus' checker, which only reads."""
    found = shutil.which("promtool")
    if found:
        return found
    folder = tmp_path_factory.mktemp("prometheus")
    subprocess.run(["apt-get", "download", "-qq", "prometheus"], cwd=folder, check=True, capture_output=True, timeout=300)
    package = next(folder.glob("prometheus_*.deb"))
    subprocess.run(["dpkg", "-x", package, folder], check=True, timeout=60)
    return str(folder / "usr" / "bin" / "promtool")


def prometheus_takes(promtool: str, *what: str, text: str | None = None):
    done = subprocess.run([promtool, "check", *what], input=text, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stdout + done.stderr


def test_prometheus_takes_the_rules_and_the_expressions_of_the_dashboard(promtool, tmp_path):
    prometheus_takes(promtool, "config", str(PROJECT / "deploy" / "prometheus" / "prometheus.yml"))
    dashboard = json.loads((PROJECT / "deploy" / "grafana" / "starmesh.json").read_text())
    expressions = [target["expr"] for panel in dashboard["panels"] for target in panel["targets"]]
    assert len(expressions) > 15
    rules = [{"record": f"panel:{number}", "expr": re.sub(r"\$\w+", "x", expr)} for number, expr in enumerate(expressions)]
    file = tmp_path / "dashboard.json"
    # JSON is YAML, too
    file.write_text(json.dumps({"groups": [{"name": "dashboard", "rules": rules}]}))
    prometheus_takes(promtool, "rules", str(file))


def test_four_telescopes_at_two_sites_are_on_one_page_and_all_end_well(starmesh, promtool, tmp_path):
    port, folder = free_port(), tmp_path / "night"
    command = [starmesh, "demo", "--telescopes", "4", "--port", str(port), "--keep", str(folder)]
    with open(tmp_path / "demo.log", "w") as log:
        demo = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT)
    page, seen, metrics, until = f"http://127.0.0.1:{port}", [], "", time.monotonic() + LIMIT_S
    try:
        while demo.poll() is None:
            assert time.monotonic() < until, (tmp_path / "demo.log").read_text()
            try:
                with urllib.request.urlopen(f"{page}/api/v1/network", timeout=5) as answer:
                    seen.append(json.load(answer))
                if not metrics and len(seen[-1]["telescopes"]) == 4:
                    with urllib.request.urlopen(f"{page}/metrics", timeout=5) as answer:
                        metrics = answer.read().decode()
            except (urllib.error.URLError, OSError):
                pass  # not yet, or no longer
            time.sleep(0.5)
    finally:
        demo.kill()
        demo.wait(20)
    said = (tmp_path / "demo.log").read_text()
    assert demo.returncode == 0, said
    figures = re.search(r"headers complete +(\d+) +(\d+) +(\d+) +(\d+)\n", said)
    taken = re.search(r"frames taken +(\d+) +(\d+) +(\d+) +(\d+)\n", said)
    assert figures and taken and figures.groups() == taken.groups(), said
    assert all(int(frames) > 30 for frames in taken.groups()), said

    def postures(network: dict) -> dict:
        return {telescope["id"]: (telescope["posture"], telescope["safety"]["state"]) for telescope in network["telescopes"]}
    all_seen = [postures(network) for network in seen if len(network["telescopes"]) == 4]
    assert sorted(all_seen[-1]) == sorted(TELESCOPES)
    shared = {one["id"] for one in seen[len(seen) // 2]["shared"]}
    assert shared == {"demo/shared", "ridge/shared"}

    def apart(closed_site: str, open_site: str) -> bool:
        """Was one site closed by its weather while a telescope of the other one was open?"""
        return any(all(state == ("closed", "unsafe") for name, state in now.items() if name.startswith(closed_site))
                   and any(state == ("open", "safe") for name, state in now.items() if name.startswith(open_site)) for now in all_seen)
    assert apart("ridge/", "demo/") and apart("demo/", "ridge/"), said
    # the bad night: an alert of beta's mount while it is lost, and frames afterwards
    alerts = [alert["id"] for network in seen for telescope in network["telescopes"] if telescope["id"] == "demo/beta" for alert in telescope["alerts"]]
    assert any("mount" in alert or "telescope" in alert for alert in alerts), sorted(set(alerts))
    answers_again = said.index("the mount of beta answers again")
    assert re.search(r"demo/beta +object .* finished, \d+ of \d+ frames", said[answers_again:]), said
    assert "starmesh_telescope_up" in metrics
    prometheus_takes(promtool, "metrics", text=metrics)
