"""How objects show themselves: as text with their numbers, and in notebooks with a picture."""

import base64
import io
import re
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from PIL import Image

from diffshadow import fit, geometry, raster, reference, shadow
from diffshadow._words import counted

CAMERA = geometry.PinholeCamera((2.0, 2.0, 3.0), (0.0, 0.3, 0.0), near=0.1, far=20.0, resolution=(24, 32))
# The floor reaches behind the camera.
MESHES = [geometry.library_mesh("torus", segments=16, sides=8), geometry.library_mesh("plane", size=12.0)]
LIGHT = geometry.DirectionalLight((0.5, -1.0, -0.3), (0.0, 0.0, 0.0), (4.0, 4.0), -4.0, 4.0)
SCENE = geometry.Scene(MESHES, CAMERA, LIGHT)


def picture(shown):
    """The picture, row 0 at the bottom, in [0, 1]."""
    (data,) = re.findall(r'src="data:image/png;base64,([^"]+)"', shown)
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(data))))[::-1] / 255


@pytest.mark.parametrize(
    ("count", "noun", "words"),
    [
        (1, "entry", "1 entry"),
        (0, "entry", "0 entries"),
        (2, "key", "2 keys"),
        (3, "mesh", "3 meshes"),
        (1024, "pixel", "1,024 pixels"),
        (2, "face of fewer than three corners", "2 faces of fewer than three corners"),
    ],
)
def test_numbers_of_things_have_their_plural(count, noun, words):
    assert counted(count, noun) == words


def test_single_numbers_are_shown_and_traced_ones_by_shape():
    bias = shadow.ConstantBias(1.5)
    assert repr(bias) == "ConstantBias(value=1.5)"
    assert "fov_y=40.0" in repr(SCENE)
    assert "value=0.1," not in repr(shadow.Bias(constant=0.1))  # without the digits of double precision
    assert "constant=ConstantBias(value=0.1)" in repr(shadow.Bias(constant=0.1))
    shown = []
    jax.jit(lambda one: shown.append(repr(one)))(bias)
    jax.vmap(lambda value: shown.append(repr(shadow.ConstantBias(value))))(jnp.arange(3.0))
    assert shown == 2 * ["ConstantBias(value=f32[])"]


@pytest.mark.exhaustive
def test_a_scene_shows_the_faces_that_its_camera_sees():
    camera = geometry.PinholeCamera(CAMERA.eye, CAMERA.target, near=0.1, far=20.0, resolution=(120, 160))
    shown = geometry.Scene(MESHES, camera, LIGHT)._repr_html_()
    assert "2 meshes, 258 triangles; DirectionalLight; 160 x 120 pixels" in shown
    surface = raster.draw_surface(SCENE.mesh, camera)
    drawn = (picture(shown) < 1).any(axis=-1)
    # Rounding decides at outlines alone.
    assert (drawn != np.asarray(surface.mask)).mean() < 1e-3
    is_floor = np.asarray(surface.normal)[..., 1] > 0.9999
    grey = np.where(is_floor, picture(shown)[..., 0], np.nan)
    assert np.nanstd(grey[is_floor]) < 0.02


def test_meshes_maps_surfaces_and_references_have_pictures():
    shown = MESHES[0]._repr_html_()
    assert "Mesh: 256 triangles, 128 vertices" in shown
    assert 0.1 < (picture(shown) < 1).mean() < 0.6
    surface = raster.draw_surface(SCENE.mesh, CAMERA)
    np.testing.assert_array_equal((picture(surface._repr_html_()) < 1).any(axis=-1), surface.mask)
    light_map = shadow.draw_shadow_map(SCENE.mesh, LIGHT, (32, 24))
    assert "24 x 32 texels" in light_map._repr_html_()
    np.testing.assert_array_equal(picture(light_map._repr_html_()) < 1, np.asarray(light_map.depth) < 1)
    truth = reference.trace_visibility(SCENE)
    np.testing.assert_allclose(picture(truth._repr_html_()), truth.visibility, atol=0.5 / 255)


def test_large_images_are_shown_small_and_traced_objects_as_text():
    large = reference.reference_from_image(np.ones((24, 32), np.float32), SCENE)
    assert "given" in large._repr_html_()
    wide = geometry.PinholeCamera(CAMERA.eye, CAMERA.target, near=0.1, far=20.0, resolution=(8, 600))
    assert max(picture(geometry.Scene(MESHES, wide, LIGHT)._repr_html_()).shape) <= 256
    shown = []
    jax.jit(lambda mesh: shown.append(mesh._repr_html_()))(MESHES[0])
    assert shown == [None]


@pytest.mark.parametrize("has_problem", [True, False])
def test_a_fit_shows_its_table_and_its_reference(has_problem):
    truth = reference.trace_visibility(SCENE)
    technique = shadow.ShadowMapping(shadow.Nearest(), shadow.Bias(constant=1.0), map=shadow.MapSettings((32, 32)))
    problems = (fit.TechniqueProblem.of(SCENE, technique, truth),) if has_problem else ()
    values = {"initial": {"bias.<constant>": 1.0}, "fitted": {"bias.<constant>": 2.5}}
    of_steps = {"phases": [], "chosen": 0, "history": [], "flat": [], "seconds_compiling": 0.0, "seconds_running": 0.0}
    result = fit.FitResult(technique=technique, **values, **of_steps, problems=problems, errors=(0.5, 0.25))
    shown = result._repr_html_()
    assert "<td>bias.&lt;constant&gt;</td><td>1</td><td>2.5</td>" in shown
    assert "<td>error</td><td>0.5000</td><td>0.2500</td>" in shown
    assert ("<img" in shown) == has_problem
    if has_problem:
        np.testing.assert_allclose(picture(shown), truth.visibility, atol=0.5 / 255)


@pytest.mark.exhaustive
def test_pictures_need_no_matplotlib():
    program = "import sys; from diffshadow import geometry; geometry.library_mesh('box')._repr_html_(); "
    check = "assert not {'matplotlib', 'PIL', 'trimesh'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", program + check], check=True)
