"""Peers on one host find each other by multicast: no endpoint configured, no broker, a namespace of their own."""

import os
import pathlib
import shutil
import subprocess
import sys



def test_two_nodes_meet_with_nothing_configured(starmesh, tmp_path):
    assert shutil.which("ip"), "iproute2 is missing: apt-get install iproute2 (scripts/setup does)"
    script = pathlib.Path(__file__).with_name("multicast_meeting.sh")
    done = subprocess.run(["unshare", "--net", "bash", str(script), starmesh, str(tmp_path)],
                          capture_output=True, text=True, timeout=120, env={**os.environ, "PYTHON": sys.executable})
    print(done.stdout, done.stderr)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "paranal/shared" in done.stdout or "node/archive/main/state" in done.stdout
    assert "node/web/main/state" in done.stdout
