"""What knows nothing of meshes: arrays, arguments, archives, wall time."""
