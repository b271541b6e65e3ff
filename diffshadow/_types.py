"""Named shapes.

`v` vertices, `f` faces, `h w` the rows and columns of an image or a shadow map, `n` anything counted.
Row 0 of an image is its *bottom* row, as in OpenGL's window coordinates. World space is right-handed,
`+y` is up; vectors are columns, `p_clip = projection @ world_to_eye @ p`, and matrices are stored row-major.
Depth is window depth in [0, 1] unless its name says otherwise.
"""

from collections.abc import Sequence
from typing import Any, TypeAlias

from jaxtyping import Array, ArrayLike, Bool, Float, Int
from numpy import ndarray

Scalar = Float[Array, ""]
Vec2 = Float[Array, "2"]
Vec3 = Float[Array, "3"]
Mat3 = Float[Array, "3 3"]
Mat4 = Float[Array, "4 4"]

Vertices = Float[Array, "v 3"]
ClipVertices = Float[Array, "v 4"]
Faces = Int[Array, "f 3"]

DepthMap = Float[Array, "h w"]
Visibility = Float[Array, "h w"]
Mask = Bool[Array, "h w"]
FaceMap = Int[Array, "h w"]
VectorMap = Float[Array, "h w 3"]
TexelMap = Float[Array, "h w 2"]

Resolution = tuple[int, int]
"""(height, width), in pixels of an image or texels of a shadow map."""

Viewport = tuple[int | Int[Array, ""], int | Int[Array, ""]]
"""A resolution whose value may be known only at run time."""

HostArray = ndarray
"""An array in the host's memory, for files and Embree."""

# Only mypy evaluates this as true.
MYPY = False
if MYPY:
    # A field with a converter accepts more types than it stores. Pyright understands converters. Mypy needs
    # descriptors.
    class AsScalar:
        """A field that stores a scalar and accepts any number."""

        def __get__(self, instance: Any, owner: Any) -> Scalar: ...

        def __set__(self, instance: Any, value: ArrayLike) -> None: ...

    class AsOptional:
        """A field that stores a scalar or `None` and accepts any number or `None`."""

        def __get__(self, instance: Any, owner: Any) -> Scalar | None: ...

        def __set__(self, instance: Any, value: ArrayLike | None) -> None: ...

    class AsVector:
        """A field that stores a vector and accepts any sequence of numbers."""

        def __get__(self, instance: Any, owner: Any) -> Array: ...

        def __set__(self, instance: Any, value: ArrayLike | Sequence[float | Scalar]) -> None: ...

    class AsScalars:
        """A field that stores scalars and accepts any numbers."""

        def __get__(self, instance: Any, owner: Any) -> tuple[Scalar, ...]: ...

        def __set__(self, instance: Any, value: Sequence[float | Scalar]) -> None: ...

    class AsOptionalScalars:
        """A field that stores scalars or `None` and accepts any numbers or `None`."""

        def __get__(self, instance: Any, owner: Any) -> tuple[Scalar, ...] | None: ...

        def __set__(self, instance: Any, value: Sequence[float | Scalar] | None) -> None: ...

    AsVec2 = AsVec3 = AsVector
else:
    # Explicit aliases, because pyright prefers them to the classes.
    AsScalar: TypeAlias = Scalar  # noqa: UP040
    AsOptional: TypeAlias = Scalar | None  # noqa: UP040  # pyright: ignore[reportOperatorIssue]
    AsVec2: TypeAlias = Vec2  # noqa: UP040
    AsVec3: TypeAlias = Vec3  # noqa: UP040
    AsScalars: TypeAlias = tuple[Scalar, ...]  # noqa: UP040
    AsOptionalScalars: TypeAlias = tuple[Scalar, ...] | None  # noqa: UP040
