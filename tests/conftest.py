"""Every test runs with jaxtyping's shapes checked by beartype."""

from jaxtyping import install_import_hook

install_import_hook("diffshadow", "beartype.beartype")
