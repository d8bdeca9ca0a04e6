"""
One parameter: sweep_curve, sweep_curves
========================================

The line is the best score that any values of the other parameters reach. Where it is flat, the parameter does not matter
if the others are chosen well. The band holds four fifths of the sets.
"""

import jaxfilter as jf

scene = jf.scenes.make("town", size=(90, 80), density=1.3, seed=4)
axes = {
    "slope": [0.05, 0.1, 0.15, 0.2, 0.3],
    "threshold": [0.2, 0.4, 0.6, 0.8],
    "scaling": [0.0, 1.25, 2.5],
}
sweep = jf.sweep(jf.SMRF(), scene.cloud, axes)
figure = jf.plots.sweep_curves(sweep)

# %%
# A single one, of another score:

ax = jf.plots.sweep_curve(sweep, "threshold", "kappa")
