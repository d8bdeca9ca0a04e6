"""Weights of the model of doubt. Made by ``experiments/default/doubt.py``, from simulated scenes and labelled tiles."""

import numpy as np

MODEL = np.array(
    [
        [-0.2532, -2.1925, -0.5902, 0.2838, 0.0561, 1.0253, 0.0000, 1.1226, 0.6609, 1.5348],  # not ground
        [-3.9109, 0.2602, 3.1175, -1.0683, 0.3653, 0.7139, 0.7364, 1.2781, -1.0024, 1.0535],  # ground
    ]
)
"""f64[2, 1 + features]: constant and weights, for points that are not ground and for ground."""
