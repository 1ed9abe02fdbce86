"""`caterpillar study` and `caterpillar report` refuse wrong input."""

import tomllib
from pathlib import Path

import pytest

from evolution import cli
from evolution.study.config import StudyConfig, begin

TOML = Path(__file__).parents[1] / "study" / "small.toml"
SMALL = tomllib.loads(TOML.read_text("utf-8"))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["study"], "give a TOML file or --preset NAME"),
        (["study", "a.toml", "--preset", "pilot"], "give a TOML file or --preset NAME"),
        (["study", "nothing.toml"], "cannot read nothing.toml"),
        (["study", "broken.toml"], "broken.toml is not TOML"),
        (["report", "nowhere"], "neither a run (journal.sqlite) nor a study (study.json)"),
        (["report", "begun"], "no run of begun is finished yet"),
    ],
    ids=str,
)
def test_errors_for_wrong_input_are_one_line(tmp_path, monkeypatch, capsys, arguments, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "broken.toml").write_text("seeds = [")
    begin(StudyConfig.from_dict(SMALL), tmp_path / "begun")
    assert cli.main(arguments) in (1, 2)
    err = capsys.readouterr().err
    assert message in err
    assert err.count("\n") == 1
