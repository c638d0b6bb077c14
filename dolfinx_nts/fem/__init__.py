"""What is needed beside `dolfinx.fem`: elements, compiled forms, numbers of nodes."""
