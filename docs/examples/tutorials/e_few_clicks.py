"""
Labels from a few clicks
========================

Single points that are spread over a cloud say far more than as many in a patch. Two dozen clicks can set a filter up.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.spatial import cKDTree

import jaxfilter as jf

scene = jf.scenes.make("town", size=(90, 80), density=1.3, seed=4)
cloud = scene.cloud

# %%
# Where to click
# --------------
#
# A sweep without labels shows the points whose label depends on the parameters. We click there, and at some places that are
# clear.

axes = {
    "slope": [0.05, 0.1, 0.2, 0.3],
    "threshold": [0.1, 0.2, 0.4, 0.8],
    "scaling": [0.0, 1.25, 2.5],
}
votes = jf.sweep(jf.SMRF(), cloud, axes, votes=True)["votes"].values
figure, ax = plt.subplots(figsize=(5, 4.6))
ax = jf.plots.votes_map(cloud, votes, ax=ax)

# %%
# On a screen, clicks come from matplotlib: left button for ground, right button for an object.
#
# .. code-block:: python
#
#     clicks, kinds = [], []
#
#     def click(event):
#         clicks.append((event.xdata, event.ydata))
#         kinds.append(1 if event.button == 1 else 0)
#
#     figure.canvas.mpl_connect("button_press_event", click)
#     plt.show()
#
# No one clicks while this page is built. Instead, 24 places are drawn, 16 of them among the disputed points, and a patient
# person answers from the truth:

rng = np.random.default_rng(0)
judged = np.flatnonzero(cloud.candidate)
disputed = judged[(votes[judged] > 0) & (votes[judged] < 1)]
clicked = np.concatenate(
    [rng.choice(disputed, 16, replace=False), rng.choice(judged, 8, replace=False)]
)
clicks, kinds = cloud.xyz[clicked, :2], scene.truth[clicked].astype(int)
print(f"{kinds.sum()} ground, {len(kinds) - kinds.sum()} objects")

# %%
# From clicks to labels
# ---------------------
#
# Each click labels the judged point that is nearest to it.

labels = np.full(len(cloud), -1)
labels[judged[cKDTree(cloud.xyz[judged, :2]).query(clicks)[1]]] = kinds
calibration = jf.calibrate(jf.SMRF(), cloud, labels, size=64, rounds=2, folds=3)
print(calibration)

# %%
# So few points, most of them the hardest, say little of the error on the whole; they do say which set is better. On all other
# points:

rest = cloud.candidate & (labels < 0)
for name, one in (("default", jf.SMRF()), ("calibrated", calibration.filter)):
    scores = jf.evaluate(one(cloud).ground[rest], scene.truth[rest])
    print(
        f"{name:10}: Type I {scores.type1:5.2f} %, Type II {scores.type2:5.2f} %, total {scores.total:5.2f} %"
    )
