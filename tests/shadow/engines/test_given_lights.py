"""Lights from engines' own numbers see what the engines' lights see."""

import jax.numpy as jnp
import numpy as np
import pytest
from engine_states import light_of, scene_of
from golden_engines import engine_golden

from diffshadow.geometry import PointLight
from diffshadow.shadow import BabylonJs, ThreeJs
from diffshadow.shadow.engines._axes import engine_light
from diffshadow.shadow.engines._given import BABYLON_NUDGE, THREE_NUDGE

NUDGES = {"three": THREE_NUDGE, "babylon": BABYLON_NUDGE}
BABYLON = {
    "orthoLeft": "ortho_left",
    "orthoRight": "ortho_right",
    "orthoTop": "ortho_top",
    "orthoBottom": "ortho_bottom",
    "shadowOrthoScale": "shadow_ortho_scale",
    "shadowMinZ": "shadow_min_z",
    "shadowMaxZ": "shadow_max_z",
}


def given_light(golden):
    """The library's light of the engine's numbers."""
    as_float = lambda value: [float(each) for each in value] if isinstance(value, list) else value
    light = {name: as_float(value) for name, value in golden.settings["light"].items()}
    kind = f"{light.pop('type')}_light"
    if golden.engine == "babylon":
        light.pop("autoUpdateExtends", None)
        return getattr(BabylonJs, kind)(**{BABYLON.get(name, name): value for name, value in light.items()})
    size = light.pop("mapSize")
    width, height = size if isinstance(size, list) else (size, size)
    resolution = {"resolution": (int(height), int(width))} if kind == "spot_light" else {}
    shadow = {name: light.pop(name) for name in ("bias", "normalBias", "radius", "intensity") if name in light}
    assert shadow
    return getattr(ThreeJs, kind)(**light.pop("camera", {}), **light, **resolution)


@pytest.mark.parametrize(
    ("engine", "name"),
    [
        ("three", "directional_pcf_frustum"),
        ("three", "directional_pcf_default_frustum"),
        ("three", "directional_pcf_overhead"),
        ("three", "directional_basic_reversed"),
        ("three", "spot_pcf_oblong_focus"),
        ("three", "spot_pcf_distance"),
        ("three", "spot_pcf_reversed"),
        ("three", "point_pcf_distance"),
        ("babylon", "directional_none_falloff_darkness"),
        ("babylon", "directional_pcf_overhead"),
        ("babylon", "spot_pcf_bias"),
        ("babylon", "point_none_bias"),
    ],
)
def test_a_light_of_the_engines_numbers_is_the_light_of_its_matrices(engine, name):
    golden = engine_golden(engine, name)
    given, expected = engine_light(given_light(golden), NUDGES[engine]), light_of(golden)
    if isinstance(expected, PointLight):
        np.testing.assert_allclose(given.position, expected.position)
        assert (float(given.near), float(given.far)) == (float(expected.near), float(expected.far))
        return
    points = np.concatenate([np.asarray(mesh.vertices)[::7] for mesh in scene_of(golden).meshes])
    of = lambda light: np.asarray(light.view().clip(jnp.asarray(points)))
    np.testing.assert_allclose(of(given), of(expected), atol=1e-5)
    # Of a map whose columns run from right to left, and window depth from near to far.
    theirs = np.c_[points, np.ones(len(points))] @ np.reshape(golden.info["shadowMatrix"], (4, 4))
    if engine == "babylon":
        np.testing.assert_allclose(of(given) * [-1, 1, 1, 1], theirs, atol=1e-5)
    else:
        window = of(given) / 2 + of(given)[:, 3:] / 2
        np.testing.assert_allclose(window[:, :2], theirs[:, :2], atol=1e-5)


WINDOW = (-1.0, 3.0, 2.0, -0.5)
"""Left, right, top and bottom."""


def corners_of(light, across, up, ahead, nudge):
    """Clip coordinates of the lower left corner at near and the upper right one at far, as the engine sees them."""
    left, right, top, bottom = WINDOW
    at = np.array([1.0, 4.0, 2.0])
    places = np.stack([at + left * across + bottom * up + ahead, at + right * across + top * up + 7 * ahead])
    return np.asarray(engine_light(light, nudge).view().clip(jnp.asarray(places, jnp.float32)))[:, :3]


# The axes of the window as the engine has them: to the right, and upwards.
DIRECTIONS = {
    "three": [
        ((0, 0, -1), (1, 0, 0), (0, 1, 0)),
        ((0, -1, 0), (1, 0, 0), (0, 0, -1)),
        ((0, 1, 0), (1, 0, 0), (0, 0, 1)),
    ],
    "babylon": [
        ((0, 0, 1), (1, 0, 0), (0, 1, 0)),
        ((0, -1, 0), (1, 0, 0), (0, 0, 1)),
        ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
    ],
}


@pytest.mark.parametrize(("engine", "axes"), [(engine, axes) for engine in DIRECTIONS for axes in DIRECTIONS[engine]])
def test_a_window_off_the_axis_lies_where_the_engine_has_it(engine, axes):
    ahead, across, up = (np.array(axis, float) for axis in axes)
    left, right, top, bottom = WINDOW
    at = np.array([1.0, 4.0, 2.0])
    if engine == "three":
        light = ThreeJs.directional_light(
            at, at + ahead, left=left, right=right, top=top, bottom=bottom, near=1.0, far=7.0
        )
        # Looking straight up or down, its camera is tilted by the engine's own 1e-4.
        np.testing.assert_allclose(
            corners_of(light, across, up, ahead, THREE_NUDGE), [[-1, -1, -1], [1, 1, 1]], atol=1e-3
        )
        return
    # The engine widens the window by a quarter of its size on each side, so this one is the same as above.
    middle, half = ((left + right) / 2, (top + bottom) / 2), ((right - left) / 3, (top - bottom) / 3)
    light = BabylonJs.directional_light(
        at,
        ahead,
        ortho_left=middle[0] - half[0],
        ortho_right=middle[0] + half[0],
        ortho_top=middle[1] + half[1],
        ortho_bottom=middle[1] - half[1],
        shadow_min_z=1.0,
        shadow_max_z=7.0,
        shadow_ortho_scale=0.25,
    )
    corners = corners_of(light, across, up, ahead, BABYLON_NUDGE)
    np.testing.assert_allclose(corners, [[1, -1, -1], [-1, 1, 1]], atol=1e-5)


def test_a_distance_replaces_far_and_none_leaves_it():
    for light in (ThreeJs.point_light, lambda at, **given: ThreeJs.spot_light(at, (0.0, 0.0, 0.0), **given)):
        left_out, zero, given = (
            light((0.0, 1.0, 0.0), far=7.0, **d) for d in ({}, {"distance": 0.0}, {"distance": 3.0})
        )
        assert [float(each.far) for each in (left_out, zero, given)] == [7.0, 7.0, 3.0]


def test_a_spot_lights_angle_is_to_the_side_in_one_engine_and_the_full_cone_in_the_other():
    three = ThreeJs.spot_light((0.0, 3.0, 0.0), angle=0.4, penumbra=0.25, focus=0.9, resolution=(64, 128), aspect=1.5)
    assert float(three.outer_angle) == pytest.approx(np.degrees(0.36))
    assert float(three.inner_angle) == pytest.approx(np.degrees(0.3))
    assert float(three.aspect) == pytest.approx(3.0)
    babylon = BabylonJs.spot_light(
        (0.0, 3.0, 0.0), (0.0, -1.0, 0.0), angle=0.8, shadow_min_z=1.0, shadow_max_z=9.0, shadow_angle_scale=0.5
    )
    assert float(babylon.outer_angle) == pytest.approx(np.degrees(0.2))


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: ThreeJs.directional_light((0.0, 1.0, 0.0), (0.0, 1.0, 0.0)), "direction"),
        (lambda: ThreeJs.directional_light((0.0, 1.0, 0.0), left=5.0, right=-5.0), "extent"),
        (lambda: ThreeJs.spot_light((0.0, 1.0, 0.0), angle=2.0), "angle"),
        (lambda: ThreeJs.point_light((0.0, 1.0, 0.0), near=3.0, distance=2.0), "near"),
    ],
    ids=["direction", "window", "angle", "near"],
)
def test_numbers_of_no_light_are_refused(make, said):
    with pytest.raises(ValueError, match=said):
        make()
