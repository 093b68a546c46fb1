"""Fixtures for all tests."""

import pytest
from hypothesis import settings

from tum_folder import write_tum_folder

settings.register_profile("unhurried", deadline=None)
settings.load_profile("unhurried")


@pytest.fixture
def tum_folder(tmp_path):
    """``tum_folder(name="log", **options)`` writes a log below tmp_path and gives its path."""
    return lambda name="log", **options: write_tum_folder(tmp_path / name, **options)
