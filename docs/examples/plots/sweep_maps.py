"""
Two parameters: sweep_map, sweep_maps
=====================================

Each cell is the best score over the other parameters; the star is the best set of all.
"""

import jaxfilter as jf

scene = jf.scenes.make("town", size=(90, 80), density=1.3, seed=4)
axes = {
    "slope": [0.05, 0.1, 0.15, 0.2, 0.3],
    "threshold": [0.2, 0.4, 0.6, 0.8],
    "scaling": [0.0, 1.25, 2.5],
}
sweep = jf.sweep(jf.SMRF(), scene.cloud, axes)
figure = jf.plots.sweep_maps(sweep)

# %%
# A single pair. In a design that is no grid, every set is a point:

ax = jf.plots.sweep_map(sweep, "slope", "threshold", "type2")
