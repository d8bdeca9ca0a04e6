"""
Where a fit stops: fit_curves
=============================

A fit by gradient goes down on the clouds that it sees. Clouds that are held out say how long that is a gain.
"""

import jaxfilter as jf

clouds = {
    f"town {seed}": jf.scenes.make("town", size=(60, 60), density=1, seed=seed).cloud
    for seed in (4, 5, 6)
}
found = jf.fit(jf.SMRF(window=12.0, threshold=1.2), clouds)
ax = jf.plots.fit_curves(found)
print(found)
