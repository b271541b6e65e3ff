"""Records of finished runs, sweeps and recommendations, and their storage in folders."""
