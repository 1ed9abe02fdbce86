"""The doctor tells what works and what does not, and how it is mended."""

import json
import os

import pytest
from packaging.requirements import Requirement

from evolution import cli
from evolution.cli import diagnosis
from evolution.cli.diagnosis import Finding, Trial


@pytest.fixture
def trials(monkeypatch):
    """What trials come to, by function and MUJOCO_GL; every other one fails."""
    works = {}

    def trial(function, *arguments, **environment):
        backend = {"MUJOCO_GL": os.environ.get("MUJOCO_GL"), **environment}["MUJOCO_GL"]
        if (function, backend) in works:
            return Trial(works[function, backend])
        return Trial(None, "it crashed (SIGSEGV)")

    monkeypatch.setattr(diagnosis, "trial", trial)
    return works


FRAME = {"backend": "egl", "renderer": "llvmpipe"}
SPEED = {
    "robots": 50, "simulated_s": 100.0, "build_s": 0.1, "crawl_s": 0.5, "engine_s": 0.45, "threads": 2,
    "simulated_s_per_s": 200.0, "share_of_limit": 0.9, "paper_evaluations": 9510, "paper_s": 1440.0,
}  # fmt: skip


# Installed


def test_this_installation_is_whole():
    found = {f.name: f for f in diagnosis.installed()}
    assert found["Python"].status == found["packages"].status == "ok"
    assert "mujoco 4." in found["packages"].found
    assert "ray" not in found["packages"].found.split()
    assert {"extra rl", "extra ray", "extra tensorboard"} <= set(found)
    assert not {"extra test", "extra docs"} & set(found)
    assert all(f.status != "fail" for f in found.values())


def test_python_that_is_too_old_is_told(monkeypatch):
    monkeypatch.setattr("platform.python_version", lambda: "3.10.4")
    python = next(diagnosis.installed())
    assert python.status == "fail"
    assert python.mend == "needs Python >=3.11"


def test_packages_that_are_missing_or_of_the_wrong_version_are_told_one_by_one():
    wanted = [Requirement(text) for text in ("numpy>=2.0", "no-such-thing>=1", "rich<1")]
    packages, missing, wrong = diagnosis.required(wanted)
    assert packages.status == "ok"
    assert packages.found.startswith("numpy 2.")
    assert missing == Finding("no-such-thing", "fail", "is missing", "pip install 'no-such-thing>=1'")
    assert wrong.status == "fail"
    assert wrong.found.endswith(", not <1")


def test_extra_that_is_not_whole_is_no_failure():
    found = diagnosis.of_extra("far", [Requirement("numpy"), Requirement("no-such-thing")])
    assert (found.name, found.status) == ("extra far", "note")
    assert found.found == "no-such-thing is missing"
    assert found.mend == "pip install 'caterpillar-sma[far]'"
    assert diagnosis.of_extra("near", [Requirement("numpy")]).status == "ok"


# Processor


@pytest.mark.parametrize(
    ("cores", "quota", "status", "mend"),
    [(4, None, "ok", ""), (4, 8.0, "ok", ""), (8, 2.5, "note", "caterpillar evolve --threads 2"),
     (8, 0.5, "note", "caterpillar evolve --threads 1")],
)  # fmt: skip
def test_threads_beyond_what_a_container_grants_are_told(monkeypatch, cores, quota, status, mend):
    monkeypatch.setattr("caterpillar_env.machine.cores", lambda: cores)
    monkeypatch.setattr("caterpillar_env.machine.quota", lambda: quota)
    _, threads = diagnosis.processor()
    assert (threads.status, threads.mend) == (status, mend)
    assert threads.found.startswith(f"{cores} by default")


# Drawing


def test_drawing_that_works_names_what_drew(trials, monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "egl")
    trials["frame", "egl"] = FRAME
    assert diagnosis.drawing() == Finding("drawing", "ok", "egl (llvmpipe) drew a frame")


@pytest.mark.parametrize(
    ("works", "mend"),
    [
        (None, "unset MUJOCO_GL"),
        ("osmesa", "export MUJOCO_GL=osmesa"),
        ("none", "install EGL (Debian: apt install libegl1"),
    ],
)
def test_drawing_that_does_not_work_is_mended_by_what_does(trials, monkeypatch, works, mend):
    monkeypatch.setenv("MUJOCO_GL", "egl")
    trials["frame", works] = FRAME
    found = diagnosis.drawing()
    assert found.status == "note"
    assert found.found == "no frame with MUJOCO_GL = egl: it crashed (SIGSEGV)"
    assert found.mend.startswith(mend)


def test_missing_ffmpeg_is_no_failure(monkeypatch):
    assert diagnosis.ffmpeg().status == "ok"

    def missing():
        raise RuntimeError("No ffmpeg exe could be found.\nInstall it.")

    monkeypatch.setattr("imageio_ffmpeg.get_ffmpeg_version", missing)
    found = diagnosis.ffmpeg()
    assert (found.status, found.found) == ("note", "none: No ffmpeg exe could be found.")
    assert "imageio-ffmpeg" in found.mend


# Simulating


def test_speed_is_told_with_the_time_of_the_papers_run():
    simulation, paper = diagnosis.simulating(Trial(SPEED), told=True)
    assert simulation.found == (
        "200 simulated seconds a second on 2 threads, 0.90 of the bare engine's speed (50 robots)"
    )
    assert paper.found.startswith("9,510 evaluations, at most 24 min here")


@pytest.mark.parametrize(
    ("given", "works", "mend"),
    [("bogus", None, "unset MUJOCO_GL"), (None, "egl", "pip install --force-reinstall mujoco")],
)
def test_engine_that_does_not_run_fails(trials, monkeypatch, given, works, mend):
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    if given is not None:
        monkeypatch.setenv("MUJOCO_GL", given)
    trials["speed", works] = SPEED
    (found,) = diagnosis.simulating(Trial(None, "it crashed (SIGILL)"), told=True)
    assert found == Finding("simulation", "fail", "it crashed (SIGILL)", mend)


# Trials


@pytest.mark.parametrize(
    ("body", "why"),
    [
        ("os.kill(os.getpid(), signal.SIGSEGV)", "it crashed (SIGSEGV)"),
        ("raise RuntimeError('no screen')", "RuntimeError: no screen"),
        ("time.sleep(60)", "it did not end in 2 s"),
    ],
    ids=["crash", "error", "hang"],
)
def test_what_goes_wrong_in_a_trial_is_a_finding(monkeypatch, tmp_path, body, why):
    # The trial imports `evolution.cli.diagnosis` of a folder that is first on its path.
    (tmp_path / "evolution").mkdir()
    (tmp_path / "evolution" / "__init__.py").write_text("")
    (tmp_path / "evolution" / "doctor.py").write_text(
        f"import os, signal, time\ndef frame():\n    {body}\n"
    )
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setattr(diagnosis, "_PATIENCE_S", 2.0)
    assert diagnosis.trial("frame") == Trial(None, why)


# caterpillar doctor


def test_command_fails_if_something_needed_does(trials, monkeypatch, capsys):
    monkeypatch.setenv("MUJOCO_GL", "egl")
    trials["frame", "egl"] = FRAME
    assert cli.main(["doctor"]) == 1
    said = capsys.readouterr().out
    assert "it crashed (SIGSEGV)" in said
    assert "something that every run needs does not work" in said
    trials["speed", "egl"] = SPEED
    assert cli.main(["doctor"]) == 0
    said = capsys.readouterr().out
    assert "egl (llvmpipe) drew a frame" in said
    assert "everything that every run needs works" in said


def test_command_succeeds_without_drawing(trials, monkeypatch, capsys):
    monkeypatch.setenv("MUJOCO_GL", "egl")
    trials["speed", "egl"] = SPEED
    assert cli.main(["doctor", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["ok"] is True
    assert said["speed"] == SPEED
    (drawing,) = (f for f in said["findings"] if f["name"] == "drawing")
    assert drawing["status"] == "note"
    assert "apt install libegl1" in drawing["mend"]


def test_brackets_are_no_markup(trials, monkeypatch, capsys):
    monkeypatch.setattr(
        diagnosis, "installed", lambda: iter([diagnosis.of_extra("rl", [Requirement("no-such")])])
    )
    trials["speed", os.environ.get("MUJOCO_GL")] = SPEED
    cli.main(["doctor"])
    assert "pip install 'caterpillar-sma[rl]'" in capsys.readouterr().out


@pytest.mark.slow
def test_this_machine_passes(capsys):
    assert cli.main(["doctor", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["speed"]["simulated_s"] >= 5  # 50 robots
    assert said["speed"]["share_of_limit"] > 0
    assert {f["name"] for f in said["findings"]} >= {"Python", "drawing", "ffmpeg", "simulation"}


@pytest.mark.slow
def test_wrong_backend_is_a_finding_of_the_real_thing(monkeypatch, capsys):
    monkeypatch.setenv("MUJOCO_GL", "bogus")
    assert cli.main(["doctor", "--no-measure"]) == 1
    said = capsys.readouterr().out
    assert "invalid value for environment variable MUJOCO_GL: bogus" in said
    assert "unset MUJOCO_GL" in said
