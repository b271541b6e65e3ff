"""Godot's shadows against pictures that its Compatibility renderer drew."""

import dataclasses

import numpy as np
import pytest
from engine_states import receives, scene_of
from golden_engines import EngineGolden, engine_golden, engine_goldens
from scenes import marked

from diffshadow.geometry import Scene
from diffshadow.raster import draw_surface
from diffshadow.shadow import GodotCompatibility

pytestmark = pytest.mark.optimized

CASES = engine_goldens("godot")
ENOUGH, ENOUGH_BY_OWN_MAP = 0.998, 0.995
QUALITIES = ("HARD", "SOFT_VERY_LOW", "SOFT_LOW", "SOFT_MEDIUM", "SOFT_HIGH", "SOFT_ULTRA")
MODES = {0: "SHADOW_ORTHOGONAL", 2: "SHADOW_PARALLEL_4_SPLITS"}
# Of the light; where less is left, its picture says little of the shadow.
SEEN = 0.05


def preset(golden: EngineGolden) -> GodotCompatibility:
    """The engine's settings."""
    job, light = golden.settings, golden.settings["light"]
    names = ("max_distance", "pancake_size", "fade_start")
    given = {f"directional_shadow_{name}" for name in names} & set(light)
    # A cube's faces are half as wide as its part of the atlas.
    size = job["size"] // 2 if light["type"] == "omni" else job["size"]
    return GodotCompatibility(
        shadow_bias=light["shadow_bias"],
        shadow_normal_bias=light["shadow_normal_bias"],
        soft_filter_quality=QUALITIES[job["quality"]],
        directional_shadow_mode=MODES[light.get("directional_shadow_mode", 0)],
        side=tuple(mesh.get("side", "front") for mesh in job["meshes"]),
        resolution=(size, size),
        subpixels=16,
        **{name: light[name] for name in given},
    )


def scene(golden: EngineGolden) -> Scene:
    light = golden.settings["light"]
    if light["type"] == "directional":
        return scene_of(golden, GodotCompatibility.directional_light(light["direction"]))
    if light["type"] == "omni":
        return scene_of(golden, GodotCompatibility.omni_light(light["position"], omni_range=light["omni_range"]))
    cone = {name: light[name] for name in ("spot_range", "spot_angle")}
    return scene_of(golden, GodotCompatibility.spot_light(light["position"], light["direction"], **cone))


def surface_of(golden: EngineGolden):
    of = scene(golden)
    return draw_surface(of.mesh, of.camera, subpixels=16)


def encoded(light: np.ndarray) -> np.ndarray:
    """In sRGB, as pictures are."""
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 1e-9) ** (1 / 2.4) - 0.055)


def decoded(picture: np.ndarray) -> np.ndarray:
    return np.where(picture <= 0.04045, picture / 12.92, ((picture + 0.055) / 1.055) ** 2.4)


def agreement(golden: EngineGolden, technique: GodotCompatibility, state) -> float:
    """The share of receivers whose pixels differ by at most 1/255."""
    assert all(receives(golden))
    surface = surface_of(golden)
    visibility = np.asarray(technique.visibility(state, surface)).astype(np.float64)
    unshadowed = golden.arrays.get("unshadowed")
    light = np.ones_like(visibility) if unshadowed is None else decoded(unshadowed / 255)
    counted = np.asarray(surface.mask) & (light > SEEN)
    return float((np.abs(encoded(visibility * light) - golden.arrays["picture"] / 255) <= 1.01 / 255)[counted].mean())


def from_read_back(golden, technique) -> float:
    return agreement(golden, technique, technique.from_map(golden.arrays["map"], scene(golden)))


def from_own_map(golden, technique) -> float:
    return agreement(golden, technique, technique.prepare(scene(golden)))


FIRST = ("directional_four_splits", "spot_hard_bias", "omni_both")
"""Those that are compared in every run of the tests."""


@pytest.mark.parametrize("name", marked(CASES, set(CASES) - set(FIRST)))
def test_both_maps_give_the_engines_picture(name):
    golden = engine_golden("godot", name)
    technique = preset(golden)
    assert from_read_back(golden, technique) >= ENOUGH
    assert from_own_map(golden, technique) >= ENOUGH_BY_OWN_MAP


# The setting that each picture shows, and below what share the wrong one falls.
SENSITIVE = [
    ("directional_hard_both", "shadow_normal_bias", 0.9),
    ("directional_soft_fading", "shadow_bias", 0.995),
    ("directional_four_splits", "shadow_normal_bias", 0.9),
    ("spot_soft_both", "shadow_normal_bias", 0.95),
    ("spot_hard_bias", "shadow_bias", 0.995),
    ("omni_both", "shadow_normal_bias", 0.95),
    ("omni_both", "shadow_bias", 0.998),
]


@pytest.mark.parametrize(
    ("name", "key", "most"), [pytest.param(*each, marks=pytest.mark.exhaustive) for each in SENSITIVE]
)
def test_a_setting_that_is_off_by_a_tenth_is_seen(name, key, most):
    golden = engine_golden("godot", name)
    technique = preset(golden)
    wrong = dataclasses.replace(technique, **{key: getattr(technique, key) * 0.9})
    assert from_own_map(golden, wrong) < most


@pytest.mark.exhaustive
@pytest.mark.parametrize(("name", "quality"), [("directional_soft_default", "HARD"), ("spot_soft_both", "SOFT_HIGH")])
def test_another_kernel_is_seen(name, quality):
    golden = engine_golden("godot", name)
    assert from_own_map(golden, dataclasses.replace(preset(golden), soft_filter_quality=quality)) < 0.995
