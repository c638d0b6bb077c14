"""Normal contact in one attempt at a step: multipliers, penalty springs and tied nodes."""
