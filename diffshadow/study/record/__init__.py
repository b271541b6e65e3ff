"""Records of finished runs, sweeps and recommendations: their content, and how they are stored in a folder and read
again."""
