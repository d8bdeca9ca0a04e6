"""
Sweeps and calibration
======================

A sweep classifies a cloud with many sets of parameters, and computes once what they have in common. A calibration looks for
the set that suits a cloud from the labels of some of its points. :doc:`/docs/sweeps` has all options and the commands.
"""

import numpy as np

import jaxfilter as jf
from jaxfilter.sweeps.best import best_sets

scene = jf.scenes.make("town", size=(90, 80), density=1.3, seed=4)
cloud = scene.cloud

# %%
# Sixty sets in one call
# ----------------------
#
# The result is an xarray Dataset with the parameters as axes.

axes = {
    "slope": [0.05, 0.1, 0.15, 0.2, 0.3],
    "threshold": [0.2, 0.4, 0.6, 0.8],
    "scaling": [0.0, 1.25, 2.5],
}
sweep = jf.sweep(jf.SMRF(), cloud, axes, votes=True)
best_sets(sweep, "total", 3)

# %%
# Which parameter matters? Where the curve of the best scores is flat, it does not:

figure = jf.plots.sweep_curves(sweep)

# %%
# Where does it matter?
# ---------------------
#
# Votes need no reference. Points on which the sets disagree are those worth labelling.

ax = jf.plots.votes_map(cloud, sweep["votes"].values)

# %%
# Labels of three patches
# -----------------------
#
# Say we have labelled everything within three squares of 15 m, in places where the sets disagree. 1 is ground, 0 an object,
# -1 unlabelled. The score is cross-validated over blocks.

votes = sweep["votes"].values
disputed = cloud.xyz[(votes > 0) & (votes < 1), :2]
labels = np.full(len(cloud), -1)
for centre in disputed[[len(disputed) // 4, len(disputed) // 2, -1]]:
    patch = (np.abs(cloud.xyz[:, :2] - centre) < 7.5).all(axis=1)
    labels[patch] = scene.truth[patch]
print(f"{(labels >= 0).sum()} of {len(cloud)} points are labelled")

calibration = jf.calibrate(jf.SMRF(), cloud, labels, size=64, rounds=2)
print(calibration)

# %%
# On the points that were not labelled:

for name, one in (("default", jf.SMRF()), ("calibrated", calibration.filter)):
    scores = jf.evaluate(one(cloud).ground[labels < 0], scene.truth[labels < 0])
    print(
        f"{name:10}: Type I {scores.type1:5.2f} %, Type II {scores.type2:5.2f} %, total {scores.total:5.2f} %"
    )
