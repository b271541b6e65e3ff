"""Derivatives of all that has any: against central differences in magnitude, and reverse mode against forward mode.

A row of the table is a function of a few numbers in float64. It draws nothing: small pieces are called by themselves,
with faces and maps that are made by hand. Rows are in `derivatives/`, one file for each subpackage.
"""

import re

import numpy as np
import pytest
from derivatives import ROWS, found, of_engines, of_fit, of_geometry, of_raster, of_shading, of_shadow  # noqa: F401

from diffshadow import fit, geometry, raster, shading, shadow
from diffshadow.fit import Arrangement, MeshPose, parameter_names
from diffshadow.settings import Fitted, Settings
from diffshadow.shading import Attenuation, ModulatedShadow, Phong

NAMES = list(ROWS)
COVERED = frozenset().union(*(row.covers for row in ROWS.values()))

WITHOUT = {
    "what is read or made on the host, and is no number of a fit": """
        geometry.LIBRARY geometry.library_mesh geometry.OptionError geometry.Edges geometry.WORLD geometry.Origin
        geometry.PrecisionWarning geometry.crease_normals geometry.split_in_four geometry.weld shadow.EngineLight
        shadow.bias_for shadow.engine_code shadow.engine_settings shadow.radius_settings shadow.shader_buffers
        shadow.to_shader""",
    "choices of names": """
        geometry.CascadeSelection raster.Cull shadow.BabylonFilter shadow.BabylonQuality shadow.DiskMapping
        shadow.LevelNorm shadow.Side shadow.WarpMethod""",
    "interfaces, whose kinds have rows": "geometry.AbstractCamera geometry.AbstractLight",
    "which face is seen, and what is counted or compared by bits": """
        raster.NO_FACE raster.SUBPIXELS raster.DepthTest raster.Fragments raster.count_fragments raster.rasterize
        raster.rasterize_depth shadow.Overflow shadow.Atlas""",
    "hard shadows without a map: a yes or no at each point": """
        shadow.IrregularScene shadow.IrregularZBuffer shadow.ShadowVolumes shadow.VolumeScene shadow.Volumes
        shadow.shadow_volumes""",
    "layouts whose numbers only lay out the map, whose texels jump": "shadow.PerspectiveWarp shadow.ResolutionMatched",
    "patterns of taps, which stay": """
        shadow.Pattern shadow.halton shadow.poisson_disk shadow.sobol shadow.stratified shadow.uniform shadow.vogel""",
    "how fits run, and what they found; what they minimise has rows": """
        fit.SHAPE_PHASES fit.Anneal fit.AtBound fit.Bound fit.End fit.FitResult fit.FittedShape fit.FrontPoint
        fit.Interval fit.Outcome fit.Precision fit.Profile fit.Search fit.ShapePhase fit.ShapeProblem fit.ShapeState
        fit.ShapeStep fit.ShapeView fit.Solver fit.Start fit.Step fit.Sureness fit.Training fit.TrainingPhase fit.fit
        fit.fit_shape fit.hull_start fit.mean_square_error fit.train""",
}
"""Public names without a derivative, by the reason."""


def scale_of(*leaves):
    return max(np.abs(leaf).max(initial=0) for leaf in leaves)


@pytest.mark.parametrize("name", NAMES)
def test_value_is_finite_and_follows_each_number(name):
    known = found(name)
    assert all(np.isfinite(value).all() for value in known.values)
    for number in range(len(ROWS[name].at)):
        pairs = zip(known.differences, known.values, strict=True)
        changes = [scale_of(slope[number]) / max(scale_of(value), 1e-3) for slope, value in pairs]
        assert max(changes) > 1e-6, f"number {number} changes nothing"


@pytest.mark.parametrize("name", NAMES)
def test_forward_mode_equals_central_differences(name):
    known, made = found(name), ROWS[name]
    if made.is_still:
        assert all((slope == 0).all() for slope in known.forward)
        return
    leaves = zip(known.forward, known.differences, known.values, strict=True)
    for leaf, (slope, difference, value) in enumerate(leaves):
        for number in range(len(made.at)):
            most, off = scale_of(slope[number], difference[number]), scale_of(slope[number] - difference[number])
            rounding = 1e-14 / made.step * max(scale_of(value), 1.0)
            assert off <= made.tolerance * most + rounding, f"leaf {leaf} by number {number}: {off:.3g} of {most:.3g}"


@pytest.mark.parametrize("name", [name for name in NAMES if ROWS[name].backward])
def test_reverse_mode_agrees_with_forward_mode(name):
    known = found(name)
    np.testing.assert_allclose(known.backward, known.expected, rtol=1e-8, atol=1e-9 * scale_of(known.expected))


def kinds_of(kind):
    """The classes of settings below one that have none below them. A configuration has classes of its own."""
    below = [each for each in kind.__subclasses__() if each.__module__.startswith("diffshadow.settings.")]
    return set().union(*map(kinds_of, below)) if below else {kind}


def test_each_fitted_setting_has_a_row():
    """But for those that a search finds, since visibility has no derivative by them."""
    fitted = {
        f"{kind.__name__}.{key}"
        for kind in kinds_of(Settings)
        for key, setting in kind.each().items()
        if any(isinstance(mark, Fitted) and not mark.searched for mark in setting.marks)
    }
    assert len(fitted) > 40
    assert fitted <= COVERED, sorted(fitted - COVERED)


LIGHTS = {
    "directional": of_geometry.sun,
    "spot": of_geometry.spot,
    "point": of_geometry.lamp,
    "rectangle": of_geometry.panel,
}


def test_each_number_of_an_arrangement_has_a_row():
    mesh, lights = of_geometry.pyramid(), [light() for light in LIGHTS.values()]
    matrices = of_geometry.spot().view()
    cameras = {
        "pinhole": geometry.PinholeCamera((1, 2, 3), (0, 0, 0)),
        "orthographic": geometry.OrthographicCamera((1, 2, 3), (0, 0, 0)),
        "matrix": geometry.MatrixCamera(matrices.world_to_eye, matrices.eye_to_clip),
    }
    technique = shadow.ShadowMapping(shadow.Nearest(), shadow.ConstantBias(0.0))
    phong = Phong(intensities=[0.3, 0.4], attenuation=Attenuation(1.0, 0.1, 0.1))
    plain = Arrangement.of(technique, lights, [MeshPose.of(mesh, [3], coloured=True)])
    names = set()
    for kind, camera in cameras.items():
        scene = geometry.Scene([mesh], camera, lights)
        for look in (phong, ModulatedShadow(phong)):
            for name in parameter_names(plain.pictured(scene, look, 0.0)):
                name = re.sub(r"^lights\.(\d)", lambda found: "lights." + list(LIGHTS)[int(found[1])], name)
                name = re.sub(r"\.\d+(?=\.)", "", name).replace("shading.lit.", "shading.")
                names.add(name.replace("camera.", f"camera.{kind}."))
    names = {name for name in names if not name.startswith("technique.")}
    assert len(names) > 60
    assert names <= COVERED, sorted(names - COVERED)


def test_each_public_name_has_a_row_or_a_reason():
    public = {
        f"{part.__name__.split('.')[-1]}.{name}"
        for part in (fit, geometry, raster, shading, shadow)
        for name in part.__all__
    }
    without = [name for names in WITHOUT.values() for name in names.split()]
    assert len(set(without)) == len(without)
    assert public <= COVERED | set(without), sorted(public - COVERED - set(without))
    assert set(without) <= public - COVERED, sorted(set(without) - (public - COVERED))
