"""The document about an import, literally: its shell lines are typed as they stand."""

import json
import pathlib
import shutil
import subprocess
import sys

import pytest
from shared import PROJECT
from test_imported_sites import templates  # noqa: F401: a fixture


def type_lines(section: str, starmesh: str, home: pathlib.Path) -> dict:
    assert shutil.which("ip"), "iproute2 is missing: apt-get install iproute2 (scripts/setup does)"
    script = pathlib.Path(__file__).with_name("import_document.py")
    document = PROJECT / "docs/operator/import.md"
    done = subprocess.run(["unshare", "--net", sys.executable, "-B", str(script), section, starmesh, str(document), str(home)],
                          capture_output=True, text=True, timeout=600)
    if done.returncode != 0:
        logs = "\n".join(f"--- {p.name}\n" + "\n".join(p.read_text(errors="replace").splitlines()[-30:]) for p in sorted(home.glob("*.log")))
        pytest.fail(f"{done.stdout}{done.stderr}\n{logs}")
    return json.loads(done.stdout)


def old_site(templates: dict[str, str], home: pathlib.Path):
    config = home / "Documents/Astra/observatory_config"
    config.mkdir(parents=True)
    for name, text in templates.items():
        (config / f"template_{name}").write_text(text.replace("observatoryname", "template"))


def test_the_lines_that_bring_a_site_over_are_taken_as_they_stand(starmesh, templates, tmp_path):  # noqa: F811
    old_site(templates, tmp_path)
    outcome = type_lines("Coming from Astra", starmesh, tmp_path)
    imported, checked, ordered = outcome["printed"]
    assert "starmesh order template/telescope-template start" in imported, imported
    assert "valid" in checked and "accepted" in ordered, outcome
    assert outcome["rows"] == 10 and outcome["codes"][0] == 0, outcome


def test_the_documented_trial_runs_the_whole_night_of_a_template_site(starmesh, templates, tmp_path):  # noqa: F811
    old_site(templates, tmp_path)
    outcome = type_lines("Trying it first", starmesh, tmp_path)
    assert len(outcome["rows"]) == 10 and all(status == "finished" for _, status, _ in outcome["rows"]), outcome["rows"]
    printed = outcome["printed"][0]
    for words in ["300 min", "\"guiding\" = null", "pointing_model", "its clock stands at"]:
        assert words in printed, (words, printed)
    # the predecessor's order: the dome is parked, then closed
    last = len(outcome["dome"]) - outcome["dome"][::-1].index("openshutter")
    assert outcome["dome"][last:last + 2] == ["park", "closeshutter"], outcome["dome"]
    assert outcome["codes"][0] == 0, outcome
