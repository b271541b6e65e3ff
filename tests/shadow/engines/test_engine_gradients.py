"""Derivatives of engines' shadows by their numbers against central differences, in float64."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from engine_states import scene_of, surface_of
from golden_engines import engine_golden
from scenes import jacfwd_and_value

from diffshadow._arithmetic import in_float64
from diffshadow.shadow import BabylonJs, SoftCompare, ThreeJs

# Pictures whose lights and meshes are used.
SCENES = {
    "three": {"window": "directional_pcf_bias", "spot": "spot_pcf_radius_4", "cube": "point_pcf_radius_4"},
    "babylon": {"window": "directional_pcf_high", "spot": "spot_pcf_bias", "cube": "point_poisson"},
}
SOFT = SoftCompare(1.0)
SMALL = {"resolution": (128, 128), "compare": SOFT}
BASIC = ThreeJs(bias=-0.002, normal_bias=0.01, shadow_type="BasicShadowMap", side="double", **SMALL)
PCF = ThreeJs(bias=-0.002, normal_bias=0.01, radius=2.3, intensity=0.8, side="double", **SMALL)
FLOATS = {**SMALL, "float_maps": True, "darkness": 0.2, "frustum_edge_falloff": 0.3}
BABYLON = {
    name: BabylonJs(filter=name, bias=0.003, blur_scale=2.3, depth_scale=40.0, **FLOATS)
    for name in ("NONE", "POISSONSAMPLING", "EXPONENTIALSHADOWMAP", "CLOSEEXPONENTIALSHADOWMAP", "PCF", "PCSS")
}
BLURRED = dataclasses.replace(BABYLON["CLOSEEXPONENTIALSHADOWMAP"], filter="BLURCLOSEEXPONENTIALSHADOWMAP")
GAUSSIAN = dataclasses.replace(
    BABYLON["EXPONENTIALSHADOWMAP"], filter="BLUREXPONENTIALSHADOWMAP", use_kernel_blur=True, blur_kernel=8
)
CASES = [
    ("three", BASIC, "window", ["bias", "normal_bias"]),
    ("three", PCF, "window", ["bias", "normal_bias", "radius", "intensity"]),
    ("three", PCF, "spot", ["bias", "normal_bias", "radius"]),
    ("three", BASIC, "cube", ["bias"]),
    ("three", PCF, "cube", ["bias", "normal_bias", "radius", "intensity"]),
    ("babylon", BABYLON["NONE"], "window", ["bias", "darkness", "frustum_edge_falloff"]),
    ("babylon", BABYLON["NONE"], "spot", ["bias"]),
    ("babylon", BABYLON["NONE"], "cube", ["bias", "darkness"]),
    ("babylon", BABYLON["POISSONSAMPLING"], "window", ["bias", "blur_scale"]),
    ("babylon", BABYLON["POISSONSAMPLING"], "spot", ["bias", "blur_scale"]),
    ("babylon", BABYLON["POISSONSAMPLING"], "cube", ["bias", "blur_scale"]),
    ("babylon", BABYLON["PCF"], "window", ["bias", "darkness", "frustum_edge_falloff"]),
    ("babylon", BABYLON["PCF"], "spot", ["bias"]),
    ("babylon", BABYLON["PCSS"], "window", ["bias"]),
    ("babylon", BABYLON["PCSS"], "spot", ["bias"]),
    ("babylon", BABYLON["EXPONENTIALSHADOWMAP"], "window", ["bias", "depth_scale"]),
    ("babylon", BABYLON["CLOSEEXPONENTIALSHADOWMAP"], "window", ["bias", "depth_scale"]),
    ("babylon", BABYLON["CLOSEEXPONENTIALSHADOWMAP"], "cube", ["bias", "depth_scale"]),
    ("babylon", BLURRED, "window", ["bias", "depth_scale"]),
    ("babylon", GAUSSIAN, "window", ["bias", "depth_scale"]),
]


def title(case) -> str:
    engine, technique, light, _ = case
    return f"{engine}-{technique.shadow_type if engine == 'three' else technique.filter}-{light}"


@pytest.mark.exhaustive
@pytest.mark.parametrize(
    ("engine", "technique", "light", "names"),
    [pytest.param(*case, id=title(case)) for case in CASES],
)
def test_derivatives_agree_with_central_differences(engine, technique, light, names):
    golden = engine_golden(engine, SCENES[engine][light])
    state = technique.prepare(scene_of(golden))
    # Every second pixel of each row and column.
    surface = jax.tree.map(lambda leaf: leaf[::2, ::2], surface_of(golden))
    weights = np.random.default_rng(0).uniform(0.5, 1.5, surface.mask.shape)
    with jax.enable_x64(True):
        given = in_float64((technique, state, surface))
        values = np.array([float(getattr(technique, name)) for name in names])
        at = lambda values: brightness(*given, weights, tuple(names), jnp.asarray(values))
        derivatives, _ = at(values)
        for name, derivative, step in zip(
            names, derivatives, np.diag(1e-6 * np.maximum(abs(values), 1e-2)), strict=True
        ):
            numerical = (at(values + step)[1] - at(values - step)[1]) / (2 * step.sum())
            assert abs(float(numerical)) > 1e-3, name
            np.testing.assert_allclose(float(derivative), float(numerical), rtol=0.01, err_msg=name)


@eqx.filter_jit
def brightness(technique, state, surface, weights, names, values):
    """The derivatives of weighted visibility by the numbers at `names`, and its sum; one program for both."""

    def total(values):
        changed = dataclasses.replace(technique, **dict(zip(names, values, strict=True)))
        return jnp.sum(weights * changed.visibility(state, surface))

    return jacfwd_and_value(total)(values)
