"""Training of the deepct network with PyTorch, export and verification of its weights.

Volumes are ``[z, y, x]`` (extinction, 1/km), images ``[view, row, col]`` (radiance,
1/sr); a batch has one additional leading axis.
"""

__version__ = "0.1.0"
