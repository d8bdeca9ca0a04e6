"""
Relief: hillshade, rasterise
============================

A surface lit from the north-west. Points are drawn through the lowest in each cell; ``rasterise`` makes that surface, and
gives it to other plots.
"""

import matplotlib.pyplot as plt

import jaxfilter as jf

scene = jf.scenes.make("town", size=(90, 80), density=1.3, seed=4)
result = jf.default_filter(scene.cloud)(scene.cloud)

figure, (before, after) = plt.subplots(1, 2, figsize=(8, 3.6))
jf.plots.hillshade(scene.cloud.xyz, ax=before, title="all points")
surface = jf.plots.rasterise(
    scene.cloud.xyz[result.ground], cell=1.0, over=scene.cloud.xyz
)
jf.plots.hillshade(surface, ax=after, title="ground")
