"""`caterpillar doctor` reports what works, and how to fix the rest."""

import json

import pytest
from packaging.requirements import Requirement

from evolution import cli
from evolution.cli import doctor
from evolution.cli.doctor import Finding


@pytest.fixture
def broken(monkeypatch):
    """A set of functions that fail in their separate processes."""
    functions = set()

    def check(name, function, otherwise):
        if function in functions:
            return Finding(name, otherwise, "crashed with SIGSEGV")
        return Finding(name, "ok", f"{function} worked")

    monkeypatch.setattr(doctor, "check_isolated", check)
    return functions


# Packages


def test_this_installation_is_complete():
    found = {finding.name: finding for finding in doctor.check_packages()}
    assert found["packages"].status == "ok"
    assert "mujoco 4." in found["packages"].found
    assert "ray" not in found["packages"].found.split()
    assert {"extra rl", "extra ray", "extra tensorboard"} <= set(found)
    assert not {"extra test", "extra docs"} & set(found)
    assert all(finding.status != "fail" for finding in found.values())


def test_missing_and_old_packages_are_named():
    wanted = [Requirement(text) for text in ("numpy>=2.0", "no-such-thing>=1", "rich<1")]
    found = doctor.check_requirements("", wanted)
    assert (found.name, found.status) == ("packages", "fail")
    assert found.found.startswith("no-such-thing is missing, rich ")
    assert found.found.endswith(" is not <1")
    assert found.remedy == "pip install 'caterpillar-sma'"


def test_incomplete_extra_is_a_note():
    found = doctor.check_requirements("far", [Requirement("numpy"), Requirement("no-such-thing")])
    assert found == Finding(
        "extra far", "note", "no-such-thing is missing", "pip install 'caterpillar-sma[far]'"
    )
    assert doctor.check_requirements("near", [Requirement("numpy")]).status == "ok"


# Checks in separate processes


@pytest.mark.parametrize(
    ("body", "problem"),
    [
        ("os.kill(os.getpid(), signal.SIGSEGV)", "crashed with SIGSEGV"),
        ("raise RuntimeError('no screen')", "RuntimeError: no screen"),
        ("sys.exit(1)", "failed without a message"),
        ("time.sleep(60)", "no result after 2 s"),
    ],
    ids=["crash", "error", "exit", "timeout"],
)
def test_failure_of_the_separate_process_is_a_finding(monkeypatch, tmp_path, body, problem):
    # The process imports a module `doctor` that is first on its path, instead of the real one.
    (tmp_path / "evolution" / "cli").mkdir(parents=True)
    (tmp_path / "evolution" / "cli" / "doctor.py").write_text(
        f"import os, signal, sys, time\ndef draw_frame():\n    {body}\n"
    )
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setattr(doctor, "TIMEOUT_S", 2.0)
    assert doctor.check_isolated("drawing", "draw_frame", "note") == Finding("drawing", "note", problem)


def test_remedy_for_an_unusable_backend_is_to_unset_it(monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "bogus")
    found = doctor.check_isolated("drawing", "draw_frame", "note")
    assert found.status == "note"
    assert "MUJOCO_GL: bogus" in found.found
    assert found.remedy == "unset MUJOCO_GL (it is 'bogus')"


# caterpillar doctor


def test_status_is_1_only_if_a_required_check_fails(broken, capsys):
    assert cli.main(["doctor"]) == 0
    assert "\nEverything that a run needs works." in capsys.readouterr().out
    broken |= {"draw_frame", "find_ffmpeg"}
    assert cli.main(["doctor"]) == 0
    assert "--  drawing            crashed with SIGSEGV" in capsys.readouterr().out
    broken.add("measure_speed")
    assert cli.main(["doctor"]) == 1
    captured = capsys.readouterr().out
    assert "NO  simulation" in captured
    assert "Not everything that a run needs works." in captured


def test_json_has_all_findings(broken, capsys):
    broken.add("draw_frame")
    assert cli.main(["doctor", "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["ok"] is True
    statuses = {finding["name"]: finding["status"] for finding in report["findings"]}
    assert statuses["drawing"] == "note"
    assert {"Python", "cores", "ffmpeg", "simulation"} <= set(statuses)


@pytest.mark.slow
def test_this_machine_passes(capsys):
    assert cli.main(["doctor"]) == 0
    captured = capsys.readouterr().out
    assert "drew a frame" in captured
    assert "simulated seconds per second; the paper's run of 9,510 evaluations takes at most" in captured
