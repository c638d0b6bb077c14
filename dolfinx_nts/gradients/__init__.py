"""Derivatives of runs with respect to parameters, by adjoint and tangent-linear steps."""
