"""Newton's method in statics: bodies without supports, instability, continuation."""
