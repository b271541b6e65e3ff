"""Sections of users' classes: their keys, their mistakes, and that their numbers are fitted."""

import pickle
import sys

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from diffshadow import fit, shadow
from diffshadow.config import (
    ConfigError,
    build_fit,
    build_scene,
    build_technique,
    describe,
    dump_resolved,
    parse_config,
)
from diffshadow.raster import draw_surface
from diffshadow.reference import trace_visibility

SOURCE = '''
from typing import Annotated, ClassVar, Literal

import equinox as eqx
import jax.numpy as jnp
from annotated_types import Le
from jaxtyping import Array, Float

from diffshadow import shadow
from diffshadow.settings import Fitted, Limits, Unit
from diffshadow.settings.filters import Filter


class Cross(shadow.AbstractFilter):
    """Four bilinear taps beside the centre."""

    radius: Float[Array, ""] = eqx.field(converter=jnp.asarray, default=1.5)
    gain: Annotated[Float[Array, ""], Limits(0, 2)] = eqx.field(converter=jnp.asarray, default=1.0)
    shape: Literal["plus", "times"] = eqx.field(static=True, default="plus")
    taps: int = eqx.field(static=True, default=4)
    hidden: object = eqx.field(static=True, default=None)

    @property
    def reach(self):
        return 2 * float(self.radius)

    def __call__(self, shadow_map, lookup, compare):
        tap = shadow.FourTap(self.radius)
        return self.gain * tap(shadow_map, lookup, compare)


class DescribedSettings(Filter):
    """A filter with settings of its own."""

    radius: Annotated[float, Limits(0, 9), Unit("texels"), Fitted(), "distance of the taps"] = 2.0


class Described(shadow.AbstractFilter):
    """Four taps."""

    settings: ClassVar = DescribedSettings

    radius: Float[Array, ""] = eqx.field(converter=jnp.asarray, default=DescribedSettings.radius)

    def __call__(self, shadow_map, lookup, compare):
        return shadow.FourTap(self.radius)(shadow_map, lookup, compare)


class Needy(Described):
    needed: float = eqx.field(kw_only=True)
    other: object = eqx.field(kw_only=True)

    settings: ClassVar = Filter.__mro__[1]


class Fussy(Described):
    def __check_init__(self):
        raise RuntimeError("never")


class Unfinished(shadow.AbstractFilter):
    radius: float = 1.0


class Lit(shadow.AbstractTechnique):
    """Nothing casts."""

    level: float = 0.75

    def prepare(self, scene, surface=None):
        return None

    def visibility(self, state, surface):
        return jnp.where(surface.mask, self.level, 1.0)

    def covered(self, state, surface):
        return surface.mask


class Offset(shadow.AbstractTechnique):
    """Shadow mapping with a bias as its one number."""

    lift: Float[Array, ""] = eqx.field(converter=jnp.asarray, default=1.0)
    compare: shadow.AbstractCompare = eqx.field(default_factory=shadow.HardCompare)

    def _mapping(self):
        settings = shadow.MapSettings((64, 64))
        return shadow.ShadowMapping(shadow.Bilinear(), shadow.Bias(self.lift), self.compare, settings)

    def lays_out(self, name):
        return False

    def prepare(self, scene, surface=None):
        return self._mapping().prepare(scene, surface)

    def visibility(self, state, surface):
        return self._mapping().visibility(state, surface)

    def covered(self, state, surface):
        return self._mapping().covered(state, surface)


class Power(eqx.Module):
    """Residuals whose squares are a power of the differences."""

    power: float = eqx.field(static=True, default=2.0)

    def __call__(self, predicted, reference, mask):
        away = jnp.where(mask, jnp.abs(predicted - reference), 0)
        return (away + 1e-6) ** (self.power / 2) / jnp.sqrt(jnp.sum(mask))


def absolute(predicted, reference, mask):
    return jnp.sum(jnp.abs(predicted - reference), where=mask) / jnp.sum(mask)


NUMBER = 4
'''
BASE = """
scene:
  meshes: [{path: builtin:plane, size: 3}, {path: builtin:box, size: 1}]
  camera: {eye: [2, 2, 2], target: [0, 0, 0], resolution: [64, 64]}
  light: {type: directional, direction: [0.5, -1, -0.3]}
shadow_map: {resolution: [64, 64]}
reference: {samples: 1}
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a user's module, which is found there."""
    path = tmp_path_factory.mktemp("plugins")
    (path / "own_pieces.py").write_text(SOURCE)
    (path / "broken_pieces.py").write_text("import no_such_module_at_all")
    yield path
    sys.modules.pop("own_pieces", None)
    if str(path) in sys.path:
        sys.path.remove(str(path))


@pytest.fixture
def load(folder):
    return lambda *overrides, **how: parse_config(BASE, overrides, folder=folder, **how)


def test_the_fields_of_a_users_filter_are_keys(load):
    config = load("filter={type: own_pieces:Cross, radius: 2, shape: times}")
    made = build_technique(config, fitting=False).filter
    assert (type(made).__name__, float(made.radius), float(made.gain), made.shape, made.taps) == (
        *("Cross", 2.0, 1.0, "times", 4),
    )
    assert config.reach({})[0] == pytest.approx(4.0 + config.bias.normal_offset)
    again = parse_config(dump_resolved(config))
    assert again == config
    assert pickle.loads(pickle.dumps(config)).filter == config.filter


def test_the_settings_of_a_users_filter_are_its_keys(load):
    config = load("filter={type: own_pieces:Described}")
    assert config.filter.radius == 2.0
    with pytest.raises(ConfigError, match=r"filter\.radius: is 10; expected a number at least 0 and at most 9"):
        load("filter={type: own_pieces:Described, radius: 10}")


@pytest.mark.parametrize(
    ("override", "message"),
    [
        (
            "filter={type: own_pieces:Cross, radios: 2}",
            "filter.radios: is not a key of filter (type: own_pieces:Cross)",
        ),
        ("filter={type: own_pieces:Cross, radius: wide}", "filter.radius: is 'wide'; expected a number"),
        ("filter={type: own_pieces:Cross, gain: 3}", "filter.gain: is 3; expected a number at least 0 and at most 2"),
        ("filter={type: own_pieces:Cross, taps: 1.5}", "filter.taps: is 1.5; expected a whole number"),
        ("filter={type: own_pieces:Cross, shape: round}", "filter.shape: is 'round'; expected plus or times"),
        ("filter={type: own_pieces:Needy}", "filter.type: is own_pieces:Needy, whose field other is not a number"),
        ("filter={type: own_pieces:Unfinished}", "filter.type: is own_pieces:Unfinished, which lacks __call__;"),
        ("filter={type: own_pieces:Power}", "filter.type: is own_pieces:Power, which is not a shadow.AbstractFilter;"),
        ("filter={type: own_pieces:Crossing}", "filter.type: names Crossing, which own_pieces does not have; expected"),
        ("filter={type: own_peaces:Cross}", "filter.type: names the module own_peaces, which Python does not find;"),
        ("filter={type: broken_pieces:Cross}", "cannot be imported (ModuleNotFoundError: No module named 'no_such_mod"),
        ("filter={type: 'own pieces:Cross'}", "filter.type: is own pieces:Cross; expected a module and a name in it;"),
        (
            "fit.loss={type: own_pieces:NUMBER}",
            "fit.loss.type: is own_pieces:NUMBER, which is not a function; expected",
        ),
        (
            "technique={type: own_pieces:Cross}",
            "which is not a shadow.AbstractTechnique; expected a class that inherits",
        ),
    ],
)
def test_each_mistake_is_one_error_at_its_place(override, message, load):
    with pytest.raises(ConfigError) as error:
        load(override)
    assert len(error.value.mistakes) == 1, error.value
    assert message in str(error.value)


def test_what_a_users_class_raises_is_a_mistake_of_the_configuration(load):
    config = load("filter={type: own_pieces:Fussy}")
    with pytest.raises(ConfigError, match=r"filter: cannot be made: own_pieces:Fussy raises RuntimeError: never"):
        build_technique(config)


def test_a_module_beside_the_configuration_is_not_mistaken_for_another(load, folder, tmp_path):
    load("filter={type: own_pieces:Cross}")
    (tmp_path / "own_pieces.py").write_text(SOURCE)
    with pytest.raises(ConfigError, match=r"names the module own_pieces beside the configuration, and another"):
        parse_config(BASE, ["filter={type: own_pieces:Cross}"], folder=tmp_path)


def test_nothing_is_imported_for_a_type_without_a_colon(load):
    with pytest.raises(ConfigError, match=r"filter\.type: is 'broken_pieces'; expected"):
        load("filter={type: broken_pieces}")
    assert "broken_pieces" not in sys.modules


@pytest.fixture(scope="module")
def fitted(folder):
    """A fit of a user's filter by a user's loss, as the command runs it."""
    overrides = [
        *("filter={type: own_pieces:Cross, radius: 1.5}", "fit.loss={type: own_pieces:Power, power: 1.5}"),
        "fit.parameters={filter.radius: {lower: 0.5, upper: 4}, bias.constant: {lower: 0, upper: 8}}",
        *("fit.solver.max_steps=8", "fit.anneal={start: 1.0, end: 0.2, phases: 2}"),
    ]
    config = parse_config(BASE, overrides, folder=folder, fitting=True)
    plan, scene = build_fit(config), build_scene(config)
    truth = trace_visibility(scene, samples=1)
    surface = draw_surface(scene.mesh, scene.camera)
    problem = fit.TechniqueProblem.of(scene, build_technique(config), truth, surface=surface)
    how = {"solver": plan.solver, "anneal": plan.anneal, "loss": plan.loss}
    return plan, fit.fit(problem, plan.parameters, **how)


@pytest.mark.exhaustive
def test_numbers_of_a_users_filter_are_fitted_by_a_users_loss(fitted):
    plan, result = fitted
    assert [p.path for p in plan.parameters] == ["filter.radius", "bias.constant.value"]
    assert plan.loss.power == 1.5
    assert result.errors[1] <= result.errors[0]
    assert result.fitted["filter.radius"] != result.initial["filter.radius"]
    assert result.flat == []


def test_a_users_loss_and_the_solver_have_to_suit_each_other(load):
    number = load("fit.loss={type: own_pieces:absolute}", fitting=True)
    with pytest.raises(ConfigError, match=r"fit\.loss: the loss returns a number, and levenberg_marquardt needs resid"):
        build_fit(number)
    minimised = load("fit.loss={type: own_pieces:absolute}", "fit.solver.type=bfgs", fitting=True)
    assert build_fit(minimised).loss is sys.modules["own_pieces"].absolute
    with pytest.raises(ConfigError, match=r"fit\.loss\.over: is not a key of fit\.loss \(type: own_pieces:absolute\)"):
        load("fit.loss={type: own_pieces:absolute, over: worst}")


@pytest.mark.exhaustive
def test_a_users_technique_is_drawn(load):
    config = load("technique={type: own_pieces:Lit, level: 0.5}")
    scene = build_scene(config)
    technique, surface = build_technique(config), draw_surface(scene.mesh, scene.camera)
    assert isinstance(technique, shadow.AbstractTechnique)
    seen = np.asarray(technique.visibility(technique.prepare(scene), surface))
    assert set(np.unique(seen)) <= {0.5, 1.0}
    with pytest.raises(ConfigError, match="is own_pieces:Lit, which has no compare and lays_out"):
        build_fit(config)


def test_numbers_of_a_users_technique_can_be_fitted(load):
    config = load(
        "technique={type: own_pieces:Offset, lift: 2}",
        "fit.parameters={technique.lift: {lower: 0, upper: 6}}",
        fitting=True,
    )
    (parameter,) = build_fit(config).parameters
    assert (parameter.name, parameter.path, parameter.initial) == ("technique.lift", "lift", 2.0)
    made = build_technique(config)
    assert isinstance(made, shadow.FittableTechnique)
    assert float(fit.resolve(made, parameter.path)) == 2.0
    assert eqx.is_array(made.lift)
    assert jnp.ndim(made.lift) == 0


def test_a_finished_run_is_read_without_its_users_modules(tmp_path):
    overrides = [
        *(
            "filter={type: gone_pieces:Cross, radius: 1.5, name: wide, taps: 3}",
            "fit.loss={type: gone_pieces:absolute}",
        ),
        *("technique={type: gone_pieces:Offset, lift: 2.0, at: [1.0, 2.5], limit: null}", "fit.solver.type=bfgs"),
        "fit.parameters={technique.lift: {lower: 0, upper: 6}}",
    ]
    with pytest.raises(ConfigError, match=r"filter\.type: names the module gone_pieces, which Python does not find"):
        parse_config(BASE, overrides, folder=tmp_path)
    read = parse_config(BASE, overrides, folder=tmp_path, files=False)
    rows = {row.key: row.value for row in describe(read)}
    assert rows["filter.type"] == "gone_pieces:Cross"
    assert (rows["filter.radius"], rows["filter.name"], rows["filter.taps"]) == ("1.5", "wide", "3")
    assert rows["technique.lift"] == "2.0"
    assert rows["fit.loss.type"] == "gone_pieces:absolute"
    assert list(read.fit.parameters) == ["technique.lift"]
    with pytest.raises(ConfigError, match="which Python does not find"):
        parse_config(BASE, overrides, folder=tmp_path)
