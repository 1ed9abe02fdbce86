"""Usable cores follow from the CPU affinity and from the limit of the control group."""

import os

import pytest

from caterpillar_env import machine

LIMITED_V1 = {"cpu/x/cpu.cfs_quota_us": "300000\n", "cpu/x/cpu.cfs_period_us": "100000\n"}
FREE_V1 = {"cpu/cpu.cfs_quota_us": "-1\n", "cpu/cpu.cfs_period_us": "100000\n"}


@pytest.mark.parametrize(
    ("own", "files", "cores"),
    [
        ("0::/\n", {"cpu.max": "150000 100000\n"}, 1.5),
        ("0::/a\n", {"a/cpu.max": "400000 100000\n", "cpu.max": "1 1"}, 4.0),
        ("0::/not/mounted\n", {"cpu.max": "50000 100000\n"}, 0.5),
        ("0::/\n", {"cpu.max": "max 100000\n"}, None),
        ("4:memory:/y\n3:cpu,cpuacct:/x\n0::/\n", LIMITED_V1, 3.0),
        ("1:cpu:/\n", FREE_V1, None),
        ("0::/\n", {"cpu.max": "garbage\n"}, None),
        ("0::/\n", {}, None),
        ("", {}, None),
    ],
    ids=["top", "group", "container", "max", "v1", "v1 unlimited", "garbage", "no file", "no group"],
)
def test_quota_is_the_limit_of_the_control_group(tmp_path, own, files, cores):
    for name, text in ({"own": own} | {f"groups/{name}": text for name, text in files.items()}).items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    assert machine.quota(tmp_path / "groups", tmp_path / "own") == cores
    assert machine.quota(tmp_path / "groups", tmp_path / "missing") is None


@pytest.mark.parametrize(("quota", "cores"), [(None, 3), (8.0, 3), (1.5, 2), (0.2, 1)])
def test_cores_are_limited_by_affinity_and_quota(monkeypatch, quota, cores):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: {1, 5, 7})
    monkeypatch.setattr(machine, "quota", lambda: quota)
    assert machine.cores() == cores


def test_processor_has_a_name():
    assert machine.processor()
