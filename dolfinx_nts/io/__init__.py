"""Files: fields, tables and checkpoints."""
