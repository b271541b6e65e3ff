"""Fits to a picture. The shaded, antialiased image of a scene is compared."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..._arithmetic import as_float
from ..._types import Scalar
from ...geometry import AbstractCamera, AbstractLight, Edges, Mesh, Scene
from ...raster import AntialiasedSurface, AntialiasPlan, Surface, draw_antialiased, draw_surface, plan_antialiasing
from ...settings.fit import BLUR
from ...settings.reference import Encoding, PictureReference
from ...shading import AbstractShading, Phong, to_srgb
from ...shadow import MapSettings, Overflow, ShadowMap, ShadowMapping
from .._arrangement import Arrangement
from .._own_loss import Seen
from ._abstract import any_overflow
from ._arranged import ArrangedProblem, points_for, weighted_difference, with_silhouettes

# The initial memory for pieces of outlines, as a multiple of the pieces at the start. If more are needed, phases are
# repeated.
_MORE_PIECES = 2.0


class PictureProblem(ArrangedProblem):
    """An arrangement, a picture of the scene under all of its lights, and everything that the fit does not change.

    Paths lead to numbers of camera, lights, meshes, colours and technique: `camera.turn.y`, `lights.0.azimuth`,
    `meshes.0.albedo.red`, `shading.intensities.1.green`, `exposure`. The three channels are compared as three images.

    - `arrangement`: whose numbers are fitted.
    - `scene`: meshes, camera and lights before the arrangement moves them.
    - `reference`: (h, w, 3), the picture.
    - `weight`: (h, w), the weight of each pixel: 0 or 1, or in between if the pixel is a mean over several.
    - `encoding`: encoding of the reference. The drawn picture is encoded in the same way. As sRGB, it is clipped to 0
        and 1.
    - `settings`: how maps are drawn. Derivatives see the shadow's outline move only with silhouettes.
    - `surface`: the surface that the camera sees; `None` to draw it again at every step. This is necessary if the
      camera or meshes move, or if meshes change their colour.
    - `plan`: as for `draw_antialiased`; `crossings`: one for each light's map, as for `draw_shadow_map`. `planned`
        finds both.
    - `edges`, `blur`, `shift`, `shadow_points`: as for `PoseProblem`.

    !!! Example

        ```python
        problem = fit.PictureProblem.of(scene, technique, np.zeros((32, 32, 3)))
        turn = fit.Parameter("camera.turn.y", 0.0, -5.0, 5.0, unit="degrees")
        ```
    """

    arrangement: Arrangement
    scene: Scene
    reference: Float[Array, "h w 3"]
    weight: Float[Array, "h w"]
    encoding: Encoding = eqx.field(static=True, default="linear")
    settings: MapSettings = eqx.field(static=True, default=MapSettings(silhouettes=True))
    surface: AntialiasedSurface | None = None
    plan: AntialiasPlan | None = None
    crossings: tuple[int, ...] | None = eqx.field(static=True, default=None)
    edges: Edges | None = None
    blur: Scalar = eqx.field(converter=as_float, default=BLUR)
    shift: Float[Array, "2"] | None = None
    shadow_points: int = eqx.field(static=True, default=1)

    @classmethod
    def of(
        cls,
        scene: Scene,
        technique: ShadowMapping,
        picture: Float[Array | np.ndarray, "h w 3"],
        *,
        shading: AbstractShading | None = None,
        mask: Bool[Array | np.ndarray, "h w"] | None = None,
        encoding: Encoding = "linear",
        exposure: float = PictureReference.exposure,
        arrangement: Arrangement | None = None,
        surface: AntialiasedSurface | None = None,
        points: int | None = None,
    ) -> "PictureProblem":
        """A problem that compares a scene with a picture.

        **Arguments:**

        - `technique`: its `map` defines how maps are drawn. They have silhouettes unless it sets them to `False`.
        - `picture`: (h, w, 3), as large as the camera's image. Row 0 is the bottom row.
        - `shading`: the scene's shading; by default `Phong()`. Its `intensities` are fitted one by one.
        - `mask`: (h, w), the pixels that count; by default all.
        - `encoding`: encoding of the picture; `exposure`: the brightening of the drawn picture in stops.
        - `arrangement`: the start, with its own shading and exposure; by default all values of the scene.
        - `surface`: the surface that the camera sees, if neither the camera nor meshes move and no mesh changes its
          colour. Otherwise it is drawn again at every step.
        - `points`: `shadow_points`; by default chosen from the width of a texel.

        **Raises** `ValueError` for a picture of another size, or that is not finite where it counts.
        """
        height, width = scene.camera.resolution
        reference, counts = as_float(picture), np.ones((height, width), bool) if mask is None else np.asarray(mask)
        if reference.shape != (height, width, 3) or counts.shape != (height, width):
            raise ValueError(
                f"the picture has shape {reference.shape}, and the mask {counts.shape}; expected {height} rows and "
                f"{width} columns, as the camera's resolution, and three channels in the picture: resize them, or "
                "change the camera's resolution"
            )
        if not np.isfinite(np.asarray(reference)[counts]).all():
            raise ValueError("the picture has pixels that are not finite; expected numbers: mask them out")
        given = arrangement
        if given is None:
            given = Arrangement.of_picture(technique, scene, shading or Phong(), exposure)
        problem = cls(
            shadow_points=points_for(scene, technique) if points is None else points,
            arrangement=given,
            scene=scene,
            reference=jnp.where(counts[..., None], reference, 0),
            weight=as_float(counts),
            encoding=encoding,
            settings=with_silhouettes(technique.map),
            surface=surface,
        )
        # Now instead of in `padded`, where edges would need other numbers.
        return dataclasses.replace(problem, scene=dataclasses.replace(scene, meshes=problem.padded_meshes()))

    @property
    def count(self) -> Float[Array, "3"]:
        """The number of pixels that count in each channel."""
        return jnp.broadcast_to(jnp.sum(self.weight), 3)

    def difference(self, subject: Arrangement) -> Float[Array, "3 h w"]:
        """Each channel of the picture minus the reference's channel, times the square root of the pixel's weight."""
        return weighted_difference(_channels(self.picture(subject)), _channels(self.reference), self.weight)

    def difference_and_overflow(self, subject: Arrangement) -> tuple[Float[Array, "3 h w"], Overflow | None]:
        """The difference, and a flag that replaces an error: whether outlines or silhouettes are missing."""
        maps, seen, camera = self.draw(subject, raises=False)
        image = _channels(self.image(maps, seen, camera, subject))
        return weighted_difference(image, _channels(self.reference), self.weight), _overflow(maps, seen)

    def seen(self, subject: Arrangement) -> tuple[Seen, Overflow | None]:
        """The three channels that a user's loss compares, and whether outlines or silhouettes are missing."""
        maps, seen, camera = self.draw(subject, raises=False)
        image = _channels(self.image(maps, seen, camera, subject))
        mask = jnp.broadcast_to(self.weight > 0, image.shape)
        return Seen.of(image, _channels(self.reference), mask), _overflow(maps, seen)

    def picture(self, arrangement: Arrangement) -> Float[Array, "h w 3"]:
        """The picture of an arrangement, encoded like the reference.

        **Raises** a runtime error if there are more outlines or silhouettes than `planned` has memory for.
        """
        return self.image(*self.draw(arrangement), arrangement)

    def image(
        self, maps: list[ShadowMap], seen: AntialiasedSurface, camera: AbstractCamera, arrangement: Arrangement
    ) -> Float[Array, "h w 3"]:
        """The picture of an arrangement whose maps and surface are already drawn."""
        points = _points(seen, camera, self.shadow_points)
        visibility = [
            _over_pixels(seen, arrangement.technique.visibility(each, points), self.shadow_points) for each in maps
        ]
        return _shaded(arrangement, seen, visibility, [each.light for each in maps], camera, self.encoding)

    def draw(
        self, arrangement: Arrangement, *, raises: bool = True
    ) -> tuple[list[ShadowMap], AntialiasedSurface, AbstractCamera]:
        """The maps of all lights, the surface that the camera sees, and the camera.

        **Arguments:** `raises` as for `draw_shadow_map`.
        """
        casters, lights, every, camera = _arranged(self.scene, arrangement)
        seen = self.surface
        if seen is None:
            seen = draw_antialiased(every, camera, self.plan, raises=raises)
        crossings = (None,) * len(lights) if self.crossings is None else self.crossings
        maps = [
            self.draw_map(casters, light, camera, arrangement.technique, seen.centres, most, raises=raises)
            for light, most in zip(lights, crossings, strict=True)
        ]
        return maps, seen, camera

    def planned(self) -> "PictureProblem":
        """This problem with memory for several times the outlines and silhouettes of its arrangement, and at least as
        much as before."""
        casters, lights, every, camera = _arranged(self.scene, self.arrangement)
        edges, plan, surface = self.edges_of_casters(), self.plan, None
        if self.surface is not None:
            surface = self.surface.centres
        else:
            plan = _larger(plan_antialiasing(every, camera, margin=_MORE_PIECES), self.plan)
            if self.arrangement.technique.layout.needs_surface:
                surface = draw_surface(every, camera)
        planned = dataclasses.replace(self, plan=plan, edges=edges)
        if edges is None:
            return planned
        before = (None,) * len(lights) if self.crossings is None else self.crossings
        crossings = [
            self.planned_crossings(casters, light, camera, surface, most)
            for light, most in zip(lights, before, strict=True)
        ]
        return dataclasses.replace(planned, crossings=tuple(crossings))

    def with_memory_of(self, other: "PictureProblem") -> "PictureProblem":
        """This problem with as much memory for outlines and silhouettes as `other`."""
        return dataclasses.replace(self, plan=other.plan, crossings=other.crossings, edges=other.edges)

    def padded(self) -> "PictureProblem":
        """The problem itself, because `of` has padded its meshes."""
        return self


# These are compiled separately, so that a drawing outside of `jit` shares programs with all others.
@eqx.filter_jit
def _points(seen: AntialiasedSurface, camera: AbstractCamera, count: int) -> Surface:
    return seen.surface if count == 1 else seen.with_points_within(camera, count)


@eqx.filter_jit
def _over_pixels(seen: AntialiasedSurface, visibility: Float[Array, "y w"], count: int) -> Float[Array, "H w"]:
    return visibility if count == 1 else seen.mean_within(visibility, count)


def _larger(plan: AntialiasPlan, before: AntialiasPlan | None) -> AntialiasPlan:
    if before is None:
        return plan
    return dataclasses.replace(
        plan, pieces=max(plan.pieces, before.pieces), crossings=max(plan.crossings, before.crossings)
    )


def _overflow(maps: list[ShadowMap], seen: AntialiasedSurface) -> Overflow:
    return any_overflow([seen.overflow, *(each.overflow for each in maps)])


def _channels(image: Float[Array, "h w 3"]) -> Float[Array, "3 h w"]:
    return jnp.moveaxis(image, -1, 0)


@eqx.filter_jit
def _arranged(scene: Scene, arrangement: Arrangement) -> tuple[Mesh, list[AbstractLight], Mesh, AbstractCamera]:
    """The casters, the lights, all meshes, and the camera, as they are arranged."""
    placed = arrangement.placed(scene)
    return placed.casters, list(placed.lights), placed.mesh, placed.camera


@eqx.filter_jit
def _shaded(
    arrangement: Arrangement,
    seen: AntialiasedSurface,
    visibility: list[Array],
    lights: list[AbstractLight],
    camera: AbstractCamera,
    encoding: Encoding,
) -> Float[Array, "h w 3"]:
    assert arrangement.shading is not None
    linear = arrangement.shading.antialiased(seen, visibility, lights, camera)
    if arrangement.exposure is not None:
        linear = linear * 2**arrangement.exposure
    return to_srgb(jnp.clip(linear, 0, 1)) if encoding == "srgb" else linear
