"""Resolved impact: the nodes in contact are massless."""
