"""Draws the stencil counts of shadow volumes with OpenGL and stores them in `stencil` beside this script.

    python tests/golden/make_golden_stencil.py

needs what `make_golden.py` needs.
"""

from pathlib import Path

import numpy as np
from _opengl import OpenGL
from _stencil import Stencil, scenes

FOLDER = Path(__file__).parent / "stencil"


def main() -> None:
    gl = OpenGL()
    stencil = Stencil(gl)
    FOLDER.mkdir(exist_ok=True)
    for old in FOLDER.glob("*.npz"):
        old.unlink()
    for scene in scenes():
        passing, failing = stencil.counts(scene, "pass"), stencil.counts(scene, "fail")
        fields = {key: value for key, value in scene._asdict().items() if key != "name"}
        np.savez_compressed(FOLDER / f"{scene.name}.npz", passing=passing, failing=failing, **fields)
        differ = np.mean(passing != -failing)
        print(
            f"{scene.name}: {len(scene.faces)} faces, {len(scene.volume_faces)} of volumes; failing count "
            f"{failing.min()} to {failing.max()}, {np.mean(failing != 0):.0%} not 0; {differ:.1%} differ from passing"
        )
    total = sum(path.stat().st_size for path in FOLDER.glob("*.npz"))
    print(f"{gl.renderer}, OpenGL {gl.version}: {total / 1e3:.0f} kB in {FOLDER}")


if __name__ == "__main__":
    main()
