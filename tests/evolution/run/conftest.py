import sqlite3
from contextlib import closing

import pytest

from evolution.run.journal import FILE


@pytest.fixture
def downgrade():
    """Return a function that converts the journal of a folder to an earlier schema."""

    def change(folder, version):
        with closing(sqlite3.connect(folder / FILE)) as db, db:
            for table in ("run", "sessions"):
                db.execute(f"ALTER TABLE {table} DROP COLUMN digest")
            if version == 1:
                db.execute("DROP TABLE generations")
            db.execute(f"PRAGMA user_version = {version}")

    return change
