"""Weights of the model of doubt. Made by ``experiments/default/doubt.py``, from simulated scenes and labelled tiles."""

import numpy as np

DOUBT_MODEL = np.array(
    [
        [-4.3373, -1.2098, 2.3616, 0.8319, 0.0078, 0.6485, 1.3078, 2.2789, 1.6315, 0.1697],  # not ground
        [-3.5264, -0.4882, 3.5260, -3.0704, 0.4395, 0.6623, 0.5368, 1.7478, -0.7109, 0.5048],  # ground
    ]
)
"""f64[2, 1 + features]: constant and weights, for points that are not ground and for ground."""
