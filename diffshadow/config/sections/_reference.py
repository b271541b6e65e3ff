"""Sections of the reference."""

from typing import Annotated

from ...settings.reference import Reference
from ._section import Variants

REFERENCES = Variants(Reference, "traced", __name__)
ReferenceConfig = Annotated[Reference, REFERENCES]
