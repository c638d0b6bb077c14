"""Internal variables of materials: Maxwell branches and plastic flow."""
