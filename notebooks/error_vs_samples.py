# %% [markdown]
# # Error against samples
#
# How many taps does a random disk need, and which pattern is best? The error of $n$ independent taps falls as
# $n^{-1/2}$ for every caster. Taps that keep a distance from each other do better, above all if the shadow's outline
# within the disk is simple.
#
# This notebook runs a part of `diffshadow sweep configs/error_vs_samples.yaml`, which asks the same question for three
# scenes at full size.

# %% tags=["hide-input"]
import json
import os
import tempfile

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
from rich.console import Console
from scipy.stats import t

from diffshadow import config, setup, study

setup()  # before the first array
plt.style.use("diffshadow.mplstyle")
SMALL = bool(os.environ.get("DIFFSHADOW_SMALL"))  # a quick run, for tests
SAMPLES = (4, 16, 64) if SMALL else (4, 8, 16, 32, 64, 128, 256)
PATTERNS = ("uniform", "poisson", "vogel", "halton", "sobol", "stratified")
SEEDS, LIMIT = (3, 1024) if SMALL else (6, 4096)
PIXELS, TEXELS, RAYS = (48, 96, 64) if SMALL else (128, 512, 256)

# %% [markdown]
# **The sweep.** The scene is a torus knot under a sun of 6° radius. Each run draws the shadow with one pattern, one
# number of taps and one seed. It measures two errors (RMSE over the image): against the *limit* of the filter, which is
# its result with very many taps, and against the ray-traced *truth*. Each pattern has 8 x 8 sets of taps, which repeat
# over the image and differ from seed to seed.

# %%
def run(name, samples, patterns):
    """A table with a row for each run."""
    grid = {"filter.samples": samples, "filter.pattern": patterns}
    sections = {
        "name": name,
        "output": folder,
        "sweep": {"run": "render", "grid": grid, "repeats": SEEDS, "limit_samples": LIMIT},
        "scene.camera.resolution": [PIXELS, PIXELS],
        "scene.light.angular_radius": 6.0,  # degrees
        "shadow_map.resolution": [TEXELS, TEXELS],
        "reference.samples": RAYS,
    }
    overrides = [f"{key}={json.dumps(value)}" for key, value in sections.items()]
    sweep = config.load_sweep("../configs/error_vs_samples.yaml", overrides)
    return pd.read_parquet(study.run_sweep(sweep, console=Console(quiet=True), workers=0) / "results.parquet")


with tempfile.TemporaryDirectory() as folder:
    table = run("patterns", SAMPLES, PATTERNS)
    again = run("limit", [LIMIT], ["sobol"])
assert (table.status == "ok").all() and (again.status == "ok").all()
print(f"{len(table)} runs")

# %% [markdown]
# **Noise floors.** Both references have errors of their own. To estimate the error of the limit, we draw the limit
# again with other seeds: two equally good estimates differ by √2 times the error of each. The tracer estimates the
# error of the rays itself.

# %%
rms = lambda values: float(np.sqrt(np.mean(np.square(values))))
floor_of_limit = rms(again.rmse_to_limit) / np.sqrt(2)
floor_of_rays = rms(table.reference_noise_floor)
print(f"RMSE of the limit of {LIMIT:,} taps: {floor_of_limit:.2g}")
print(f"RMSE of {RAYS} rays per pixel: {floor_of_rays:.2g}")

# %% [markdown]
# **Slopes.** For each seed, we fit a straight line to the logarithms by least squares. The interval contains the mean
# slope with 95 % confidence (Student's t). Points whose error is less than 4 times the noise of the limit are left out.

# %%
rows = []
for pattern in PATTERNS:
    slopes = []
    for _, runs in table[table["filter.pattern"] == pattern].groupby("seed"):
        good = runs[runs.rmse_to_limit > 4 * floor_of_limit]
        slopes.append(np.polyfit(np.log(good["filter.samples"]), np.log(good.rmse_to_limit), 1)[0])
    half = t.ppf(0.975, len(slopes) - 1) * np.std(slopes, ddof=1) / np.sqrt(len(slopes))
    rows.append({"pattern": pattern, "slope": np.mean(slopes), "95 %": half})
slopes = pd.DataFrame(rows).set_index("pattern")
for n in SAMPLES[:: len(SAMPLES) - 1]:
    at = table[table["filter.samples"] == n]
    slopes[f"RMSE, {n} taps"] = at.groupby("filter.pattern").rmse_to_limit.apply(rms)
slopes.round(4)

# %% tags=["picture"]
figure, axes = plt.subplots(1, 2, figsize=(11, 4.2), sharey=True)
styles = dict(zip(PATTERNS, zip("osD^vP", ("-", "-", "-", "--", "--", "--"))))
for pattern, (marker, dash) in styles.items():
    runs = table[table["filter.pattern"] == pattern].groupby("filter.samples")
    label = f"{pattern}: {slopes.slope[pattern]:.3f} ± {slopes['95 %'][pattern]:.3f}"
    for ax, column in zip(axes, ("rmse_to_limit", "rmse")):
        ax.loglog(runs[column].apply(rms), marker=marker, linestyle=dash, label=label)
axes[0].axhline(floor_of_limit, color="k", linestyle=":", label="noise floor of the limit")
axes[1].axhline(floor_of_rays, color="k", linestyle="-.")
axes[0].plot([], [], "k-.", label="noise floor of the rays")
axes[0].set(title="against the filter's limit", ylabel="RMSE [visibility]")
axes[1].set(title="against the ray-traced truth")
figure.legend(*axes[0].get_legend_handles_labels(), loc="outside right upper", title="slope, 95 % confidence", alignment="left")
for ax in axes:
    ax.set(xlabel="taps per pixel")
    ax.set_xticks(SAMPLES, [f"{n}" for n in SAMPLES], minor=False)
    ax.minorticks_off()
    ax.grid(True)

# %% [markdown]
# On the left, the error of independent taps falls as theory predicts, and the error of every pattern that spreads its
# taps falls faster. On the right, the error against the truth stops falling early, far above the noise of the rays. The
# remaining error belongs to the technique: the disk has one size, but penumbrae vary in width. A few dozen well-spread
# taps are enough. More taps only refine a wrong answer.

# %%
uniform = slopes.loc["uniform"]
assert abs(uniform.slope + 0.5) < (0.15 if SMALL else 0.05)
assert (slopes.slope.drop("uniform") < uniform.slope).all()
