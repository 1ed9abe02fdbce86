"""The journal: what is written is there, whatever happens to the process, the disk or the file."""

import json
import os
import shutil
import signal
import sqlite3
import subprocess
import sys
import time

import numpy as np
import pytest

from caterpillar_env.robot import Outcomes
from caterpillar_env.task import Failure
from evolution.run.database import JournalError, is_in_use
from evolution.run.journal import FILE, Completion, Evaluation, Journal

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
    """A journal with two generations; its genomes and outcomes."""
    genomes = np.random.default_rng(1).random((sum(parts), 4))
    results = outcomes(sum(parts))
    with Journal.create(folder, CONFIGURATION) as journal:
        journal.begin()
        first = 0
        for generation, size in enumerate(parts):
            rows = slice(first, first + size)
            part = Outcomes(*(column[rows] for column in results))
            journal.append(rows_of(genomes[rows], part, generation, first))
            first += size
            journal.complete(Completion(generation, first, None, None))
    return genomes, results


def test_every_bit_comes_back(tmp_path):
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


def test_any_sqlite_tool_can_read_it(tmp_path):
    genomes, _ = written(tmp_path)
    db = sqlite3.connect(tmp_path / FILE)
    rows = db.execute("SELECT genome, failure FROM evaluations WHERE generation = 1").fetchall()
    assert np.array_equal([np.frombuffer(g, "<f8") for g, _ in rows], genomes[3:])
    assert {status for _, status in rows} <= {f.label for f in Failure}
    assert json.loads(db.execute("SELECT configuration FROM run").fetchone()[0]) == CONFIGURATION
    db.close()


def test_a_second_process_is_refused(tmp_path, monkeypatch):
    written(tmp_path)
    monkeypatch.setattr("evolution.run.database.time.sleep", lambda _: None)  # between attempts
    with Journal(tmp_path) as journal:
        with pytest.raises(JournalError, match="another process is working on"):
            Journal(tmp_path)
        assert len(list(journal.evaluations())) == 5
    Journal(tmp_path).close()


def test_a_newer_schema_is_refused(tmp_path):
    written(tmp_path)
    db = sqlite3.connect(tmp_path / FILE)
    db.execute("PRAGMA user_version = 99")
    db.close()
    with pytest.raises(JournalError, match="written by a newer version of this package"):
        Journal(tmp_path)


def test_what_is_no_journal_is_refused(tmp_path):
    with pytest.raises(JournalError, match="is not a run folder"):
        Journal(tmp_path)
    db = sqlite3.connect(tmp_path / FILE)
    db.execute("CREATE TABLE recipes (name TEXT)")
    db.close()
    with pytest.raises(JournalError, match="SQLite file of another program"):
        Journal(tmp_path)
    with pytest.raises(JournalError, match="exists already"):
        Journal.create(tmp_path, CONFIGURATION)


def test_truncated_file_is_told(tmp_path):
    written(tmp_path, parts=(400, 400))
    path = tmp_path / FILE
    with path.open("r+b") as file:
        file.truncate(path.stat().st_size * 2 // 3)
    with pytest.raises(JournalError, match="is damaged: "):
        Journal(tmp_path)


@pytest.mark.parametrize("seed", range(8))
def test_flipped_bits_are_never_taken_for_data(tmp_path, seed):
    genomes, results = written(tmp_path, parts=(200,))
    path = tmp_path / FILE
    content = bytearray(path.read_bytes())
    rng = np.random.default_rng(seed)
    # Within a genome of the table or what became of it, so that the structure of the file stays whole.
    victim = int(rng.integers(0, 200))
    size = 4 * 8 + len(Failure(results.failure[victim]).label) + 3 * 8
    place = content.index(genomes[victim].tobytes()) + int(rng.integers(0, size))
    content[place] ^= 1 << int(rng.integers(0, 8))
    path.write_bytes(content)
    with (
        pytest.raises(JournalError, match=rf"evaluation {victim} (was altered|cannot be)"),
        Journal(tmp_path) as journal,
    ):
        list(journal.evaluations())


@pytest.mark.parametrize("seed", range(20))
def test_damage_anywhere_is_told_or_harmless(tmp_path, seed):
    genomes, _ = written(tmp_path, parts=(200,))
    path = tmp_path / FILE
    content = bytearray(path.read_bytes())
    place = int(np.random.default_rng(seed).integers(0, len(content)))
    content[place] ^= 0xFF
    path.write_bytes(content)
    try:
        with Journal(tmp_path) as journal:
            rows = list(journal.evaluations())
    except JournalError:
        return
    assert np.array_equal([e.genome for e in rows], genomes)


def test_file_without_its_beginning_is_told(tmp_path):
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


def test_a_full_disk_is_told_and_costs_only_what_did_not_fit(tmp_path):
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
@pytest.mark.parametrize("trial", range(25))
def test_killed_in_the_middle_of_writing_loses_nothing_committed(tmp_path, trial):
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


# What else is recorded


def test_the_ends_of_generations_come_back(tmp_path):
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
    with Journal(tmp_path) as journal, pytest.raises(JournalError, match="generation 1"):
        journal.generations()


def test_a_journal_of_the_first_schema_is_read_and_upgraded(tmp_path):
    written(tmp_path)
    db = sqlite3.connect(tmp_path / FILE)
    db.executescript("DROP TABLE generations; PRAGMA user_version = 1;")
    db.close()
    with Journal(tmp_path, read_only=True) as journal:
        assert journal.generations() == []
        assert len(list(journal.evaluations())) == 5
    with Journal(tmp_path) as journal:
        journal.complete(Completion(0, 3, None, None))
        assert journal.generations() == [Completion(0, 3, None, None)]


def test_a_journal_can_be_looked_at_while_it_is_written(tmp_path):
    with Journal.create(tmp_path, {"a": 1}) as journal:
        journal.begin()
        with Journal(tmp_path, read_only=True) as other:
            assert other.configuration == {"a": 1}
            assert len(other.sessions) == 1
        assert is_in_use(tmp_path)
    assert not is_in_use(tmp_path)


def test_sessions_tell_when_they_began_and_ended(tmp_path):
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
