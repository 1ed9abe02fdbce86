import json

import pytest

from caterpillar_env.errors import CaterpillarError
from caterpillar_env.files import FileError, make_folder, read, unused, write_json, writing


class UnreadError(CaterpillarError):
    """What is raised where a file cannot be read."""


def test_folder_that_holds_something_is_refused(tmp_path):
    make_folder(tmp_path / "a" / "b", "")
    make_folder(tmp_path / "a" / "b", "")  # nothing is in it
    with pytest.raises(FileError, match="a is not empty; choose another with --out, or else"):
        make_folder(tmp_path / "a", ", or else")


def test_names_that_are_taken_get_numbers(tmp_path):
    for expected in ("run", "run-2", "run-3"):
        folder = unused(tmp_path, "run")
        assert folder.name == expected
        folder.mkdir()


def test_json_is_whole_and_leaves_nothing_beside_it(tmp_path):
    write_json(tmp_path / "x.json", {"a": [1, 2.5]})
    assert json.loads((tmp_path / "x.json").read_text()) == {"a": [1, 2.5]}
    with pytest.raises(TypeError):
        write_json(tmp_path / "x.json", {"a": object()})
    assert read(tmp_path / "x.json", dict, UnreadError, "") == {"a": [1, 2.5]}
    assert [path.name for path in tmp_path.iterdir()] == ["x.json"]


def test_what_cannot_be_read_is_told_with_its_file(tmp_path):
    (tmp_path / "x.json").write_text("{")
    with pytest.raises(UnreadError, match=r"x\.json is not JSON"):
        read(tmp_path / "x.json", dict, UnreadError, "")
    with pytest.raises(UnreadError, match=r"cannot read .*none\.json: No such file .*; make one"):
        read(tmp_path / "none.json", dict, UnreadError, "make one")


def test_what_cannot_be_written_is_told_and_own_errors_stay(tmp_path):
    path = tmp_path / "none" / "x"
    with pytest.raises(FileError, match="directory; choose another place"), writing(path):
        path.write_text("")
    with pytest.raises(UnreadError), writing(tmp_path):
        raise UnreadError("mine")
