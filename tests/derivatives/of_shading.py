"""Colours of lit surfaces."""

import dataclasses

import jax.numpy as jnp

from diffshadow import geometry, shading
from diffshadow.fit.problems._picture import _shaded
from diffshadow.geometry import LightPose, Vector
from diffshadow.shading import Attenuation, Colour, ModulatedShadow, Phong

from . import numbers, row, surface_of
from .of_geometry import spot, sun
from .of_raster import _made
from .of_shadow import points


def _camera(eye=(1.4, 1.8, 2.2)):
    return geometry.PinholeCamera(eye, (0.1, 0.2, 0), (0.1, 1, 0), 41, 0.7, 6, (2, 3))


def _surface(x=0.0):
    place, normal = points()
    behind = jnp.asarray([[False, False, True], [False, False, False]])
    own = normal * jnp.where(behind, -1.7, 1.7)[..., None] + 0.1 * numbers(30, 2, 3, 3)
    seen = surface_of(place + x, normal, interpolated_normal=own, albedo=numbers(31, 2, 3, 3), from_behind=behind)
    # One pixel sees the background.
    return dataclasses.replace(seen, mask=jnp.asarray([[True, True, True], [True, True, False]]))


_COLOURS = "red", "green", "blue"
_PATHS = [f"shading.{field}.{colour}" for field in ("ambient", "intensity", "background") for colour in _COLOURS]


@row(
    "colours of two lights",
    [0.3, 0.2, 0.1, 0.7, 0.8, 0.9, 0.5, 0.4, 0.3, 0.6, 0.2, 0.9, 0.35, 12.0, 0.8, 0.3, 0.2],
    " ".join([*_PATHS, *(f"shading.intensities.{colour}" for colour in _COLOURS)])
    + " shading.specular shading.shininess shading.attenuation.constant shading.attenuation.linear "
    "shading.attenuation.quadratic shading.Phong shading.Colour shading.Attenuation shading.AbstractShading",
)
def _():
    seen = numbers(32, 2, 2, 3)

    def of(x):
        lights = Colour(*x[3:6]), Colour(*x[6:9])
        falls = Attenuation(*x[14:])
        given = {"specular": x[12], "shininess": x[13], "attenuation": falls, "background": Colour(*x[9:12])}
        both = [
            Phong(Colour(*x[:3]), intensities=lights, model="blinn_phong", **given),
            Phong(Colour(*x[:3]), Colour(*x[3:6]), model="phong", **given),
        ]
        return [each(_surface(), seen, (spot(), sun()), _camera()) for each in both]

    return of


@row(
    "colours by light, camera, surface and visibility",
    [0.9, 2.1, 0.8, 31.0, 62.0, 1.4, 1.8, 2.2, 0.1, -0.2, 0.05, 0.3],
    step=1e-4,
)
def _():
    seen = numbers(32, 2, 3)

    def of(x):
        light = spot(inner_angle=11.0).at(LightPose(Vector(*x[:3]), x[3], x[4], spot().radius))
        falls = Attenuation(0.8, 0.3, 0.2)
        return [
            Phong(specular=0.4, shininess=9.0, attenuation=falls, model=model)(
                _surface(x[8:11]), seen * x[11], light, _camera(x[5:8])
            )
            for model in ("blinn_phong", "phong")
        ]

    return of


@row("shadow that darkens the picture", [0.3, 0.6], "shading.factor shading.ModulatedShadow")
def _():
    seen = numbers(32, 2, 2, 3)
    return lambda x: ModulatedShadow(Phong(0.3), x[0])(_surface(), seen * x[1], (spot(), sun()), _camera())


@row("the exposure of an antialiased picture", [0.4, 0.3, -0.2, 0.2, 0.3], "exposure shading.to_srgb")
def _():
    from diffshadow import fit, shadow

    technique = shadow.ShadowMapping(shadow.Bilinear(), shadow.ConstantBias(0.0))
    own = fit.Arrangement(technique, (), (), shading=Phong(0.2))
    seen = numbers(33, 4, 3)

    def of(x):
        surface = _made(jnp.concatenate([x[1:3], jnp.zeros(1), x[3:5], jnp.zeros(1)]))
        moved = dataclasses.replace(own, exposure=x[0])
        pictures = [_shaded(moved, surface, [seen], [sun()], _camera(), how) for how in ("linear", "srgb")]
        return pictures, shading.to_srgb(x[:1])

    return of
