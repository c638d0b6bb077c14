"""Elements, compiled forms and node numbers, in addition to `dolfinx.fem`."""
