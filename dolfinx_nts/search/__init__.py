"""Search of candidate segments for contact points, across ranks."""
