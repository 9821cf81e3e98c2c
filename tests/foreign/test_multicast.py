"""Peers find each other without a broker, in a namespace of their own: by multicast where the file says so, and else on this host alone."""

import os
import pathlib
import shutil
import subprocess
import sys


def meet(script_name, starmesh, tmp_path):
    assert shutil.which("ip"), "iproute2 is missing: apt-get install iproute2 (scripts/setup does)"
    script = pathlib.Path(__file__).with_name(script_name)
    done = subprocess.run(["unshare", "--net", "bash", str(script), starmesh, str(tmp_path)],
                          capture_output=True, text=True, timeout=120, env={**os.environ, "PYTHON": sys.executable})
    print(done.stdout, done.stderr)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "paranal/shared" in done.stdout or "node/archive/main/state" in done.stdout
    assert "node/web/main/state" in done.stdout


def test_two_nodes_meet_by_multicast_where_the_file_says_so(starmesh, tmp_path):
    meet("multicast_meeting.sh", starmesh, tmp_path)


def test_two_nodes_without_a_bus_table_meet_on_this_host_and_listen_nowhere_else(starmesh, tmp_path):
    meet("local_meeting.sh", starmesh, tmp_path)
