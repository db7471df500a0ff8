"""The database of an office, from which files are exported."""

from pathlib import Path

import pytest
from support.offices import office


@pytest.fixture(scope="session")
def town(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the database of an office, which no test changes."""
    folder = tmp_path_factory.mktemp("office")
    return Path(office(str(folder / "town.sqlite"), folder))
