"""Weights of the model of doubt. Made by ``experiments/default/doubt.py``, from simulated scenes and labelled tiles."""

import numpy as np

MODEL = np.array(
    [
        [-3.7571, -1.5429, 1.6241, 0.9384, 0.0147, 0.8904, 0.0000, 2.2660, 1.1104, 1.2203],  # not ground
        [-3.5842, -0.6576, 3.5063, -2.3763, 0.4156, 0.7357, 0.8738, 1.8646, -0.6630, 0.2857],  # ground
    ]
)
"""f64[2, 1 + features]: constant and weights, for points that are not ground and for ground."""
