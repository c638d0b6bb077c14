"""Implicit steppers: forms, starting guesses, solution and energy balance of a step."""
