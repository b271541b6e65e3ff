"""Verdicts on fits: references that are no pictures of the scene, starts that are the best, and what to try."""

import dataclasses
from dataclasses import replace

import numpy as np
import pytest
from scenes import floor_and_card, side_camera, sun

from diffshadow import fit, reference, shadow
from diffshadow.config import parse_config
from diffshadow.geometry import Scene
from diffshadow.study._drawn import Drawn
from diffshadow.study.pages._table import knee_text
from diffshadow.study.record._runs import FrontPoint
from diffshadow.study.remarks._fit import remarks
from diffshadow.study.remarks._verdict import verdict
from diffshadow.study.runs._explained import Fitted, unexplained

SLANTED = np.array([0.5, -1.0, -0.3])


def scene(direction=SLANTED):
    mesh = floor_and_card()
    return Scene(mesh, side_camera((32, 32)), sun(mesh, direction))


SCENE = scene()
TRUE = reference.trace_visibility(SCENE, supersampling=4)
TURNS = {
    "flip the reference upside down": lambda image: image[::-1],
    "mirror the reference left to right": lambda image: image[:, ::-1],
    "turn the reference by 180 degrees": lambda image: image[::-1, ::-1],
}


def fitted(truth, image=None, *, given=True, to=None, key="scene.light"):
    """A fit to the reference `truth` that ended at `image`, or as rays see it, and moved the scene `to`."""
    of = dataclasses.replace(TRUE, visibility=np.asarray(truth, np.float32))
    drawn = Drawn(key, SCENE, None, None, of, TRUE.mask)
    return Fitted(drawn, TRUE.visibility if image is None else image, to, given)


@pytest.mark.parametrize(("words", "inverted"), list(zip(TURNS, [False, True, False], strict=True)))
def test_the_turn_that_makes_a_reference_a_picture_of_the_scene_is_found(words, inverted):
    truth = TURNS[words](1 - TRUE.visibility if inverted else TRUE.visibility)
    found = unexplained([fitted(truth)])
    assert found.keys == ["scene.light"]
    assert found.rmse == pytest.approx(np.sqrt(np.mean((TRUE.visibility - truth)[TRUE.mask] ** 2)), rel=1e-5)
    assert found.constant == pytest.approx(truth[TRUE.mask].std(), rel=1e-5)
    assert (found.change.turn, found.change.is_inverted) == (words, inverted)
    assert found.change.rmse < 0.3 * found.by_rays


def test_an_inverted_or_pale_reference_needs_no_turn():
    inverted = unexplained([fitted(1 - TRUE.visibility)]).change
    assert (inverted.turn, inverted.is_inverted) == ("", True)
    pale = unexplained([fitted(0.5 + 0.3 * TRUE.visibility)]).change
    assert (pale.turn, pale.is_inverted) == ("", False)
    assert (pale.low, pale.high) == pytest.approx((0.5, 0.8), abs=0.02)


@pytest.mark.parametrize(
    "truth",
    [
        TRUE.visibility,
        # Sampled at the pixels' centres.
        reference.trace_visibility(SCENE).visibility,
        # A sun that is a degree off.
        reference.trace_visibility(scene(SLANTED + np.array([0.02, 0, 0]))).visibility,
    ],
    ids=["same", "sharp", "near"],
)
def test_a_reference_of_the_scene_is_explained_however_coarse_the_fit_is(truth):
    # Visibility is smeared over several pixels, and some acne is left.
    coarse = np.clip(np.apply_along_axis(np.convolve, 1, TRUE.visibility, np.full(5, 0.2), "same"), 0, 1)
    coarse[::7] *= 0.6
    assert unexplained([fitted(truth, coarse)]) is None


def test_another_sun_or_another_scene_is_not_explained_and_no_turn_is_advised():
    for direction in ([-0.8, -1.0, 0.5], [0.25, -1.0, -0.3]):
        found = unexplained([fitted(reference.trace_visibility(scene(direction), supersampling=4).visibility)])
        assert found.keys == ["scene.light"]
        assert found.change is None
    # The second of two views alone.
    both = [fitted(TRUE.visibility, key="here"), fitted(1 - TRUE.visibility, key="there")]
    assert unexplained(both).keys == ["there"]


def test_of_a_traced_reference_rays_say_whether_the_light_was_found():
    away = scene([-0.5, -1.0, 0.6])
    lost = reference.trace_visibility(away).visibility
    found = unexplained([fitted(TRUE.visibility, lost, given=False, to=away)])
    assert found.keys == ["scene.light"]
    assert found.change is None
    assert unexplained([fitted(TRUE.visibility, lost, given=False, to=SCENE)]).keys == []


def test_a_technique_fails_only_where_a_constant_image_is_as_good():
    half = 0.4 + 0.6 * TRUE.visibility
    assert unexplained([fitted(TRUE.visibility, half, given=False)]) is None
    found = unexplained([fitted(TRUE.visibility, np.zeros_like(TRUE.visibility), given=False)])
    assert found.keys == []
    assert found.rmse > found.constant


# In words.

BASE = "scene: {meshes: [{path: builtin:box}], camera: {eye: [0, 0, 5]}}\n"
NAMES = ("bias.constant", "filter.radius")


def outcome(result="successful"):
    return fit.Outcome(0.1, 3, result, 1e-9, 0.01, (9.9999,))


TECHNIQUE = shadow.ShadowMapping(shadow.Nearest(), shadow.Bias())
MOVED = object.__new__(fit.Arrangement)
PARAMETERS = tuple(fit.Parameter(name, 2.0, 0.0, 10.0) for name in NAMES)


def result(errors=(0.2, 0.1), initial=2.0, values=5.0, **changes):
    at = lambda value: dict.fromkeys(NAMES, value)
    found = {"technique": TECHNIQUE, "initial": at(initial), "fitted": at(values), "phases": [outcome()], "chosen": 0}
    found |= {"history": [], "flat": [], "seconds_compiling": 0.0, "seconds_running": 0.0, "parameters": PARAMETERS}
    return fit.FitResult(**{**found, "errors": errors, **changes})


def test_a_start_that_is_the_best_is_no_failure():
    config = parse_config(BASE)
    on_bound = {"at_bounds": [fit.AtBound("bias.constant", "upper", 10.0, True)]}
    cut_short = {"phases": [outcome("max_steps reached")]}
    same = result((0.1, 0.1), values=2.0, chosen=-1, **cut_short)
    near = result((0.1004, 0.1), **cut_short, **on_bound)
    for found, said in ((same, "no values that the fit tried"), (near, "within 1 %: their RMSE is 0.1004, and the")):
        of = verdict(config, found, 0.1004, 0.1, None)
        assert of.kind == "best already"
        assert of.sentence.startswith("your settings are already the best")
        assert said in of.sentence
        assert remarks(config, found, of.kind) == []
    preferred = verdict(
        config, replace(near, sureness=fit.Sureness(prefer=(("bias.constant", "lower"),))), 0.1, 0.1005, None
    )
    assert "the values that fit.prefer chose have 0.1005" in preferred.sentence
    # Of several starts, another one may have led to the result.
    assert verdict(config, result((0.1, 0.1), initial=3.0), 0.2, 0.1, None).kind == "fitted"
    assert verdict(config, result((0.102, 0.1)), 0.102, 0.1, None).kind == "fitted"


def test_a_fit_without_any_slope_is_not_called_the_best():
    found = result((0.1, 0.1), values=2.0, chosen=-1, flat=list(NAMES))
    of = verdict(parse_config(BASE), found, 0.1, 0.1, None)
    assert of.kind == "nothing fitted"
    assert "does not change with bias.constant and filter.radius" in of.sentence


def test_a_fit_says_by_how_much_the_error_fell():
    config = parse_config(BASE)
    of = verdict(config, result(), 0.2, 0.1, None)
    assert of.sentence.endswith("from 0.2000 to 0.1000 RMSE, by a factor of 2.0, in 3 steps")
    of = verdict(config, result(), 0.1, 0.096, None)
    assert of.sentence.endswith("from 0.1000 to 0.0960 RMSE, by 4.0 %, in 3 steps")
    # Of another loss than the RMSE, which may rise.
    of = verdict(config, result(), 0.1, 0.11, None)
    assert "changed the RMSE from 0.1000 to 0.1100 in 3 steps; the fit's own loss fell from 0.04 to 0.01" in of.sentence


def test_an_unexplained_reference_comes_first_and_silences_what_means_nothing():
    config = parse_config(f"{BASE}reference: {{type: image, path: r.png}}", files=False)
    found = unexplained([fitted(TRUE.visibility[::-1])])
    on_bound = [fit.AtBound("filter.radius", "upper", 10.0, True)]
    fallen = result(at_bounds=on_bound, phases=[outcome("max_steps reached")])
    of = verdict(config, fallen, 0.5, 0.45, found)
    assert of.kind == "unexplained"
    assert of.sentence.startswith("the fit does not explain its image: ")
    assert of.remedies[0].startswith("flip the reference upside down: rays in this scene then differ from it by 0.0000")
    assert remarks(config, fallen, of.kind) == []
    moved = replace(fallen, arrangement=MOVED, precision=fit.Precision(NAMES, {}, [], [NAMES]))
    assert remarks(config, moved, of.kind) == []
    assert "the image hardly determines bias.constant and filter.radius" in remarks(config, moved)[0]


@pytest.mark.parametrize(
    ("truth", "moves", "starts", "said"),
    [
        (1 - TRUE.visibility[::-1], False, 1, ["flip the reference upside down and invert it: rays"]),
        (0.5 + 0.3 * TRUE.visibility, False, 1, ["stretch the reference's values: they are about 0.50 in shadow and"]),
        (
            None,
            False,
            1,
            ["flipping or inverting the reference does not help", "add scene.light.azimuth and scene.light.el"],
        ),
        (None, True, 1, ["try more starts, fit.multistart=8,", "the reference does not", "if the light is unknown"]),
        (None, True, 512, ["try more starts, fit.multistart=1024,", "the reference does not", "if the light"]),
    ],
)
def test_remedies_suit_what_is_wrong(truth, moves, starts, said):
    truth = reference.trace_visibility(scene([-0.8, -1.0, 0.5])).visibility if truth is None else truth
    found = unexplained([fitted(truth)])
    of = verdict(
        parse_config(BASE), result(arrangement=MOVED if moves else None, search=fit.Search(starts)), 0.5, 0.45, found
    )
    assert len(of.remedies) == len(said)
    for remedy, start in zip(of.remedies, said, strict=True):
        assert start in remedy


@pytest.mark.parametrize(
    ("name", "side", "bound", "falls", "said"),
    [
        ("bias.constant", "upper", 10.0, True, "where the error still falls: the best value may lie beyond it"),
        ("bias.constant", "upper", 10.0, False, None),
        ("bias.constant", "lower", 0.5, True, "so widen the bounds"),
        # No bias, no radius, or a limit of the key.
        ("bias.constant", "lower", 0.0, True, None),
        ("filter.radius", "lower", 0.0, True, None),
        ("bias.terms.one", "upper", 0.0, True, None),
        ("scene.light.azimuth", "upper", 0.0, True, "so widen the bounds"),
        ("scene.light.angular_radius", "lower", 0.0, True, None),
    ],
)
def test_wider_bounds_are_advised_only_where_the_error_falls_beyond_a_bound_that_is_no_limit(
    name, side, bound, falls, said
):
    config = parse_config(BASE.replace("}}", "}, light: {angular_radius: 1}}") + "bias: {terms: {one: 0}}")
    parameter = fit.Parameter(name, 0.0, -20.0, 20.0)
    found = result(at_bounds=[fit.AtBound(name, side, bound, falls)])
    told = remarks(config, replace(found, parameters=(parameter,)))
    assert len(told) == (said is not None)
    assert all(said in each for each in told)


@pytest.mark.parametrize(
    ("losses", "moves", "is_said"),
    [
        # By a twentieth and by a thousandth in the last quarter of its steps.
        ([1, 0.5, 0.3, 0.2, 0.15, 0.12, 0.1, 0.095], False, True),
        ([1, 0.5, 0.3, 0.2, 0.12, 0.1002, 0.1001, 0.1001], False, False),
        # Losses of poses change at every step.
        ([1, 0.5, 0.3, 0.2, 0.15, 0.12, 0.1, 0.095], True, False),
        ([1, 0.9, 0.8, 0.7, 0.6, 0.5, 0.4, 0.2], True, True),
    ],
)
def test_more_steps_are_advised_only_where_the_error_still_fell(losses, moves, is_said):
    history = [fit.Step(0, i, 0.0, loss, (5.0, 5.0)) for i, loss in enumerate(losses)]
    found = result(phases=[outcome("max_steps reached")], history=history, arrangement=MOVED if moves else None)
    told = remarks(parse_config(BASE), found)
    assert len(told) == is_said
    assert all("did not converge" in each and "raise fit.solver.max_steps" in each for each in told)


def test_a_front_of_fewer_points_than_asked_for_is_remarked_on():
    points = [fit.FrontPoint((5.0, 5.0), 0.1, 0.1, 1.0, 0.14)] * 3
    assert remarks(parse_config(BASE), result(front=points, sureness=fit.Sureness(front=3))) == []
    (said,) = remarks(parse_config(BASE), result(front=points, sureness=fit.Sureness(front=9)))
    assert said.startswith("fit.front is 9, and the front has 3 points: no other settings")
    # Of a fit that was made in Python.
    (said,) = remarks(None, result(front=points, sureness=fit.Sureness(front=9)))
    assert said.startswith("Sureness.front is 9, and the front has 3 points")


@pytest.mark.parametrize(
    ("errors", "knee", "said"),
    [
        (
            [0.2, 0.12, 0.1, 0.3],
            1,
            ["at the knee, the RMSE is 0.1200, 20.0% more than the lowest of the front, 0.1000"],
        ),
        ([0.2, 0.1, 0.3], 1, ["at the knee, the RMSE is 0.1000, the lowest of the front"]),
        ([0.2, 0.1], None, []),
        ([None, None, None], 1, []),
    ],
)
def test_what_the_knee_of_a_front_costs_is_said(errors, knee, said):
    point = {"values": {"bias.constant": 1.0}, "false_shadow": 0.1, "false_light": 0.1}
    front = [FrontPoint(**point, rmse=error, is_knee=i == knee) for i, error in enumerate(errors)]
    assert knee_text(front) == said


def test_a_solver_that_failed_is_reported_whatever_its_history():
    found = result(phases=[outcome("the loss is not finite near the solution")])
    (said,) = remarks(parse_config(BASE), found)
    assert said.endswith("the loss is not finite near the solution")


# Of pictures: the same remarks, in their own words.

OF_PICTURE = object.__new__(fit.PictureProblem)
COLOURED = f"{BASE}reference: {{type: picture}}"
ALBEDO = "scene.meshes.0.albedo.red"


@pytest.mark.parametrize(
    ("name", "side", "bound", "falls", "said"),
    [
        (
            ALBEDO,
            "upper",
            1.0,
            True,
            "That is the limit of scene.meshes.0.albedo.red, so wider bounds are not possible",
        ),
        (ALBEDO, "upper", 1.0, False, None),
        (ALBEDO, "upper", 0.9, True, "so widen the bounds"),
        ("shading.ambient.red", "lower", 0.0, True, "That is the limit of shading.ambient.red"),
        ("reference.exposure", "lower", -1.0, True, "so widen the bounds"),
    ],
)
def test_at_the_limit_of_a_number_of_a_picture_no_wider_bounds_are_advised(name, side, bound, falls, said):
    found = result(at_bounds=[fit.AtBound(name, side, bound, falls)], problems=(OF_PICTURE,), arrangement=MOVED)
    told = remarks(parse_config(COLOURED), replace(found, parameters=(fit.Parameter(name, 0.5, -20.0, 20.0),)))
    assert len(told) == (said is not None)
    for each in told:
        assert said in each
        assert ("widen" in each) == ("widen" in said)


def test_a_fit_that_was_cut_short_is_not_called_the_best():
    """With `max_steps` of 1, the loss is evaluated once in each phase: at the start."""
    phases = [outcome("max_steps reached")._replace(steps=1)] * 2
    history = [fit.Step(phase, 0, 0.1, 0.01, (2.0, 2.0)) for phase in range(2)]
    undetermined = fit.Precision(NAMES, {}, [], [NAMES])
    for problems, what in (((), "bias.constant"), ((OF_PICTURE,), "bias.constant")):
        found = result((0.1, 0.1), values=2.0, chosen=1, phases=phases, history=history, problems=problems)
        found = replace(found, arrangement=MOVED if problems else None, precision=undetermined)
        of = verdict(parse_config(COLOURED), found, 0.113, 0.113, None)
        assert of.kind == "cut short"
        assert "ended before it converged: its RMSE stayed at 0.1130 in 2 steps" in of.sentence
        told = remarks(parse_config(COLOURED), found, of.kind)
        assert told[0].startswith("the solver did not converge in the phase that gave the result")
        assert told[0].endswith("max_steps reached: raise fit.solver.max_steps")
        assert not any(f"hardly determines {what}" in each for each in told)
    # No phase was better than the start.
    lost = replace(found, chosen=-1)
    of = verdict(parse_config(COLOURED), lost, 0.113, 0.113, None)
    assert of.kind == "cut short"
    assert "in its last phase, and no phase ended better" in remarks(parse_config(COLOURED), lost, of.kind)[0]
    # A loss that had settled is no reason.
    settled = [fit.Step(1, i, 0.1, loss, (2.0, 2.0)) for i, loss in enumerate([1, 0.5, 0.1, 0.1, 0.1, 0.1, 0.1])]
    assert verdict(parse_config(BASE), replace(found, history=settled), 0.1, 0.1, None).kind == "best already"


def test_what_profiles_alone_gained_is_said():
    end = lambda value: fit.End(value, 0.1, False)
    profile = fit.Profile("bias.constant", (5.0, 0.1), [], [fit.Interval(0.01, end(4.9), end(5.1))])
    at_start = [outcome()._replace(values=(2.0, 2.0))]
    best = dict.fromkeys(NAMES, 5.0)
    by_profiles = result(phases=at_start, profiles=[profile], best=best)
    for found in (by_profiles, replace(by_profiles, chosen=-1)):
        (said,) = remarks(parse_config(BASE), found)
        assert said.startswith("the solver found nothing better than the start: the profiles of")
        assert "fit.intervals" in said
    by_solver = replace(by_profiles, phases=[outcome()._replace(values=(4.0, 5.0))])
    assert remarks(parse_config(BASE), by_solver) == []


def test_the_verdict_and_the_remarks_of_a_picture_name_the_picture():
    config, fell = parse_config(COLOURED), result(problems=(OF_PICTURE,), arrangement=MOVED)
    said = verdict(config, fell, 0.2, 0.1, None).sentence
    assert "reduced the picture's error from 0.2000 to 0.1000 RMSE, by a factor of 2.0" in said
    loose = replace(fell, flat=[ALBEDO], precision=fit.Precision(NAMES, {}, [], [NAMES]))
    flat, undetermined = remarks(config, loose)
    assert flat.startswith(f"{ALBEDO} was not fitted: its gradient is zero throughout, because no pixel of the picture")
    assert undetermined.startswith("the picture hardly determines bias.constant and filter.radius")
