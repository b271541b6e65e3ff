"""The engines' pictures follow from their maps by the rules that are known.

They are computed again in NumPy, which shares with the package only the tables of taps. A picture that does not follow
would be no judge of the package.
"""

import babylon_oracle
import numpy as np
import pytest
import three_oracle
from golden_engines import engine_golden, engine_goldens

from diffshadow.shadow.engines._babylon_taps import POISSON_32, POISSON_64

# The box stands on the ground, and its bottom casts: at equal depths, rounding decides.
TIES = {"point_basic_default_sides"}
# One that is blurred in place leaves no map to begin with.
CASES = [
    (engine, name)
    for engine in ("three", "babylon")
    for name in engine_goldens(engine)
    if not name.endswith("in_place")
]


@pytest.mark.exhaustive
@pytest.mark.parametrize(("engine", "name"), CASES)
def test_a_picture_follows_from_its_map(engine, name):
    golden = engine_golden(engine, name)
    mesh = golden.arrays["mesh"]
    receives = np.array([each.get("receives", True) for each in golden.settings["meshes"]])
    settings, info, arrays = golden.settings, golden.info, dict(golden.arrays)
    if engine == "babylon":
        found = babylon_oracle.babylon_visibility(settings, info, arrays, (POISSON_32, POISSON_64))
    else:
        if settings["shadowType"] == "VSM":
            light = settings["light"]
            samples = light.get("blurSamples", 8)
            arrays["map_blurred"] = three_oracle.blurred(arrays["map"], light.get("radius", 1.0), samples)
        found = three_oracle.three_visibility(settings, info, arrays)
    off = np.abs(found - golden.arrays["visibility"])[(mesh >= 0) & receives[mesh]]
    assert (off <= 1 / 255).mean() >= (0.9996 if name in TIES else 0.9997)
