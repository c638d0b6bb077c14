"""Contact in the steps that Newton's method solves."""
