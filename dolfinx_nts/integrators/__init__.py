"""Time integration: the schemes, the stepper, runs in time."""
