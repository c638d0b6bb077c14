"""Files of a run: its table, its fields and its checkpoints."""
