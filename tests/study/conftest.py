"""What the tests of runs share."""

import numpy as np
import pytest

from diffshadow.study import style


@pytest.fixture
def no_figures(monkeypatch):
    """Runs draw no figures, which take most of their time."""
    monkeypatch.setattr("diffshadow.study.pages._figures.write_figures", lambda *_: [])


_DRAWN = style.save, style.inline_svg
_ONE_PIXEL = {
    ".png": style.png(np.zeros((1, 1))),
    ".svg": b'<svg xmlns="http://www.w3.org/2000/svg"/>',
    ".pdf": b"%PDF-1.4",
}


@pytest.fixture(scope="module")
def tiny_figures():
    """Figures are made, and their files hold next to nothing: to lay them out and draw them takes longer than runs."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(style, "save", lambda figure, path, dpi=style.DPI: path.write_bytes(_ONE_PIXEL[path.suffix]))
        patch.setattr(style, "inline_svg", lambda figure, name: "<svg></svg>")
        yield


@pytest.fixture
def drawn_figures(monkeypatch):
    """Figures as they are, also where others are tiny."""
    monkeypatch.setattr(style, "save", _DRAWN[0])
    monkeypatch.setattr(style, "inline_svg", _DRAWN[1])
