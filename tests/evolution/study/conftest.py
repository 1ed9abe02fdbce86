from pathlib import Path

import pytest

TOML = Path(__file__).with_name("small.toml").read_text("utf-8")


@pytest.fixture(scope="module")
def finished(studied):
    """A finished study."""
    return studied(TOML)
