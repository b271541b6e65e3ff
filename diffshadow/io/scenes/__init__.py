"""Reads scenes of other programs: meshes, cameras and lights with their shadows."""
