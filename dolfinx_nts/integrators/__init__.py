"""Time integration: schemes, and steppers that advance bodies and their contact."""
