"""Sections of a fit of a shape."""

from collections.abc import Iterator, Mapping
from typing import Annotated, Any

from annotated_types import Len
from pydantic import Field

from ...settings import Form, fit
from ._lights import LightConfig
from ._scene import MeshConfig
from ._section import Conflict, Section, fault


class ShapePhaseConfig(Section, fit.ShapePhase):
    """A phase of a fit of a shape."""


def _default_phases() -> tuple[ShapePhaseConfig, ...]:
    return tuple(ShapePhaseConfig(**phase) for phase in fit.PHASES)


_Files = Annotated[tuple[str, ...], Form("a list of files", "[first.png, second.png]")]


class ShapeConfig(Section, fit.Shape):
    """A fit of all vertices of a mesh to its shadows on screens, one behind it for each light.

    Lights count as points, whatever their size. The shadows are images, or are traced from meshes: from the target of
    each light, or from the casters of the scene.
    """

    start: Annotated[
        MeshConfig | None,
        "mesh that the fit starts from; default: the scene's casters with images or targets, else a sphere of half "
        "their size",
    ] = None
    images: Annotated[_Files, "the shadow under each light, as the light sees it: dark on white"] = ()
    masks: Annotated[_Files, "how much each pixel of an image counts, from black for not at all to white"] = ()
    targets: Annotated[
        Annotated[tuple[MeshConfig, ...], Form("a list of meshes, each with a path")],
        "for each light a mesh, whose shadow under this light is traced",
    ] = ()
    unseen: Annotated[
        Annotated[tuple[LightConfig, ...], Form("a list of lights")],
        "lights that the fit does not see, for measuring the shape that casts the scene's shadows",
    ] = ()
    phases: Annotated[
        tuple[ShapePhaseConfig, ...], Len(1, 100), Form("a list of phases", "[{strength: 20, rate: 0.1, steps: 150}]")
    ] = Field(default_factory=_default_phases, description="the phases of the fit, in their order")

    @classmethod
    def conflicts(cls, data: Mapping[str, Any]) -> Iterator[Conflict]:
        if data.get("images") and data.get("targets"):
            yield ("targets",), fault("are given together with images", "one or the other", "remove one of them")
        if data.get("masks") and not data.get("images"):
            yield ("masks",), fault("are given without images", "images with them", "add images, or remove the masks")
        if data.get("off") and not data.get("moves"):
            yield ("off",), fault("is given without moves", "lights that move", "add moves, or remove off")
        if data.get("off") and data.get("images"):
            expected = "shadows traced under known lights"
            yield ("off",), fault("is given together with images", expected, "remove it: lights start where they stand")
        for key in ("images", "targets"):
            if data.get(key) and data.get("unseen"):
                expected = "shadows traced from the scene, since others show no single shape"
                yield ("unseen",), fault(f"is given together with {key}", expected, f"remove unseen or {key}")
