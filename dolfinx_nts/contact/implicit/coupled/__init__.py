"""Active set and stick of all contact points from one cone complementarity problem."""
