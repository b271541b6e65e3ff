"""What the tests of runs share."""

import pytest


@pytest.fixture
def no_figures(monkeypatch):
    """Runs draw no figures, which take most of their time."""
    monkeypatch.setattr("diffshadow.study.pages._figures.write_figures", lambda *_: [])
