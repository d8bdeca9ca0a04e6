"""
Where to look: doubt_map
========================

OST says how likely each label is to be wrong (:doc:`/docs/doubt`). The map shows the mean over the points of a cell.
"""

import jaxfilter as jf

scene = jf.scenes.make("town", size=(90, 80), density=1.3, seed=4)
result = jf.OST.for_cloud(scene.cloud)(scene.cloud)
ax = jf.plots.doubt_map(scene.cloud, result)
