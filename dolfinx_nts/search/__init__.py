"""Which segments are near which nodes, also across ranks."""
