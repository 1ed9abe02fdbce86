import json

import pytest

from caterpillar_env.errors import CaterpillarError
from caterpillar_env.files import make_folder, read, unused, write_json, writing


def test_non_empty_folder_is_rejected(tmp_path):
    make_folder(tmp_path / "a" / "b", "")
    make_folder(tmp_path / "a" / "b", "")  # nothing is in it
    with pytest.raises(CaterpillarError, match="a is not empty; choose another with --out, or else"):
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


def test_write_errors_give_advice_and_own_errors_pass_through(tmp_path):
    path = tmp_path / "none" / "x"
    with pytest.raises(CaterpillarError, match="directory; choose another place"), writing(path):
        path.write_text("")
    with pytest.raises(CaterpillarError), writing(tmp_path):
        raise CaterpillarError("mine")
