"""Techniques that need whole faces without an alpha test."""

from ..geometry import Mesh


def check_whole_faces(casters: Mesh, what: str, mend: str) -> None:
    """**Raises** `ValueError` if an alpha test cuts out parts of `casters`.

    **Arguments:** `what`: the user of whole faces' outlines, a plural; `mend`: how to avoid it.
    """
    if casters.alpha_test is not None:
        raise ValueError(
            f"a mesh has an alpha test (alpha_cutoff), and {what} know only the outlines of whole faces, not of "
            f"the parts that are cut out; expected meshes without an alpha test: {mend}, or set alpha_cutoff to 0"
        )
