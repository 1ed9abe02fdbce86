"""Limits of control groups are found wherever a container engine puts them."""

import os

import pytest

from caterpillar_env import machine


def laid_out(root, files):
    for name, text in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)


@pytest.mark.parametrize(
    ("ours", "files", "cores"),
    [
        ("0::/\n", {"cpu.max": "150000 100000\n"}, 1.5),
        ("0::/\n", {"cpu.max": "max 100000\n"}, None),
        ("0::/a/b\n", {"a/cpu.max": "400000 100000\n", "a/b/cpu.max": "max 100000\n"}, 4.0),
        ("0::/a/b\n", {"a/cpu.max": "400000 100000\n", "a/b/cpu.max": "200000 100000\n"}, 2.0),
        ("0::/not/mounted/here\n", {"cpu.max": "50000 100000\n"}, 0.5),
        (
            "4:memory:/x\n3:cpu,cpuacct:/x\n",
            {"cpu,cpuacct/x/cpu.cfs_quota_us": "300000", "cpu,cpuacct/x/cpu.cfs_period_us": "100000"},
            3.0,
        ),
        ("1:cpu:/\n", {"cpu/cpu.cfs_quota_us": "-1\n", "cpu/cpu.cfs_period_us": "100000\n"}, None),
        ("0::/\n", {"cpu.max": "garbage\n"}, None),
        ("0::/\n", {}, None),
    ],
    ids=[
        "own", "no limit", "above", "least", "elsewhere", "version 1", "version 1, no limit", "garbage",
        "nothing",
    ],
)  # fmt: skip
def test_quota_is_the_least_of_our_group_and_those_above(tmp_path, ours, files, cores):
    laid_out(tmp_path, {"ours": ours} | {f"groups/{name}": text for name, text in files.items()})
    assert machine.quota(tmp_path / "groups", tmp_path / "ours") == cores


def test_without_control_groups_there_is_no_limit(tmp_path):
    assert machine.quota(tmp_path, tmp_path / "missing") is None


def test_cores_are_those_that_this_process_may_use(monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {1, 5, 7})
    assert machine.cores() == 3
    assert machine.processor()
