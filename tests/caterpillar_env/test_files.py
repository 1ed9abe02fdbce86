import errno
import json
import os

import pytest

from caterpillar_env.errors import CaterpillarError
from caterpillar_env.files import make_folder, read, unused, write_json, writing


def test_non_empty_folder_is_rejected(tmp_path):
    make_folder(tmp_path / "a" / "b", "")
    make_folder(tmp_path / "a" / "b", "")  # an empty folder is allowed
    with pytest.raises(CaterpillarError, match="a is not empty; choose another folder with --out, or"):
        make_folder(tmp_path / "a", ", or else")


def test_existing_names_get_numbers(tmp_path):
    for expected in ("run", "run-2", "run-3"):
        folder = unused(tmp_path, "run")
        assert folder.name == expected
        folder.mkdir()


def test_json_is_written_completely_and_leaves_no_other_file(tmp_path):
    write_json(tmp_path / "x.json", {"a": [1, 2.5]})
    assert json.loads((tmp_path / "x.json").read_text()) == {"a": [1, 2.5]}
    with pytest.raises(TypeError):
        write_json(tmp_path / "x.json", {"a": object()})
    assert read(tmp_path / "x.json", dict, "") == {"a": [1, 2.5]}
    assert [path.name for path in tmp_path.iterdir()] == ["x.json"]


def test_read_errors_name_the_file(tmp_path):
    (tmp_path / "x.json").write_text("{")
    with pytest.raises(CaterpillarError, match=r"x\.json is not JSON"):
        read(tmp_path / "x.json", dict, "")
    with pytest.raises(CaterpillarError, match=r"cannot read .*none\.json: No such file .*; make one"):
        read(tmp_path / "none.json", dict, "make one")


def test_write_errors_give_advice_and_caterpillar_errors_pass_through(tmp_path):
    path = tmp_path / "none" / "x"
    with pytest.raises(CaterpillarError, match="directory; choose another place"), writing(path):
        path.write_text("")
    with pytest.raises(CaterpillarError, match=r"^mine$"), writing(tmp_path):
        raise CaterpillarError("mine")


def test_a_folder_with_leftovers_of_a_killed_process_counts_as_empty(tmp_path):
    (tmp_path / ".journal.sqlite.partial").touch()
    (tmp_path / ".lock").touch()
    make_folder(tmp_path, "")


@pytest.mark.parametrize("kind", ["pipe", "device", "folder"])
def test_only_regular_files_are_read(tmp_path, kind):
    path = tmp_path / "x.json"
    if kind == "pipe":
        os.mkfifo(path)  # reading it would wait for a writer
    elif kind == "folder":
        path.mkdir()
    else:
        path.symlink_to("/dev/zero")
    with pytest.raises(CaterpillarError, match=r"cannot read .*x\.json: it is not a regular file; go"):
        read(path, dict, "go")


def test_failed_write_keeps_the_file_and_removes_the_partial_one(tmp_path, monkeypatch):
    write_json(tmp_path / "x.json", 1)

    def fill_disk(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("os.replace", fill_disk)
    with pytest.raises(CaterpillarError, match=r"cannot write .*x\.json: No space left on device; free"):
        write_json(tmp_path / "x.json", 2, "free some")
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == {"x.json": "1\n"}
