"""The engines draw their golden pictures again, and what a fit predicts."""

from pathlib import Path

import numpy as np
import pytest
from golden_engines import engine_golden
from scenes import staying_in

ROOT = Path(__file__).parent.parent

pytestmark = [pytest.mark.browser, pytest.mark.exhaustive]

TINY = """
scene:
  meshes:
    - {path: builtin:torus, size: 1, options: {segments: 24, sides: 12}, drop_to_ground: true, translate: [0, 0.2, 0]}
    - {path: builtin:plane, options: {size: 3}}
  camera: {resolution: [64, 64], orbit: {azimuth: 30, elevation: 35, distance: 4}}
  light: {azimuth: -60, elevation: 50, angular_radius: 2}
shadow_map: {resolution: [128, 128]}
technique: {type: three.js, shadow_side: double, bias: -0.001, radius: 2}
fit:
  parameters: {technique.bias: {lower: -0.05, upper: 0}, technique.radius: {lower: 0, upper: 6}}
reference: {samples: 16}
"""


@pytest.fixture(autouse=True)
def engines(monkeypatch):
    """The driver; the test is skipped where it lacks something."""
    monkeypatch.syspath_prepend(str(ROOT / "experiments"))
    from engines import engines

    lack = engines.missing()
    if lack is not None:
        pytest.skip(lack)
    return engines


@pytest.mark.parametrize(
    ("engine", "name"), [("three", "directional_pcf_radius_4"), ("babylon", "directional_pcf_high")]
)
def test_a_golden_is_drawn_again(engines, engine, name):
    golden = engine_golden(engine, name)
    (drawing,) = engines.draw([golden.settings])
    off = np.abs(drawing.arrays["visibility"].clip(0, 1) - golden.arrays["visibility"])
    assert (off < 1e-4).mean() > 0.999


def test_a_fit_holds_in_the_engine(tmp_path):
    import in_the_engine

    with staying_in(tmp_path):
        Path("tiny.yaml").write_text(TINY)
        found = in_the_engine.main(Path("tiny.yaml"), grid=3)
    rows = {row["state"]: row for row in found["rows"]}
    assert min(row["within_1_255_at_engine"] for row in rows.values()) >= 0.9997
    assert rows["after"]["rmse_engine"] < min(rows["before"]["rmse_engine"], rows["defaults"]["rmse_engine"])
    assert found["ratio"] <= 1.03
