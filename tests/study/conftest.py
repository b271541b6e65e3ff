"""What the tests of runs share."""

import signal

import numpy as np
import pytest

from diffshadow.study import style

_ONE_PIXEL = {
    ".png": style.png(np.zeros((1, 1))),
    ".svg": b'<svg xmlns="http://www.w3.org/2000/svg"/>',
    ".pdf": b"%PDF-1.4",
}


@pytest.fixture(scope="module")
def gl():
    """A context of OpenGL; tests are skipped where there is none."""
    pytest.importorskip("moderngl")
    from shader_chains import ByOpenGL

    return ByOpenGL().context


@pytest.fixture
def interrupts():
    """Interrupts raise, also where the tests run in the background of a shell, which has them ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture
def tiny_figures(monkeypatch):
    """Figures are made, and their files hold next to nothing: to draw them takes most of the time of a small run."""
    monkeypatch.setattr(style, "save", lambda figure, path, dpi=style.DPI: path.write_bytes(_ONE_PIXEL[path.suffix]))
