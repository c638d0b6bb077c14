"""Time integration: schemes, and the steppers that advance bodies and their contact by them."""
