"""
Files of a survey: footprints
=============================

Rectangles coloured by a value each, with overlaps and gaps. ``jf.open(folder).plot()`` draws it of the files of a survey.
"""

import numpy as np

import jaxfilter as jf

corner = np.array(
    [(x, y) for y in range(0, 3000, 1000) for x in range(0, 4000, 1000)], float
)
bounds = np.column_stack([corner, corner + 1000.0])
bounds[5, 2] += 60.0  # overlaps the next one
bounds = np.delete(bounds, 10, axis=0)
density = np.linspace(4, 12, len(bounds))
gap = (2000.0, 2000.0, 3000.0, 3000.0)
ax = jf.plots.footprints(
    bounds, density, label="points per m2", overlaps=np.array([[5, 6]]), gaps=[gap]
)
