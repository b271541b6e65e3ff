"""The engines' pictures follow from their maps by the rules that are known.

They are computed again in NumPy, which shares with the package only the tables of taps. A picture that does not follow
would be no judge of the package, so its maker checks it.
"""

import _babylon_oracle
import _three_oracle
import numpy as np
from golden_engines import EngineGolden

from diffshadow.shadow.engines._babylon_taps import POISSON_32, POISSON_64

# The box stands on the ground, and its bottom casts: at equal depths, rounding decides.
_TIES = {"point_basic_default_sides"}


def follows(golden: EngineGolden) -> bool:
    """Whether a picture is what the engine's rules make of its map. One that is blurred in place leaves no map."""
    if golden.name.endswith("in_place"):
        return True
    mesh = golden.arrays["mesh"]
    receives = np.array([each.get("receives", True) for each in golden.settings["meshes"]])
    settings, info, arrays = golden.settings, golden.info, dict(golden.arrays)
    if golden.engine == "babylon":
        found = _babylon_oracle.babylon_visibility(settings, info, arrays, (POISSON_32, POISSON_64))
    else:
        if settings["shadowType"] == "VSM":
            light = settings["light"]
            samples = light.get("blurSamples", 8)
            arrays["map_blurred"] = _three_oracle.blurred(arrays["map"], light.get("radius", 1.0), samples)
        found = _three_oracle.three_visibility(settings, info, arrays)
    off = np.abs(found - golden.arrays["visibility"])[(mesh >= 0) & receives[mesh]]
    return bool((off <= 1 / 255).mean() >= (0.9996 if golden.name in _TIES else 0.9997))
