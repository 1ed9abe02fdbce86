"""The journal loses no committed data if a process or disk fails, and detects damage to its file."""

import errno
import json
import os
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from contextlib import closing

import numpy as np
import pytest

from caterpillar_env.robot import Outcomes
from caterpillar_env.task import Failure
from evolution.run.database import JournalError, digest, is_in_use
from evolution.run.history import History
from evolution.run.journal import FILE, Completion, Evaluation, Journal, read_simulated_s
from evolution.run.schema import COLUMNS

CONFIGURATION = {"seed": 3, "generations": 2}


def outcomes(count, seed=0):
    rng = np.random.default_rng(seed)
    codes = rng.integers(0, len(Failure), count).astype(np.int8)
    return Outcomes(codes, *rng.normal(size=(3, count)))


def rows_of(genomes, results, generation=0, first=0):
    """Evaluations of genomes (P, n) with these outcomes."""
    columns = [column.tolist() for column in results]
    return [
        Evaluation(first + i, generation, genome, Failure(code), *values, session=0)
        for i, (genome, code, *values) in enumerate(zip(genomes, *columns, strict=True))
    ]


def written(folder, parts=(3, 2)):
    """Write a journal with two generations. Return its genomes and outcomes."""
    genomes = np.random.default_rng(1).random((sum(parts), 4))
    results = outcomes(sum(parts))
    with Journal.create(folder, CONFIGURATION) as journal:
        journal.begin()
        first = 0
        for generation, size in enumerate(parts):
            rows = slice(first, first + size)
            journal.append(rows_of(genomes[rows], results.rows(rows), generation, first))
            first += size
            journal.complete(Completion(generation, first, None, None))
    return genomes, results


def test_written_data_is_read_back_exactly(tmp_path):
    genomes, results = written(tmp_path)
    with Journal(tmp_path) as journal:
        rows = list(journal.evaluations())
        assert journal.configuration == CONFIGURATION
        assert [s.fingerprint["machine"] for s in journal.sessions] == [os.uname().machine]
    assert [e.number for e in rows] == [0, 1, 2, 3, 4]
    assert [e.generation for e in rows] == [0, 0, 0, 1, 1]
    assert np.array_equal([e.genome for e in rows], genomes)
    assert [e.failure for e in rows] == results.failure.tolist()
    for name in ("distance_m", "energy_j", "simulated_s"):
        assert [getattr(e, name) for e in rows] == getattr(results, name).tolist()


def test_any_sqlite_tool_can_read_the_journal(tmp_path):
    genomes, _ = written(tmp_path)
    db = sqlite3.connect(tmp_path / FILE)
    rows = db.execute("SELECT genome, failure FROM evaluations WHERE generation = 1").fetchall()
    assert np.array_equal([np.frombuffer(g, "<f8") for g, _ in rows], genomes[3:])
    assert {status for _, status in rows} <= {f.label for f in Failure}
    assert json.loads(db.execute("SELECT configuration FROM run").fetchone()[0]) == CONFIGURATION
    db.close()


def test_error_of_a_file_system_without_locks_is_reported(tmp_path, monkeypatch):
    def fail(*_):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr("evolution.run.database.fcntl.flock", fail)
    with pytest.raises(JournalError, match=r"No locks available.* Nothing was recorded"):
        Journal.create(tmp_path, CONFIGURATION)


def test_a_second_process_is_refused(tmp_path, monkeypatch):
    written(tmp_path)
    monkeypatch.setattr("evolution.run.database.time.sleep", lambda _: None)  # between attempts
    with Journal(tmp_path) as journal:
        with pytest.raises(JournalError, match="another process is working on"):
            Journal(tmp_path)
        assert len(list(journal.evaluations())) == 5
    Journal(tmp_path).close()


@pytest.mark.parametrize("version", [2, 99])
def test_the_schema_of_another_version_is_refused(tmp_path, version):
    written(tmp_path)
    db = sqlite3.connect(tmp_path / FILE)
    db.execute(f"PRAGMA user_version = {version}")
    db.close()
    with pytest.raises(JournalError, match=f"another version of this package .schema {version};"):
        Journal(tmp_path)


def test_a_file_that_is_not_a_journal_is_refused(tmp_path):
    with pytest.raises(JournalError, match="is not a run folder"):
        Journal(tmp_path)
    db = sqlite3.connect(tmp_path / FILE)
    db.execute("CREATE TABLE recipes (name TEXT)")
    db.close()
    with pytest.raises(JournalError, match="SQLite file of another program"):
        Journal(tmp_path)
    with pytest.raises(JournalError, match="exists already"):
        Journal.create(tmp_path, CONFIGURATION)


@pytest.mark.parametrize("seed", range(8))
def test_flipped_bits_in_rows_are_detected(tmp_path, seed):
    genomes, results = written(tmp_path, parts=(200,))
    path = tmp_path / FILE
    content = bytearray(path.read_bytes())
    rng = np.random.default_rng(seed)
    # Flip a bit in a genome or its outcome, so that the structure of the file stays intact.
    victim = int(rng.integers(0, 200))
    size = 4 * 8 + len(Failure(results.failure[victim]).label) + 3 * 8
    place = content.index(genomes[victim].tobytes()) + int(rng.integers(0, size))
    content[place] ^= 1 << int(rng.integers(0, 8))
    path.write_bytes(content)
    with (
        pytest.raises(JournalError, match=rf"row {victim} of the table|Could not decode"),
        Journal(tmp_path) as journal,
    ):
        list(journal.evaluations())


def test_file_without_its_beginning_is_refused(tmp_path):
    written(tmp_path)
    (tmp_path / FILE).write_bytes(b"\0" * 5000)
    with pytest.raises(JournalError):
        Journal(tmp_path)


FULL_DISK = """
import resource, sys
import numpy as np
from pathlib import Path
from caterpillar_env.task import Failure
from evolution.run.database import JournalError
from evolution.run.journal import Evaluation, Journal
folder = Path(sys.argv[1])
journal = Journal.create(folder, {"seed": 3})
journal.begin()
resource.setrlimit(resource.RLIMIT_FSIZE, (300_000, 300_000))
genome = np.full(20, 0.5)
try:
    for first in range(0, 100_000, 50):
        numbers = range(first, first + 50)
        journal.append([Evaluation(i, 0, genome, Failure.NONE, 0.0, 0.0, 0.0, 0) for i in numbers])
except JournalError as error:
    print(first, error)
"""


def test_full_disk_is_an_error_and_loses_only_what_did_not_fit(tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", FULL_DISK, str(tmp_path)], capture_output=True, text=True, check=True
    )
    safe, message = done.stdout.split(maxsplit=1)
    assert "is the disk full?" in message
    assert "caterpillar resume" in message
    assert int(safe) > 100
    with Journal(tmp_path) as journal:
        assert len(list(journal.evaluations())) == int(safe)


WRITER = """
import sys
import numpy as np
from pathlib import Path
from caterpillar_env.task import Failure
from evolution.run.journal import Evaluation, Journal
journal = Journal.create(Path(sys.argv[1]), {"seed": 3})
journal.begin()
genome = np.full(20, 0.5)
for first in range(0, 1_000_000, 5):
    numbers = range(first, first + 5)
    journal.append([Evaluation(i, 0, genome, Failure.NONE, 0.0, 0.0, 0.0, 0) for i in numbers])
    print(first + 5, flush=True)
"""


@pytest.mark.slow
@pytest.mark.parametrize("trial", range(12))
def test_a_kill_during_writing_loses_no_committed_rows(tmp_path, trial):
    command = [sys.executable, "-c", WRITER, str(tmp_path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        process.stdout.readline()
        time.sleep(float(np.random.default_rng(trial).uniform(0, 0.15)))
        os.kill(process.pid, signal.SIGKILL)
        rest = process.stdout.read().split("\n")
    committed = [int(line) for line in rest if line]
    with Journal(tmp_path) as journal:
        rows = list(journal.evaluations())
    assert len(rows) >= (committed[-2] if len(committed) > 1 else 5)
    assert len(rows) % 5 == 0
    shutil.rmtree(tmp_path)


# Other records


def test_ends_of_generations_are_read_back(tmp_path):
    with Journal.create(tmp_path, CONFIGURATION) as journal:
        journal.begin()
        ends = [Completion(0, 3, None, None), Completion(1, 5, 4, 0.1)]
        for end in ends:
            journal.complete(end)
        assert journal.generations() == ends
    db = sqlite3.connect(tmp_path / FILE)
    with db:
        db.execute("UPDATE generations SET best = 3 WHERE generation = 1")
    db.close()
    with (
        Journal(tmp_path) as journal,
        pytest.raises(JournalError, match="row 1 of the table generations"),
    ):
        journal.generations()


def edit(folder, statement, *values):
    with closing(sqlite3.connect(folder / FILE)) as db, db:
        db.execute(statement, values)


@pytest.mark.parametrize(
    ("statement", "message"),
    [
        ("UPDATE run SET configuration = replace(configuration, '3', '4')", "row 0 of the table run"),
        ("DELETE FROM run", "it has 0 configurations"),
        (
            "UPDATE sessions SET fingerprint = replace(fingerprint, 'mujoco', 'muioco')",
            "of the table sess",
        ),
        ("UPDATE sessions SET finished = datetime('now')", "row 0 of the table sessions was altered"),
        ("DELETE FROM generations WHERE generation = 0", "generation 0 is missing"),
        ("DELETE FROM evaluations WHERE evaluation = 2", "evaluation 2 is missing"),
        ("DELETE FROM evaluations WHERE evaluation = 4", "evaluation 4 is missing"),
        ("ALTER TABLE run RENAME COLUMN digest TO digesu", "table run does not have the columns"),
        ("DROP TABLE generations", "table generations does not have the columns of schema 3"),
    ],
)
def test_altered_and_missing_rows_are_detected(tmp_path, statement, message):
    written(tmp_path)
    edit(tmp_path, statement)
    with pytest.raises(JournalError, match=f"journal.sqlite is damaged: .*{message}"):
        History.read(tmp_path)


@pytest.mark.parametrize(
    ("table", "column", "value", "message"),
    [
        ("run", "configuration", "{", "the configuration is not JSON"),
        ("run", "configuration", '{"seed": 1, "seed": 2}', "the configuration is not JSON: it repeats"),
        ("run", "configuration", "[" * 100_000, "the configuration is not JSON"),
        ("run", "configuration", "[1]", "the configuration is not a JSON object"),
        ("run", "configuration", "5", "the configuration is not a JSON object"),
        ("run", "configuration", b"\xff", "the configuration is not JSON"),
        ("sessions", "fingerprint", "no", "session 1 is not JSON"),
        ("sessions", "started", "then", "session 1 has no valid time"),
    ],
)
def test_invalid_text_with_correct_digests_is_refused(tmp_path, table, column, value, message):
    written(tmp_path)
    with closing(sqlite3.connect(tmp_path / FILE)) as db, db:
        row = dict(zip(COLUMNS[table], db.execute(f"SELECT * FROM {table}").fetchone(), strict=True))
        row[column] = value
        if table == "sessions":
            row["finished"] = row["started"]
        row["digest"] = digest([value for name, value in row.items() if name != "digest"])
        db.execute(f"UPDATE {table} SET {', '.join(f'{name} = ?' for name in row)}", [*row.values()])
    with pytest.raises(JournalError, match=f"journal.sqlite is damaged: {message}"):
        History.read(tmp_path)


@pytest.mark.parametrize(
    "changes",
    [
        {"genome": b"123"}, {"genome": b""}, {"genome": bytes(8)}, {"failure": "tired"},
        {"distance_m": np.inf}, {"distance_m": "far"}, {"energy_j": b"x"}, {"generation": "first"},
        {"generation": 7},
    ],
    ids=str,
)  # fmt: skip
def test_invalid_rows_with_correct_digests_are_refused(tmp_path, changes):
    written(tmp_path)
    with closing(sqlite3.connect(tmp_path / FILE)) as db, db:
        row = list(db.execute("SELECT * FROM evaluations WHERE evaluation = 1").fetchone())[:-1]
        names = COLUMNS["evaluations"]
        for name, value in changes.items():
            row[names.index(name)] = value
        db.execute("DELETE FROM evaluations WHERE evaluation = 1")
        db.execute(f"INSERT INTO evaluations VALUES ({'?, ' * len(row)}?)", (*row, digest(row)))
    with pytest.raises(JournalError, match=r"journal\.sqlite is damaged: "):
        History.read(tmp_path)


@pytest.mark.parametrize("damage", ["flip", "truncate"])
def test_damage_to_any_page_is_detected_or_harmless(tmp_path, damage):
    """Flip a bit at three places in every page, or truncate the file there."""
    genomes, _ = written(tmp_path, parts=(60, 30))
    with Journal(tmp_path, read_only=True) as journal:
        expected = journal.configuration, journal.sessions, journal.generations()
    content, rng = (tmp_path / FILE).read_bytes(), np.random.default_rng(0)
    page = 4096
    for start in range(0, len(content), page):
        for _ in range(3):
            place = start + int(rng.integers(0, page))
            altered = bytearray(content)
            altered[place] ^= 1 << int(rng.integers(0, 8))
            (tmp_path / FILE).write_bytes(altered if damage == "flip" else content[:place])
            try:
                with Journal(tmp_path, read_only=bool(place % 2)) as journal:
                    found = journal.configuration, journal.sessions, journal.generations()
                    rows = list(journal.evaluations())
            except JournalError:
                continue
            assert damage == "flip"
            assert found == expected
            assert np.array_equal([row.genome for row in rows], genomes)


def test_flipped_bits_in_the_file_header_are_detected_or_harmless(tmp_path):
    """The first page holds the file header, with the schema version, and the tables."""
    genomes, _ = written(tmp_path)
    content = (tmp_path / FILE).read_bytes()
    for place in (*range(0, 100, 2), *range(4096 - 1200, 4096, 17)):
        altered = bytearray(content)
        altered[place] ^= 1 << place % 8
        (tmp_path / FILE).write_bytes(altered)
        try:
            history = History.read(tmp_path)
        except JournalError:
            continue
        assert history.configuration == CONFIGURATION
        assert np.array_equal([row.genome for row in history.evaluations], genomes)


def test_reading_needs_no_write_access(tmp_path):
    """After a kill during writing, the last transaction is rolled back in a copy."""
    genomes, _ = written(tmp_path)
    writer = sqlite3.connect(tmp_path / FILE)
    writer.execute("PRAGMA cache_spill = 1")
    writer.execute("PRAGMA cache_size = 1")
    rows = [(i, 0, bytes(800), "ok", 0.0, 0.0, 0.0, 1, b"") for i in range(5, 500)]
    writer.executemany("INSERT INTO evaluations VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?)", rows)
    killed = tmp_path / "killed"
    killed.mkdir()
    for name in (FILE, f"{FILE}-journal"):
        shutil.copyfile(tmp_path / name, killed / name)
    writer.close()
    before = {path.name: path.read_bytes() for path in killed.iterdir()}
    killed.chmod(0o555)
    try:
        with Journal(killed, read_only=True) as journal:
            assert np.array_equal([e.genome for e in journal.evaluations()], genomes)
        assert {path.name: path.read_bytes() for path in killed.iterdir()} == before
    finally:
        killed.chmod(0o755)


@pytest.mark.parametrize("name", [FILE, ".lock", f"{FILE}-journal"])
def test_opening_a_journal_never_waits_for_a_pipe(tmp_path, name):
    written(tmp_path)
    (tmp_path / name).unlink(missing_ok=True)
    os.mkfifo(tmp_path / name)
    if name == ".lock":
        Journal(tmp_path).close()
        assert len(History.read(tmp_path).evaluations) == 5
    else:
        for read_only in (True, False):
            with pytest.raises(JournalError, match="is not a regular file"):
                Journal(tmp_path, read_only=read_only)
        assert read_simulated_s(tmp_path) == 0.0
    assert not is_in_use(tmp_path)


def test_locking_does_not_truncate_the_target_of_a_symlink(tmp_path):
    (tmp_path / "other").write_text("precious")
    (tmp_path / ".lock").symlink_to(tmp_path / "other")
    written(tmp_path)
    assert (tmp_path / "other").read_text() == "precious"


def test_a_journal_can_be_read_while_it_is_written(tmp_path):
    with Journal.create(tmp_path, {"a": 1}) as journal:
        journal.begin()
        with Journal(tmp_path, read_only=True) as other:
            assert other.configuration == {"a": 1}
            assert len(other.sessions) == 1
        assert is_in_use(tmp_path)
    assert not is_in_use(tmp_path)


def test_sessions_record_their_start_and_end(tmp_path):
    with Journal.create(tmp_path, CONFIGURATION) as journal:
        journal.begin()
        journal.begin()
        journal.finish()
        stopped, finished = journal.sessions
    assert (stopped.number, finished.number) == (1, 2)
    assert stopped.finished is stopped.wall_s is None
    assert 0 <= finished.wall_s < 60
    times = {"started": "2026-02-28 23:59:50", "finished": "2026-03-01 00:01:00"}
    assert finished._replace(**times).wall_s == 70.0
    days = {"started": "2026-02-28 23:59:50", "finished": "2026-03-02 00:01:00"}
    assert finished._replace(**days).wall_s == 24 * 3600 + 70.0
