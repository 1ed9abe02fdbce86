"""`caterpillar doctor` reports what works, and how to fix the rest."""

import pytest
from packaging.requirements import Requirement

from evolution import cli
from evolution.cli import doctor
from evolution.cli.doctor import Finding

# Packages


def test_this_installation_is_complete():
    found = {finding.name: finding for finding in doctor.check_packages()}
    assert found["packages"].status == "ok"
    assert "mujoco 4." in found["packages"].found
    assert "ray" not in found["packages"].found.split()
    assert {"extra rl", "extra ray"} <= set(found)
    assert not {"extra test", "extra docs"} & set(found)
    assert all(finding.status != "NO" for finding in found.values())


def test_missing_and_old_packages_are_named():
    wanted = [Requirement(text) for text in ("numpy>=2.0", "no-such-thing>=1", "rich<1")]
    found = doctor.check_requirements("", wanted)
    assert (found.name, found.status) == ("packages", "NO")
    assert found.found.startswith("no-such-thing is missing, rich ")
    assert found.found.endswith(" does not meet <1")
    assert found.remedy == "pip install 'caterpillar-sma'"


def test_incomplete_extra_is_no_failure():
    found = doctor.check_requirements("far", [Requirement("numpy"), Requirement("no-such-thing")])
    assert found == Finding(
        "extra far", "--", "no-such-thing is missing", "pip install 'caterpillar-sma[far]'"
    )
    assert doctor.check_requirements("near", [Requirement("numpy")]).status == "ok"


# Drawing


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
def test_failure_to_draw_is_reported_as_a_finding(monkeypatch, tmp_path, body, problem):
    # The process imports a module `doctor` that is first on its path, instead of the real one.
    (tmp_path / "evolution" / "cli").mkdir(parents=True)
    (tmp_path / "evolution" / "cli" / "doctor.py").write_text(
        f"import os, signal, sys, time\ndef draw_frame():\n    {body}\n"
    )
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setattr(doctor, "TIMEOUT_S", 2.0 if "sleep" in body else 60.0)
    assert doctor.check_drawing() == Finding("drawing", "--", problem)


def test_remedy_for_an_unusable_backend_is_to_unset_it(monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "bogus")
    found = doctor.check_drawing()
    assert found.status == "--"
    assert "MUJOCO_GL: bogus" in found.found
    assert found.remedy == "unset MUJOCO_GL (it is 'bogus')"


# caterpillar doctor


def test_status_is_1_only_if_a_required_package_is_missing(monkeypatch, capsys):
    crash = Finding("drawing", "--", "crashed with SIGSEGV")
    monkeypatch.setattr(doctor, "check_drawing", lambda: crash)
    assert cli.main(["doctor"]) == 0
    captured = capsys.readouterr().out
    assert "--  drawing            crashed with SIGSEGV" in captured
    assert "\nEverything that a run needs works." in captured
    missing = Finding("packages", "NO", "numpy is missing", "pip install 'caterpillar-sma'")
    monkeypatch.setattr(doctor, "check_packages", lambda: iter([missing]))
    assert cli.main(["doctor"]) == 1
    captured = capsys.readouterr().out
    assert "NO  packages           numpy is missing\n" in captured
    assert "to fix it: pip install 'caterpillar-sma'" in captured
    assert "A package that every run needs is missing or has an unsupported version." in captured


@pytest.mark.drawing
def test_this_machine_passes(capsys):
    assert cli.main(["doctor"]) == 0
    assert "drew a frame" in capsys.readouterr().out
