"""The whole configuration: all sections together, and the faults that lie between them."""
