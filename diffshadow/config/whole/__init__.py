"""The whole configuration: all sections, and the checks across them."""
